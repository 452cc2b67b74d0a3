"""Table 1 (section 2.2): the DEM input parameters that are fixed for all simulations."""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.study.reading import Study

TITLE = "Table 1: DEM inputs fixed for all simulations (p-p: particle-particle, p-w: particle-wall)"
COLUMNS = (Column("parameter", "Parameter"), Column("value", "Value", "g"), Column("unit", "Unit"))


def table1(study: Study) -> pd.DataFrame:
    """Fixed inputs of the study's plan."""
    fixed = study.plan.fixed
    lines = [
        ("Poisson's ratio", fixed.poissons_ratio, "-"),
        ("Coefficient of restitution (p-p)", fixed.restitution_pp, "-"),
        ("Coefficient of restitution (p-w)", fixed.restitution_pw, "-"),
        ("Viscous damping coefficient of rolling friction (p-p)", fixed.rolling_viscous_damping_pp, "-"),
        ("Viscous damping coefficient of rolling friction (p-w)", fixed.rolling_viscous_damping_pw, "-"),
        ("Gravity (section 2.2)", fixed.gravity, "m/s2"),
        ("Particle radius in Eq. 1 (section 2.2)", fixed.particle_radius, "m"),
    ]
    return pd.DataFrame(lines, columns=["parameter", "value", "unit"])


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [f"Input, not result: from the plan {study.plan.name}, which the study was made with."]
