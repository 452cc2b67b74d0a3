"""Calibrate discrete element models, and study how well the calibration procedure works.

The procedure is that of Rackl & Hanley (2017), Powder Technology,
doi:10.1016/j.powtec.2016.11.048; equation, section and table numbers in docstrings are theirs.
"""

from importlib.metadata import version

__version__ = version("calstudy")
