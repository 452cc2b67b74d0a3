"""A calibration as a user defines it in the TOML file of ``calstudy calibrate``."""

from calstudy.study.definition.examples import example, example_of
from calstudy.study.definition.file import ROW, Definition, define, model_of, read_definition
from calstudy.study.definition.models import Chosen

__all__ = ["ROW", "Chosen", "Definition", "define", "example", "example_of", "model_of", "read_definition"]
