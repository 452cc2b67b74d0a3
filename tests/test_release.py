"""What a release needs: one version everywhere, and constraints that name and allow all that is installed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from calstudy.study.definition import read_definition
from calstudy.study.directory.begun import begun_with, difference, version_there
from calstudy.study.run.taking import settings_of
from calstudy.study.settings import read_settings

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version))


def test_one_version_stands_everywhere() -> None:
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.M)
    top = re.search(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert cited is not None and top is not None
    assert PROJECT["version"] == cited[1]
    assert numbers(top[1]) >= numbers(PROJECT["version"])  # the top heading is the version to come


def test_the_constraints_name_each_dependency_and_meet_its_bound() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    held = dict(line.split("==") for line in lines if not line.startswith("#"))
    for requirement in PROJECT["dependencies"]:
        name, _, least = requirement.partition(">=")
        assert name in held, f"{name} is not in constraints.txt"
        assert numbers(held[name]) >= numbers(least)


def test_what_a_release_says_of_itself_is_in_the_source_distribution() -> None:
    included = (ROOT / "MANIFEST.in").read_text().split("include ")[1].split("\n")[0].split()
    assert {"CHANGELOG.md", "CITATION.cff", "SECURITY.md", "constraints.txt"} <= set(included)
    assert all((ROOT / name).is_file() for name in included)


def test_a_study_that_the_version_before_began_goes_on() -> None:
    folder = ROOT / "reports" / "materials" / "photographs"
    study = folder / "study"
    definition = read_definition(folder / "calibration.toml", (), False, *begun_with(study))
    assert read_settings(study).calstudy == version_there(study) == "0.2.0"
    assert difference(study, settings_of(definition, "LIGGGHTS 3.8.0", version_there(study))) == []
