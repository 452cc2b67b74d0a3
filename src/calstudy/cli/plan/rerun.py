"""The command ``plan rerun``: runs rows of a study again, and compares each DEM run."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from rich.table import Table

from calstudy.cli.options.choices import parse_rows_option, running
from calstudy.cli.terminal import (
    messages_console,
    print_json,
    results_console,
    say,
    stop_on_signals,
)
from calstudy.engines.choose import planned_engine
from calstudy.errors import OTHERWISE
from calstudy.report import progress
from calstudy.study.reading import Study, read_study
from calstudy.study.run.comparison import RowComparison
from calstudy.study.run.rows import Repeat, repeat_of, rerun


def plan_rerun(a: Namespace) -> int:
    """Run rows of a study again with its own settings, and compare each run."""
    there = read_study(a.study, a.plan)
    of = repeat_of(there, parse_rows_option(a.rows, there.plan), a.study)
    directory = a.out or Path("studies") / f"rerun-{there.settings.id}"
    if a.dry_run:
        return _print_dry_run(a, of, directory)
    console = messages_console()
    with stop_on_signals(console) as stop:
        again, found = rerun(
            of, directory, running(a), stop, say=partial(say, console), watch=progress.watching(console)
        )
    return _print_comparison(a, there, again, found)


def _print_dry_run(a: Namespace, of: Repeat, directory: Path) -> int:
    """Print what the rows took; raises if the directory holds another study."""
    done = of.there.calibrations[of.there.calibrations["row"].isin(of.rows)]
    runs, hours = int(done["runs_total"].sum()), done["cpu_time"].sum() / 3600
    if a.json:
        print_json({"rows": of.rows, "runs": runs, "core_hours": hours})
    else:
        results_console().print(f"{len(of.rows)} row(s) took {runs} DEM runs, {hours:.2f} core-hours.")
    if other := of.work([planned_engine(model, of.program) for model, _ in of.models], directory).other_study:
        raise other
    return 0


def _print_comparison(a: Namespace, there: Study, again: Study, found: Sequence[RowComparison]) -> int:
    if a.json:
        print_json([asdict(comparison) | {"same": comparison.same} for comparison in found])
    else:
        out = results_console()
        table = Table("row", "DEM runs", "run again", "equal", "first that differs", title=f"{a.study} again")
        names = list(found[0].largest)
        for name in names:
            table.add_column(f"samples differ, {name} in {there.settings.quantities.units[name]}")
        for c in found:
            cells = (c.row, c.runs, c.runs_again, c.equal)
            largest = (f"{c.largest[name]:.4g}" for name in names)
            table.add_row(
                *map(str, cells), c.first_difference or "none: all digits of the runs are equal", *largest
            )
        out.print(table)
        for name in ("engine", "calstudy"):
            was, now = (getattr(study.settings, name) for study in (there, again))
            if was != now:
                out.print(f"{name}: {was} made the study, {now} made it again", highlight=False)
        if not all(c.same for c in found):
            program = there.settings.engine.split()[0]
            out.print(
                f"Another build of {program}, or another processor, may round otherwise, and collisions "
                "amplify a last digit: then runs differ by their noise, and the row goes its own way.",
                highlight=False,
                soft_wrap=True,
            )
    return 0 if all(c.same for c in found) else OTHERWISE
