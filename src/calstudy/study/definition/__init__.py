"""A calibration as a user writes it down: the TOML file of ``calstudy calibrate``, checked line by line."""

from calstudy.study.definition.file import ROW, Definition, define, example, read_definition
from calstudy.study.definition.models import Chosen

__all__ = ["ROW", "Chosen", "Definition", "define", "example", "read_definition"]
