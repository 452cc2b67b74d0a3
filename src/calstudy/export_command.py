"""The command ``plan export``."""

from __future__ import annotations

import sys
from argparse import Namespace

from calstudy.errors import SetupError
from calstudy.plan import load_plan
from calstudy.plan_export import export


def plan_export(a: Namespace) -> None:
    """Write the plan's rows."""
    content = export(load_plan(a.plan), a.format)
    data = content.encode() if isinstance(content, str) else content
    if a.out is None:
        sys.stdout.buffer.write(data)
        sys.stdout.flush()
        return
    try:
        a.out.write_bytes(data)
    except OSError as error:
        raise SetupError(f"{a.out}: cannot be written: {error.strerror}; choose another --out") from error
