"""What a study shows: one short module for each table and figure of the paper, and for what goes beyond it.

Each function takes a study as ``calstudy.study.read_study`` reads it; tables are DataFrames, figures
Matplotlib figures::

    from calstudy.analysis import table5
    from calstudy.study import read_study

    table5(read_study("studies/mine"))
"""

from calstudy.analysis.bands import bands
from calstudy.analysis.bands_beside import bands_beside
from calstudy.analysis.bands_claims import bands_claims
from calstudy.analysis.bands_figure import bands_figure
from calstudy.analysis.claims import claims
from calstudy.analysis.convergence import convergence
from calstudy.analysis.effects import effects
from calstudy.analysis.figure1 import figure1
from calstudy.analysis.figure2 import figure2
from calstudy.analysis.figure3 import figure3
from calstudy.analysis.figure4 import figure4
from calstudy.analysis.figure5 import figure5
from calstudy.analysis.figure6 import figure6
from calstudy.analysis.figure7 import figure7
from calstudy.analysis.figure8 import figure8
from calstudy.analysis.figure9 import figure9
from calstudy.analysis.half_fraction import half_fraction
from calstudy.analysis.numbers_beside import numbers_beside
from calstudy.analysis.numbers_beside_figure import numbers_beside_figure
from calstudy.analysis.rows_beside import rows_beside
from calstudy.analysis.rows_beside_figure import rows_beside_figure
from calstudy.analysis.second_phase import second_phase
from calstudy.analysis.table1 import table1
from calstudy.analysis.table2 import table2
from calstudy.analysis.table3 import table3
from calstudy.analysis.table4 import table4
from calstudy.analysis.table5 import table5
from calstudy.analysis.table6 import table6
from calstudy.analysis.table_b1 import table_b1

__all__ = [
    "bands",
    "bands_beside",
    "bands_claims",
    "bands_figure",
    "claims",
    "convergence",
    "effects",
    "figure1",
    "figure2",
    "figure3",
    "figure4",
    "figure5",
    "figure6",
    "figure7",
    "figure8",
    "figure9",
    "half_fraction",
    "numbers_beside",
    "numbers_beside_figure",
    "rows_beside",
    "rows_beside_figure",
    "second_phase",
    "table1",
    "table2",
    "table3",
    "table4",
    "table5",
    "table6",
    "table_b1",
]
