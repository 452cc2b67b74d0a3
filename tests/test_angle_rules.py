"""Angles of repose beside Appendix A's, of stored heaps; the shipped model without them stays what it was."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import AngleOfReposeModel, shipped_model
from calstudy.models.measurement import HeapMeasurement, measure_heap
from calstudy.models.noise import noise_in
from calstudy.models.photograph import rules
from calstudy.models.photograph.rules import RULES, angles
from calstudy.study.definition import example, read_definition
from rendered_photographs import heaps, turned

TOP, FLANK = RULES
BEAD = 0.005


@cache
def heap() -> np.ndarray:
    return heaps()[9]


def asked(*names: str) -> AngleOfReposeModel:
    return replace(shipped_model(), also=names)


def test_the_highest_beads_stand_for_the_highest_one() -> None:
    measured = measure_heap(heap(), BEAD)
    height = np.sort(heap()[:, 2])[-30:].mean() - BEAD / 2  # to the top of a bead, less a layer
    assert angles((TOP,), heap(), BEAD, measured)[TOP] == pytest.approx(
        math.degrees(math.atan(height / measured.radius)), abs=0.2
    )


def test_one_bead_on_top_moves_appendix_a_and_not_the_mean_of_thirty() -> None:
    apex = heap()[heap()[:, 2].argmax()]
    higher = np.vstack([heap(), apex + np.array([0, 0, BEAD])])
    before, after = (measure_heap(beads, BEAD) for beads in (heap(), higher))
    assert after.angle_of_repose_deg - before.angle_of_repose_deg > 3
    found = [angles((TOP,), beads, BEAD, of)[TOP] for beads, of in ((heap(), before), (higher, after))]
    assert 0 < found[1] - found[0] < 0.5


def test_the_flanks_do_not_depend_on_where_one_stands() -> None:
    measured = measure_heap(heap(), BEAD)
    there, turned_by_a_view = (
        angles((FLANK,), turned(heap(), by), BEAD, measured)[FLANK] for by in (0, 180 / rules.VIEWS)
    )
    assert turned_by_a_view == pytest.approx(there, abs=0.2)


def test_the_flanks_of_a_cone_of_fine_grains_are_its_angle() -> None:
    rng = np.random.default_rng(1)
    at = rng.uniform(-1, 1, (4000, 2))
    at = 0.05 * at[np.hypot(*at.T) < 1]
    z = math.tan(math.radians(24)) * (0.05 - np.hypot(*at.T))
    cone = np.column_stack([at, z])
    measured = HeapMeasurement(24.0, 0.05, 0.02, stands=True)
    assert angles((FLANK,), cone, 8e-4, measured)[FLANK] == pytest.approx(24, abs=0.3)


def test_the_model_without_further_responses_is_the_shipped_one() -> None:
    assert asked().hash == shipped_model().hash
    assert [response.name for response in asked().responses] == ["angle_of_repose_deg", "bulk_density"]
    hashes = {asked(*names).hash for names in ((), (TOP,), (FLANK,), (TOP, FLANK))}
    assert len(hashes) == 4


def test_a_further_response_has_its_own_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    model = asked(TOP)
    noise = noise_in(model.noise_table, model.hash)
    assert noise is not None
    assert noise[TOP] == pytest.approx(0.56, abs=0.03)  # angle_rules.py; Appendix A has 1.11
    monkeypatch.setitem(RULES, TOP, replace(RULES[TOP], version="another/1"))
    assert asked(TOP).hash != model.hash


def write(folder: Path, target: str) -> Path:
    path = folder / "mine.toml"
    before, targets, _ = example().partition("[targets]\n")
    path.write_text(f"{before}{targets}{target}\n")
    return path


def test_a_target_asks_for_a_further_response(tmp_path: Path) -> None:
    definition = read_definition(write(tmp_path, f"{FLANK} = {{ value = 22.3, sd = 0.6 }}"))
    (chosen,) = definition.models
    assert FLANK in chosen.responses
    assert definition.task.cost.target.values == {FLANK: 22.3}
    assert definition.task.noise == pytest.approx({FLANK: 0.98}, abs=0.02)
    with pytest.raises(InputError, match="no model gives a response angle_of_repose_flank"):
        read_definition(write(tmp_path, "angle_of_repose_flank = { value = 22.3 }"))


def test_measure_gives_every_rule_of_kept_beads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "heap.parquet"
    pd.DataFrame(heap(), columns=["x", "y", "z"]).to_parquet(path)
    assert main(["measure", "--beads", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    measured = measure_heap(heap(), BEAD)
    assert found["angle_of_repose_deg"] == pytest.approx(measured.angle_of_repose_deg)
    assert {name: found[name] for name in RULES} == pytest.approx(
        angles((TOP, FLANK), heap(), BEAD, measured)
    )
    (tmp_path / "other.parquet").write_text("text")
    assert main(["measure", "--beads", str(tmp_path / "other.parquet")]) == 5
    assert "is not a table of beads" in capsys.readouterr().err
    assert main(["measure", "--beads", str(path), "--photo", "a.jpg"]) == 2


@pytest.mark.liggghts
@pytest.mark.slow
def test_a_run_gives_what_its_beads_give(tmp_path: Path) -> None:
    import threading

    from calstudy.engines.engine import ProgramEngine
    from calstudy.engines.liggghts import LIGGGHTS

    model = replace(shipped_model("tiny"), also=(TOP, FLANK))
    run = ProgramEngine(model, LIGGGHTS.find()).run(model.reference, 1, tmp_path / "run", threading.Event())
    assert run.positions is not None
    measured = measure_heap(
        run.positions,
        model.particle_diameter,
        pixels_per_mm=model.pixels_per_mm,
        sphere_diameter=model.sphere_diameter,
    )
    found = angles((TOP, FLANK), run.positions, model.particle_diameter, measured)
    assert {name: run.responses[name] for name in found} == pytest.approx(found)
