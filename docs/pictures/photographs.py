"""Three photographs of heaps of the same beads, rendered from stored runs, for the page on photographs.

    python docs/pictures/photographs.py

The heaps are runs of the shipped model at its reference parameters, `soft` fidelity, with three seeds. What a
laboratory would photograph is not known so well: that is why they are rendered.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import pandas as pd
import style

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "tests"))
from rendered_photographs import NOISE, Scene, photograph

SCENES = (
    Scene(width=960, height=640, across=0.24, sphere=True, pitch_deg=1.5, roll_deg=1.5, light_deg=40),
    Scene(
        width=960, height=640, across=0.24, hand=True, pitch_deg=1.0, azimuth_deg=90, wall=(0.3, 0.32, 0.35)
    ),
    Scene(width=960, height=640, across=0.20, ruler=True, pitch_deg=0.5, azimuth_deg=30, light_deg=-50),
)


def main() -> None:
    """Write the photographs."""
    runs = pd.read_parquet(NOISE / "runs.parquet")
    chosen = runs[(runs["fidelity"] == "soft") & (runs["label"] == "reference")]["run_id"]
    kept = pd.read_parquet(NOISE / "heaps.parquet")
    for k, (run_id, scene) in enumerate(zip(chosen, SCENES, strict=False), 1):
        beads = kept[kept["run_id"] == run_id][["x", "y", "z"]].to_numpy(float)
        picture = photograph(beads, 0.005, scene, k)
        cv2.imwrite(str(style.IMAGES / f"photograph{k}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
