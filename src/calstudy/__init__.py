"""Calibrate discrete element models, and study how well the calibration procedure works.

The procedure is that of Rackl & Hanley (2017), Powder Technology,
doi:10.1016/j.powtec.2016.11.048; equation, section and table numbers in docstrings are theirs.

Names are loaded when they are first used, so that ``import calstudy`` is fast.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calstudy.calibration.kriging.universal import UniversalKriging
    from calstudy.engines.choose import open_engine
    from calstudy.plan_file import load_plan
    from calstudy.report.calibration import write_report
    from calstudy.study.reading import read_study
    from calstudy.study.run.definition import calibrate_file
    from calstudy.study.run.function import calibrate
    from calstudy.study.run.rows import run_plan
    from calstudy.study.run.work import Running

__version__ = version("calstudy")
__all__ = [
    "Running",
    "UniversalKriging",
    "calibrate",
    "calibrate_file",
    "load_plan",
    "open_engine",
    "read_study",
    "run_plan",
    "write_report",
]
_PLACES = {
    "Running": "calstudy.study.run.work",
    "UniversalKriging": "calstudy.calibration.kriging.universal",
    "calibrate": "calstudy.study.run.function",
    "calibrate_file": "calstudy.study.run.definition",
    "load_plan": "calstudy.plan_file",
    "open_engine": "calstudy.engines.choose",
    "read_study": "calstudy.study.reading",
    "run_plan": "calstudy.study.run.rows",
    "write_report": "calstudy.report.calibration",
}
"""Module of each name."""


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if why := import_module("calstudy.machine").refusal():
        raise ImportError(why)
    return getattr(import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
