"""What the shipped angle-of-repose model declares, as the tests of tables and emulators need it."""

from calstudy.emulator.similarity import Similarity
from calstudy.models.find import DEFAULT_MODEL, declaration
from calstudy.study.schema import Quantities, replicated_of, sweep_columns, tables_of

DECLARED = declaration(DEFAULT_MODEL)
SIMILARITY = Similarity.of(DECLARED, ())
QUANTITIES = Quantities.of(DECLARED)
COLUMNS = tables_of(QUANTITIES)
"""Columns of each table of a study of the plan."""
REPLICATED = replicated_of(QUANTITIES)
SWEEP = sweep_columns(QUANTITIES)
