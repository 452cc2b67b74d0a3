"""Runs of a DEM model that is known: smooth responses of the five inputs, with normal noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from calstudy.emulator.similarity import inputs_box, inputs_of
from calstudy.models.angle_of_repose import load_model
from calstudy.plan_file import load_plan
from calstudy.records import Phase, Request
from calstudy.study.sweep import Line
from shipped_model import SIMILARITY, SWEEP

PLAN = load_plan()
BOX = inputs_box(PLAN.parameters, SIMILARITY)
ENGINE = "LIGGGHTS 3.8.0"
EXPENSIVE, CHEAP = "coarse", "tiny"

Function = Callable[[np.ndarray], np.ndarray]


def angle(u: np.ndarray) -> np.ndarray:
    """Angle of repose at the expensive fidelity, deg; hardly bent, as measured ones are."""
    return 22.0 + 6.0 * u[:, 0] + 4.0 * np.sqrt(0.1 + u[:, 2]) - 1.5 * u[:, 0] * u[:, 2] + 0.3 * u[:, 4]


def solid_fraction(u: np.ndarray) -> np.ndarray:
    """Solid fraction at the expensive fidelity."""
    return 0.62 - 0.02 * u[:, 0] - 0.005 * u[:, 1] + 0.004 * u[:, 0] ** 2


def angle_noise(u: np.ndarray) -> np.ndarray:
    """Standard deviation of the angle from seed to seed; it doubles over MU_PP's interval."""
    return 0.5 * np.exp(0.8 * (u[:, 0] - 0.5))


FRACTION_NOISE = 0.001


def synthetic_runs(
    design: Sequence[Line], angle_of: Function = angle, seed: int = 0, left_out: Sequence[str] = ()
) -> pd.DataFrame:
    """A sweep's table as LIGGGHTS would leave it; the cheap fidelity is 1.2 deg flatter and packs denser.

    Angles of the labels ``left_out`` cannot be measured.
    """
    rng = np.random.default_rng(seed)
    models = {f: load_model(PLAN.fixed, f) for f in {line.fidelity for line in design}}
    frame = pd.DataFrame([dict(line.parameters) for line in design])
    u = BOX.to_unit(inputs_of(frame, SIMILARITY))
    is_cheap = np.array([line.fidelity == CHEAP for line in design])
    frame["label"] = [line.label for line in design]
    frame["fidelity"] = [line.fidelity for line in design]
    frame["variant"] = [line.variant for line in design]
    frame["seed"] = [line.seed for line in design]
    frame["angle_of_repose_deg"] = angle_of(u) - 1.2 * is_cheap + angle_noise(u) * rng.standard_normal(len(u))
    fraction = solid_fraction(u) + 0.004 * is_cheap + FRACTION_NOISE * rng.standard_normal(len(u))
    frame["bulk_density"] = frame["DENS"] * fraction
    frame["rayleigh_time_step"] = 1e-5
    frame["outcome"] = np.where(frame["label"].isin(left_out), "unmeasurable", "ok")
    frame.loc[frame["outcome"] != "ok", "angle_of_repose_deg"] = np.nan
    frame["model"], frame["deck"], frame["engine"] = "angle_of_repose", models[EXPENSIVE].deck, ENGINE
    frame["model_hash"] = [models[line.fidelity].hash for line in design]
    frame["run_id"] = [
        Request(0, Phase.SAMPLING, 0, line.parameters, line.seed).run_id(models[line.fidelity].hash, ENGINE)
        for line in design
    ]
    frame["cpu_time"] = np.where(is_cheap, 4.0, 9.0)
    return frame.reindex(columns=[column.name for column in SWEEP])
