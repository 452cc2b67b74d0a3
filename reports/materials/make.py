"""Write the cards of this collection from the studies that were calibrated.

    python reports/materials/make.py

Each card comes from a study that is shipped; no DEM run is needed.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from calstudy.report.card import card_of
from calstudy.study.definition import read_definition
from calstudy.study.directory.begun import begun_with
from calstudy.study.reading import read_result
from calstudy.study.settings import read_settings

HERE = Path(__file__).parent
ROOT = HERE.parent.parent


@dataclass(frozen=True)
class Source:
    """Study of a card."""

    file: Path
    """The calibration's file."""
    study: Path
    target_kind: str
    """``given``, or ``simulated`` where the targets are a model's own responses."""


SOURCES = {
    "glass_beads_heap": Source(ROOT / "plans/glass_beads.toml", ROOT / "reports/glass_beads/study", "given"),
    "glass_beads_photographs": Source(
        HERE / "photographs/calibration.toml", HERE / "photographs/study", "simulated"
    ),
    "glass_beads_three_tests": Source(
        ROOT / "reports/material_tests/three_tests/glass_beads_three.toml",
        ROOT / "reports/material_tests/three_tests/study",
        "simulated",
    ),
    "glass_beads_held_out": Source(
        HERE / "holdout/same_walls/calibration.toml", HERE / "holdout/same_walls/study", "simulated"
    ),
    "glass_beads_rough_walls": Source(
        HERE / "holdout/rough_walls/rough_walls.toml", HERE / "holdout/rough_walls/study", "simulated"
    ),
}
"""Studies by the name of their card."""


def content(name: str, source: Source) -> dict[str, object]:
    """Content of the card of a study."""
    definition = read_definition(source.file, (), False, *begun_with(source.study))
    result = read_result(source.study, definition, read_settings(source.study))
    assert result is not None
    card = card_of(result, source.target_kind, name)
    assert card is not None
    return card


def main() -> None:
    """Write all cards."""
    for name, source in SOURCES.items():
        path = HERE / f"{name}.json"
        path.write_text(json.dumps(content(name, source), indent=1) + "\n")
        print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
