"""The page on three programs says what its runs say."""

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.models.find import model_folder
from calstudy.models.folder import load_folder
from calstudy.models.noise import known_noise

FOLDER = Path(__file__).parent.parent / "reports" / "cross_code"


@pytest.fixture(scope="module")
def summarise():
    sys.path.insert(0, str(FOLDER))
    import summarise as module

    yield module
    sys.path.remove(str(FOLDER))


@pytest.fixture(scope="module")
def runs(summarise):
    return summarise.runs_of_all()


def test_the_tables_come_out_again(summarise, runs):
    def numbers(text):
        return [float(x) for x in re.findall(r"[-+]?\d+(?:\.\d+)?", text)]

    made, shipped = summarise.tables(runs), (FOLDER / "tables.md").read_text()
    assert re.sub(r"[-+\d.]+", "", made) == re.sub(r"[-+\d.]+", "", shipped)
    assert numbers(made) == pytest.approx(numbers(shipped), rel=1e-6, abs=1.01e-1)


@pytest.mark.parametrize(("code", "fidelity"), [("lammps", "coarse"), ("yade", "tiny")])
def test_the_runs_and_the_noise_are_of_the_shipped_model(runs, code, fidelity):
    model = load_folder(model_folder(f"angle_of_repose_{code}"), fidelity=fidelity)
    assert set(runs[code]["model_hash"]) == {model.hash}
    assert known_noise(model.name, model.hash)


def test_a_surface_is_read_where_it_is_known(summarise):
    rng = np.random.default_rng(1)
    unit = rng.random((200, len(summarise.PARAMETERS)))
    ends = [(p.lower, p.upper) for p in summarise.PARAMETERS]
    points = pd.DataFrame(
        {
            p.name: low + u * (high - low)
            for p, u, (low, high) in zip(summarise.PARAMETERS, unit.T, ends, strict=True)
        }
    )
    points["bulk_density"] = points["DENS"] * (0.6 - 0.1 * points["MU_PP"])
    fit = summarise.fitted(points, "bulk_density", 1)
    assert fit.params["MU_PP"] == pytest.approx(-0.1 * 2500 * 0.2)
    assert fit.params["DENS"] == pytest.approx(0, abs=1e-9)
