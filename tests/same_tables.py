"""Tables of studies that are to be equal, however they were made."""

import pandas as pd

from calstudy.study.directory.store import read_table
from calstudy.study.schema import TABLES, VARYING


def tables(directory):
    """Tables of a study without the columns that may differ between equal studies."""
    return {name: read_table(directory, name).drop(columns=list(VARYING), errors="ignore") for name in TABLES}


def assert_same(found, expected):
    for name in TABLES:
        pd.testing.assert_frame_equal(found[name], expected[name], check_exact=True)
