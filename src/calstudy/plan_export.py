"""The plan's rows as a file: CSV, JSON or Parquet."""

from __future__ import annotations

import io
import json

import pyarrow as pa
import pyarrow.parquet as pq

from calstudy.errors import InputError
from calstudy.plan import Plan

FORMATS = ("csv", "parquet", "json")


def export(plan: Plan, format: str) -> str | bytes:
    """The rows of a plan: text for ``csv`` and ``json`` (a list of objects), bytes for ``parquet``.

    CSV is Table B-1 with its levels as printed, so the shipped plan gives its own file. Parquet has the
    plan's name and hash, and the meaning of each factor, as metadata. InputError: another format.
    """
    records = [plan.cells(row) for row in plan.rows]
    if format == "csv":
        lines = [",".join(plan.header)]
        lines += [",".join(f"{record[name]:g}" for name in plan.header) for record in records]
        return "\n".join(lines) + "\n"
    if format == "json":
        return json.dumps(records, indent=2) + "\n"
    if format == "parquet":
        meaning = {"run": "row number of Table B-1", **{f.name: f.meaning for f in plan.factors}}
        schema = pa.schema(
            [
                pa.field(
                    name, pa.float64() if name == "WRL" else pa.int64(), False, {"meaning": meaning[name]}
                )
                for name in plan.header
            ],
            metadata={"plan": plan.name, "plan_hash": plan.hash},
        )
        sink = io.BytesIO()
        pq.write_table(pa.Table.from_pylist(records, schema=schema), sink)
        return sink.getvalue()
    raise InputError(f"format {format!r} is unknown; use {', '.join(FORMATS)}")
