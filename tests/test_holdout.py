"""Responses that are held out: no part in the cost, a criterion that was fixed before any run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calstudy.cli.main import main
from calstudy.errors import InputError
from calstudy.report.card import Card, read_card
from calstudy.study.definition import example, read_definition
from calstudy.study.settings import changes
from fake_liggghts import COMMAND

FLANK = "angle_of_repose_flank_deg"
CHANGES = (
    ('fidelity = "soft"', 'fidelity = "tiny"'),
    ("YM = [4.175e8, 6.5e8]", "YM = 5.06e8"),
    ("value = 22.0, tolerance = 2.0", "value = 26.0, tolerance = 1.5"),
    ("tolerance = 15.0", "tolerance = 40.0"),
)


def write(folder: Path, holdout: str, name: str = "beads.toml") -> Path:
    text = example()
    for old, new in CHANGES:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = folder / name
    path.write_text(f"{text}\n{holdout}\n")
    return path


def held(value: float, tolerance: float = 1.0, name: str = FLANK) -> str:
    return f"[holdout]\n{name} = {{ value = {value}, tolerance = {tolerance} }}"


def test_what_is_held_out_takes_no_part_in_the_cost(tmp_path: Path) -> None:
    without, with_it = (read_definition(write(tmp_path, text)) for text in ("", held(22.0)))
    assert with_it.task.cost.target == without.task.cost.target
    (one,) = with_it.held_out
    assert (one.response, one.unit, one.value, one.tolerance) == (FLANK, "deg", 22.0, 1.0)
    assert FLANK in with_it.models[0].responses


def test_the_criterion_is_part_of_the_study(tmp_path: Path) -> None:
    one, other = (read_definition(write(tmp_path, held(22.0, tolerance))) for tolerance in (1.0, 2.0))
    assert one.hash != other.hash
    before, after = ({"case": {"definition": d.case.definition}} for d in (one, other))
    assert changes(before, after) == [f"the hold-out {FLANK}.tolerance: 1 → 2"]
    assert "holdout" not in read_definition(write(tmp_path, "")).case.definition


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (
            held(22.0, name="angle_of_repose_deg"),
            "what is calibrated to cannot be held out",
        ),
        (held(22.0, name="angle"), "no model gives a response angle"),
        (held(22.0, tolerance=0.0), "must be positive"),
        (f"[holdout]\n{FLANK} = {{ value = 22.0 }}", "lacks tolerance"),
        (f"[holdout]\n{FLANK} = {{ value = 22.0, tolerance = 1.0, sd = 1.0 }}", "key sd is unknown"),
    ],
)
def test_a_wrong_hold_out_is_refused_with_its_line(text: str, what: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=what) as refused:
        read_definition(write(tmp_path, text))
    assert ", line " in str(refused.value)


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_profiles")
def test_report_and_card_say_whether_it_passed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.setenv("FAKE_LIGGGHTS_LOG", str(tmp_path / "called"))
    monkeypatch.chdir(tmp_path)
    verdicts = {}
    for name, tolerance in (("wide.toml", 60.0), ("narrow.toml", 1e-6)):
        main(["calibrate", str(write(tmp_path, held(30.0, tolerance), name))])
        said = " ".join(capsys.readouterr().out.split())
        report = tmp_path / "studies" / name.removesuffix(".toml") / "report"
        card = read_card(report / "material.json").content["holdout"][FLANK]
        assert card["runs"] == 4 and card["tolerance"] == tolerance  # those that confirm, not the chosen one
        assert "Hold-out" in (report / "report.html").read_text()
        word = "passed" if card["passed"] else "FAILED"
        assert f"hold-out {FLANK} {word}: {card['mean']:.4g}" in said
        verdicts[name] = card["passed"]
        # What passed is tested again like a response; what failed is no claim of the card.
        main(["check", str(report / "material.json"), "--seeds", "2", "--json"])
        tested = [one["response"] for one in json.loads(capsys.readouterr().out)["responses"]]
        assert (FLANK in tested) == card["passed"]
        main(["check", str(report / "material.json"), "--seeds", "2"])
        told = " ".join(capsys.readouterr().out.split())
        assert (f"because they failed when the card was written: {FLANK}" in told) == (not card["passed"])
    assert verdicts == {"wide.toml": True, "narrow.toml": False}


def test_a_card_claims_its_responses_and_the_hold_outs_that_passed() -> None:
    passed, failed = ({"unit": "deg", "value": 1.0, "tolerance": 1.0, "passed": p} for p in (True, False))
    content = {"responses": {"a": {"unit": "deg", "target": 2.0}}, "holdout": {"b": passed, "c": failed}}
    card = Card(Path("card.json"), content)
    assert card.claims["b"] == {"unit": "deg", "target": 1.0, "good_enough": 1.0}
    assert [*card.claims] == ["a", "b"]


def test_the_settings_are_json(tmp_path: Path) -> None:
    (one,) = read_definition(write(tmp_path, held(22.0))).held_out
    assert json.loads(json.dumps(one.settings)) == {"value": 22.0, "tolerance": 1.0}
