"""From a study to files: tables, figures, the page, and a manifest that says where they come from."""

from __future__ import annotations

import hashlib
import io
import json
import platform
from collections.abc import Callable, Collection, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from calstudy import __version__
from calstudy.analysis.contents import Exhibit, Kind, Of
from calstudy.analysis.exhibit import Table, to_csv, to_latex
from calstudy.analysis.fresh_runs import in_words as run_again
from calstudy.analysis.fresh_runs import runs_beside, with_confirmed
from calstudy.analysis.replicates.bands import provenance as of_replicates
from calstudy.analysis.replicates.numbers_beside import common_rows
from calstudy.analysis.statistics.verdicts import Verdict
from calstudy.disk.files import write_atomically
from calstudy.disk.ours import make_directory
from calstudy.errors import SetupError
from calstudy.records import Outcome
from calstudy.report.exhibits import COMPARED, Drawing, drawing_helper, table
from calstudy.report.page import page
from calstudy.report.replicated import (
    ENTRIES_FILE,
    MANIFEST_FILE,
    TESTS_FILE,
    has_entries,
    read_entries,
    with_replicated_rows,
    with_replicated_tests,
    with_replicates,
)
from calstudy.study.directory.session import read_sessions
from calstudy.study.reading import Study, read_study
from calstudy.study.schema import REPLICATED, TABLES
from calstudy.study.settings import SETTINGS_FILE, read_settings

FORMATS = ("html", "csv", "tex", "png", "svg")
LIBRARIES = ("numpy", "scipy", "pandas", "pyarrow", "statsmodels", "matplotlib")
_OF_TABLES: dict[str, Callable[[Table], str]] = {"csv": to_csv, "tex": to_latex}


@dataclass(frozen=True, slots=True)
class Written:
    """The files written, and the ledger's verdicts (empty if it was not asked for)."""

    files: tuple[Path, ...]
    manifest: dict[str, Any]
    verdicts: dict[str, int]


def write_analysis(
    source: Path,
    plan: Path | None,
    out: Path,
    exhibits: Sequence[Exhibit],
    formats: Sequence[str],
    workers: int = 1,
    beside: Path | None = None,
) -> tuple[Study, Written]:
    """Read the study in ``source``; write tables and figures, and a manifest that lists them.

    ``plan`` is a file of rows; None for the paper's. ``workers`` processes read the replicates, whose numbers
    are written, too. ``beside`` is a study to compare with. With the same versions, the same study gives the
    same bytes. SetupError: ``out`` cannot be written. StoreError and InputError as in read_study.
    """
    of_pictures = [f for f in ("png", "svg") if f in formats or (f == "svg" and "html" in formats)]
    drawn = [e.name for e in exhibits if e.kind is Kind.FIGURE] if of_pictures else []
    of = {e.of for e in exhibits}
    read_settings(source)  # anything but a study is refused before a second process starts
    with drawing_helper() if drawn else nullcontext() as helper:
        study = read_study(source, plan)
        if of & {Of.REPLICATES, Of.HALVES, Of.REPLICATES_BESIDE}:
            study = with_replicates(source, study, workers)
        if Of.TESTS in of:
            study = with_replicated_tests(source, study, workers)
        if beside is not None and of & set(COMPARED):
            study = replace(study, beside=_beside(beside, study, of, workers))
        study = with_confirmed(source, study)
        drawing = Drawing(helper, drawn, study, of_pictures) if helper else None
        tables = [table(e.name, study) for e in exhibits if e.kind is Kind.TABLE]
        figures = drawing.finish().values() if drawing else ()
    contents = {
        f"tables/{t.name}.{f}": write(t).encode()
        for t in tables
        for f, write in _OF_TABLES.items()
        if f in formats
    }
    contents |= {f"figures/{p.name}.{f}": p.files[f] for p in figures for f in of_pictures if f in formats}
    verdicts = next((_counted(t) for t in tables if t.name == "claims"), {})
    origin = provenance(study, source)
    if "html" in formats:
        title = f"Rackl & Hanley (2017), regenerated: study {study.settings.id}"
        contents["report.html"] = page(
            title, lead(study, verdicts), facts(study, source), [*figures, *tables]
        ).encode()
    if study.replicated is not None:
        contents[ENTRIES_FILE] = _parquet(study.replicated)
    if study.replicated_tests is not None:
        contents[TESTS_FILE] = _parquet(study.replicated_tests)
    manifest = origin | {
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(contents.items())}
    }
    contents[MANIFEST_FILE] = (json.dumps(manifest, indent=2, sort_keys=True) + "\n").encode()
    below = source if out.is_relative_to(source) else out
    for name, data in contents.items():
        _write(out / name, data, below)
    return study, Written(tuple(out / name for name in contents), manifest, verdicts)


def _beside(directory: Path, study: Study, of: Collection[Of], workers: int) -> Study:
    """The second study, with what the exhibits of these kinds compare."""
    if has_entries(directory):
        return read_entries(directory, None if Of.REPLICATES_BESIDE in of else study)
    other = read_study(directory)
    if Of.REPLICATES_BESIDE in of:
        return with_replicates(directory, other, workers)
    other = with_replicated_rows(directory, other, study)
    if Of.NUMBERS_BESIDE not in of:
        return other
    return with_replicates(directory, other, workers, common_rows(replace(study, beside=other)))


def _parquet(frame: pd.DataFrame) -> bytes:
    """A table as a Parquet file."""
    sink = io.BytesIO()
    frame.to_parquet(sink, index=False, compression="zstd")
    return sink.getvalue()


def _counted(ledger: Table) -> dict[str, int]:
    """Number of claims with each verdict."""
    counted = ledger.frame["verdict"].value_counts()
    return {str(v): int(counted.get(str(v), 0)) for v in Verdict}


def lead(study: Study, verdicts: dict[str, int]) -> str:
    """First paragraph of the report."""
    said = f"{len(study.ok)} of the plan's {study.planned} rows calibrated"
    if len(study.failed):
        said += f", {len(study.failed)} failed"
    if study.unfinished:
        said += f", {len(study.unfinished)} not finished"
    said += "."
    if verdicts:
        counts = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.items())
        said += f" Verdicts on the paper's {sum(verdicts.values())} claims: {counts}."
    if study.ok.empty:
        said += " Without a finished row only the plan itself can be judged."
    return said


def facts(study: Study, source: Path) -> dict[str, str]:
    """What the study is, for the top of the report."""
    s = study.settings
    return {
        "Plan": f"{s.plan}, hash {s.plan_hash}",
        "Model": f"{s.model}, deck {s.deck}, {s.at}; hash {s.model_hash}",
        "Engine": s.engine,
        "Procedure": f"{s.mode} mode, seed {s.seed}, "
        + ("no limit of" if s.budget is None else f"at most {s.budget}")
        + " DEM runs in a second optimisation",
        "Target": s.target.origin,
        "Rows": ", ".join(map(str, study.ok["row"])) or "none",
        "Left out": study.left_out() or "nothing",
        **({} if study.confirmed is None else {"Optima": run_again(study)}),
        "Work": _in_words(work(study, source)),
        **({} if study.replicated is None else {"Replicates": of_replicates(study)}),
        "calstudy": f"{s.calstudy} ran it, {__version__} analysed it",
    }


def _in_words(did: dict[str, Any]) -> str:
    runs = f"{did['runs']} runs of the engine, of which {did['runs_failed']} failed"
    return "; ".join([f"{runs}: {did['cpu_hours']:.2f} h of processor time", *did["machines"]])


def provenance(study: Study, source: Path) -> dict[str, Any]:
    """Hashes, versions and seeds behind every number, and the work done.

    It has no date, so that the same study gives the same bytes.
    """
    rows = [int(row) for row in study.calibrations["row"]]
    files = [SETTINGS_FILE, *(f"{table}/row-{row:02d}.parquet" for table in TABLES for row in rows)]
    if study.replicated is not None:
        numbers = sorted(study.replicated["replicate"].unique())
        files += [f"{table}/r-{number:03d}.parquet" for table in REPLICATED for number in numbers]
    other = study.beside.settings if study.beside else None
    again = [] if study.confirmed is None else [runs_beside(source)]
    return {
        "study": study.settings.id,
        **({"beside": {"study": other.id, "settings": other.content}} if other else {}),
        "settings": study.settings.content,
        "rows": {
            "ok": [int(row) for row in study.ok["row"]],
            "failed": {str(line.row): line.reason for line in study.failed.itertuples()},
            "not_finished": study.unfinished,
        },
        "work": work(study, source),
        "data": {
            name: hashlib.sha256((source / name).read_bytes()).hexdigest()
            for name in files
            if (source / name).exists()
        }
        | {f"{p.parent.name}/{p.name}": hashlib.sha256(p.read_bytes()).hexdigest() for p in again},
        "versions": {"calstudy": __version__, "python": platform.python_version()}
        | {name: version(name) for name in LIBRARIES},
    }


def work(study: Study, source: Path) -> dict[str, Any]:
    """Runs of the finished rows with their hours, and the machines that `plan run` ran on."""
    runs = study.evaluations.drop_duplicates("run_id")
    return {
        "runs": len(runs),
        "runs_failed": int((runs["outcome"] != Outcome.OK).sum()),
        "cpu_hours": float(runs["cpu_time"].sum() / 3600),
        "wall_hours": float(runs["wall_time"].sum() / 3600),
        "machines": sorted({session.machine for session in read_sessions(source)} - {""}),
    }


def _write(path: Path, content: bytes, below: Path) -> None:
    """Write a file and its directories; a study of somebody else's must not lead it elsewhere by a link."""
    try:
        below.mkdir(parents=True, exist_ok=True)
        make_directory(path.parent, below)
        write_atomically(path, content, below)
    except OSError as error:
        raise SetupError(
            f"{path}: cannot be written: {error.strerror}; free space or choose another --out"
        ) from error
