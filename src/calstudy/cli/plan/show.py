"""The commands ``plan show``, ``plan check`` and ``plan export``."""

from __future__ import annotations

import sys
from argparse import Namespace
from dataclasses import asdict

from rich.table import Table
from rich.text import Text

from calstudy.cli.terminal import print_json, results_console
from calstudy.disk.files import write_atomically
from calstudy.errors import SetupError
from calstudy.models.find import declaration
from calstudy.plan_check import check
from calstudy.plan_file import load_plan
from calstudy.plausible import RANGES


def plan_show(a: Namespace) -> None:
    """Show the plan."""
    plan = load_plan(a.plan)
    if a.json:
        rows = [
            plan.cells(row) | {"calibrated": list(row.calibrated), "samples": row.samples}
            for row in plan.rows
        ]
        found = {name: asdict(getattr(plan, name)) for name in ("source", "fixed")}
        found["targets"] = dict(plan.targets)
        parameters = [asdict(p) for p in plan.parameters]
        print_json({"plan": plan.name, "hash": plan.hash, "parameters": parameters, **found, "rows": rows})
        return
    console = results_console()
    console.print(
        f"Plan {plan.name}: {len(plan.rows)} rows, {plan.total_samples} samples in all", highlight=False
    )
    console.print(f"{plan.source.citation}, doi:{plan.source.doi}", highlight=False, soft_wrap=True)
    intervals = Table("parameter", "lower", "upper", "unit", "if excluded", title=plan.source.intervals)
    for p in plan.parameters:
        constant = "always calibrated" if p.constant is None else f"{p.constant:g}"
        intervals.add_row(p.name, f"{p.lower:g}", f"{p.upper:g}", p.unit, constant)
    console.print(intervals)
    fixed = Table("fixed input", "value", title=plan.source.fixed_inputs)
    for name, value in asdict(plan.fixed).items():
        fixed.add_row(name, f"{value:g}")
    console.print(fixed)
    units = {name: RANGES[name].unit for name in plan.targets if name in RANGES}
    for test in plan.tests:
        measured = declaration(test.model).responses
        units |= {f"{plan.prefix(test)}{response.name}": response.unit for response in measured}
    aim = ", ".join(f"{value:g} {units[name]}" for name, value in plan.targets.items())
    console.print(
        f"Targets: {aim} ({plan.source.targets})",
        highlight=False,
    )
    for k, test in enumerate(plan.tests, start=1):
        console.print(f"Test {k}: {test.model}: {', '.join(test.targets)}", highlight=False)
    rows_table = Table(*plan.header, "calibrated", "samples", title=plan.source.rows)
    for row in plan.rows:
        cells = [f"{value:g}" for value in (row.run, *row.levels)]
        rows_table.add_row(*cells, " ".join(row.calibrated), str(row.samples))
    console.print(rows_table)


def plan_check(a: Namespace) -> None:
    """Check the plan; refuses a wrong one."""
    result = check(load_plan(a.plan))
    if a.json:
        print_json(asdict(result) | {"ok": result.ok})
    else:
        table = Table("check", "", "found", "expected", title=f"Plan {result.plan}")
        for f in result.findings:
            table.add_row(f.name, Text("ok", "green") if f.ok else Text("wrong", "red"), f.found, f.expected)
        results_console().print(table)
    result.refuse_if_wrong()


def plan_export(a: Namespace) -> None:
    """Write the plan's rows."""
    from calstudy.plan_export import export  # loads Arrow, which no other command of this module needs

    content = export(load_plan(a.plan), a.format)
    data = content.encode() if isinstance(content, str) else content
    if a.out is None:
        sys.stdout.buffer.write(data)
        sys.stdout.flush()
        return
    try:
        write_atomically(a.out, data)
    except OSError as error:
        raise SetupError(f"{a.out}: cannot be written: {error.strerror}; choose another --out") from error
