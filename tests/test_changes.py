"""What differs between two studies, in words."""

from copy import deepcopy

import pytest

from calstudy.study.settings import changes

CONTENT = {
    "plan": "calibration beads",
    "plan_hash": "aaaa",
    "model_hash": "bbbb",
    "fidelity": "tiny",
    "variant": "ring",
    "engine": "LIGGGHTS 3.8.0",
    "mode": "robust",
    "budget": None,
    "seed": 1,
    "target": {"values": {"angle_of_repose_deg": 22.0}, "kind": "set", "origin": "22 deg", "truth": None},
    "case": {
        "parameters": {"MU_PP": "-", "MU_PW": "-"},
        "models": {"bbbb": {"fidelity": "tiny"}},
        "definition": {
            "parameters": {"MU_PP": [0.1, 0.3], "MU_PW": 0.2},
            "WRL": 0.1,
            "samples": None,
            "tolerances": {"angle_of_repose_deg": 2.0},
            "noise": None,
            "models": {"angle_of_repose": "bbbb"},
        },
    },
}


def changed(*settings):
    content = deepcopy(CONTENT)
    for dotted, value in settings:
        *way, last = dotted.split("/")
        inside = content
        for name in way:
            inside = inside[name]
        inside[last] = value
    return changes(CONTENT, content)


HASHES = (("plan_hash", "cccc"), ("model_hash", "dddd"), ("case/definition/models/angle_of_repose", "dddd"))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([], []),
        (
            [("target/values/angle_of_repose_deg", 25.0), ("target/origin", "25 deg")],
            ["the target of angle_of_repose_deg: 22 → 25"],
        ),
        (
            [("target/origin", "a twin"), ("target/truth", {"MU_PP": 0.2})],
            ["the target comes from elsewhere"],
        ),
        (
            [("case/definition/parameters/MU_PP", [0.1, 0.4]), ("plan_hash", "cccc")],
            ["the interval of MU_PP: [0.1, 0.3] → [0.1, 0.4]"],
        ),
        ([("case/definition/parameters/MU_PW", [0.1, 0.3])], ["MU_PW: 0.2 → [0.1, 0.3]"]),
        (
            [("case/definition/tolerances/angle_of_repose_deg", 3.0)],
            ["the tolerance of angle_of_repose_deg: 2 → 3"],
        ),
        ([("budget", 4)], ["the budget of the second optimisation: none → 4"]),
        ([("case/definition/WRL", 0.1000000001)], ["WRL: 0.1 → 0.1000000001"]),
        ([("fidelity", "soft"), *HASHES], ["the fidelity: tiny → soft"]),
        ([*HASHES], ["the model's files or fixed inputs are others"]),
        ([("seed", 2), *HASHES], ["the seed: 1 → 2", "the model's files or fixed inputs are others"]),
        ([("brand_new", True)], ["brand_new: none → yes"]),
    ],
)
def test_each_change_is_told_once_in_words(settings, words):
    assert changed(*settings) == words
