"""What the angle-of-repose model takes and gives: the names and units of its parameters and responses."""

from __future__ import annotations

from collections.abc import Mapping

from calstudy.records import RAYLEIGH_TIME_STEP, Response, proportional

ANGLE_OF_REPOSE = "angle_of_repose_deg"
BULK_DENSITY = "bulk_density"
PARAMETER_UNITS: Mapping[str, str] = {
    "DENS": "kg/m3",
    "MU_PP": "-",
    "MU_PW": "-",
    "RF_PP": "-",
    "RF_PW": "-",
    "YM": "Pa",
}
REFERENCE: Mapping[str, float] = {
    "DENS": 2500.0,
    "MU_PP": 0.2,
    "MU_PW": 0.2,
    "RF_PP": 0.05,
    "RF_PW": 0.01,
    "YM": 5.06e8,
}
"""A twin's parameters: inside the box, and equal to every constant, so that each row can find them."""
GIVEN = (
    Response(ANGLE_OF_REPOSE, "deg", short="angle"),
    Response(BULK_DENSITY, "kg/m3", proportional_to="DENS", short="bulk", quotient="solid_fraction"),
)
"""Responses that need a DEM run; the Rayleigh time-step follows from Eq. 1."""
PROPORTIONAL = proportional(GIVEN)
MEASURED = tuple(response.name for response in GIVEN)
RESPONSES = (*MEASURED, RAYLEIGH_TIME_STEP)
UNITS = {**{response.name: response.unit for response in GIVEN}, RAYLEIGH_TIME_STEP: "s"}
