"""Tables and figures of a study: a short module for each one of the paper, and for those that go beyond it.

Each function takes a study as ``calstudy.read_study`` reads it; tables are DataFrames, figures Matplotlib
figures::

    from calstudy import read_study
    from calstudy.analysis import figure7, table5

    table5(read_study("studies/mine"))

``calstudy.analysis.contents`` lists them all.
"""

from __future__ import annotations

from typing import Any

from calstudy.analysis.contents import BY_NAME, names

__all__ = list(names())


def __getattr__(name: str) -> Any:
    """Load the module of a table or figure when it is first used."""
    if name in BY_NAME:
        return BY_NAME[name].function
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
