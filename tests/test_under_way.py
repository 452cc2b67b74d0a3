"""A calibration is read from its directory alone: under way, finished, and after its file was changed."""

import os
import subprocess
import sys

import numpy as np
import pytest

from calstudy.errors import StoreError
from calstudy.study.run.under_way import definition_there, evaluations_there, read_finished, so_far
from fake_liggghts import COMMAND

FILE = """
mode = "robust"
seed = 1
WRL = 0.0
budget = 3
confirm = 1
[[models]]
name = "angle_of_repose"
fidelity = "tiny"
[parameters]
DENS = 2500.0
MU_PP = [0.1, 0.3]
MU_PW = 0.2
RF_PP = [0.001, 0.1]
RF_PW = 0.01
YM = 4.175e8
[targets]
angle_of_repose_deg = { value = 25.0, tolerance = 2.0 }
"""


@pytest.mark.slow
def test_what_the_runs_tell_under_way_is_what_they_tell_in_the_end(tmp_path):
    file, study = tmp_path / "case.toml", tmp_path / "study"
    file.write_text(FILE)
    definition = definition_there(file, study)
    assert evaluations_there(study) == []
    assert read_finished(definition, study) is None
    words = [
        sys.executable,
        "-m",
        "calstudy",
        "calibrate",
        str(file),
        "--study",
        str(study),
        "--workers",
        "1",
    ]
    environment = os.environ | {"CALSTUDY_LIGGGHTS": COMMAND, "OMP_NUM_THREADS": "1"}
    subprocess.run(words, env=environment, check=False, capture_output=True)
    definition = definition_there(file, study)
    result, evaluations = read_finished(definition, study), evaluations_there(study)
    found = so_far(definition, study, evaluations)
    assert len(found.evaluations) == result.line["runs_total"]
    assert np.allclose(
        found.surrogates.predict(found.optimum_point[None]),
        result.surrogates.predict(found.optimum_point[None]),
    )
    angles = [e.run.responses["angle_of_repose_deg"] for e in evaluations]
    assert found.responses["angle_of_repose_deg"] == min(angles, key=lambda angle: abs(angle - 25.0))
    assert so_far(definition, study, evaluations[:0]) is None
    file.write_text(FILE.replace("value = 25.0", "value = 26.0"))
    with pytest.raises(StoreError, match="was begun with other settings"):
        definition_there(file, study)
