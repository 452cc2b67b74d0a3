"""Names of the angle-of-repose model, for the model itself and for the exhibits of the paper's study.

Everything else takes parameters and responses from the model at hand, or from a study's settings.
"""

from __future__ import annotations

from calstudy.models.find import DEFAULT_MODEL, declaration
from calstudy.records import RAYLEIGH_TIME_STEP, proportional

_OF = declaration(DEFAULT_MODEL)
ANGLE_OF_REPOSE, BULK_DENSITY = MEASURED = tuple(response.name for response in _OF.responses)
"""Responses that need a DEM run; the Rayleigh time-step follows from Eq. 1."""
RESPONSES = (*MEASURED, RAYLEIGH_TIME_STEP)
UNITS = {**{response.name: response.unit for response in _OF.responses}, RAYLEIGH_TIME_STEP: "s"}
PROPORTIONAL = proportional(_OF.responses)
PARAMETER_UNITS = _OF.parameters
REFERENCE = _OF.reference
"""A twin's parameters: inside the box, and equal to every constant, so that each row can find them."""
