"""What the scripts that draw the documentation's pictures share."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

IMAGES = Path(__file__).parents[1] / "images"
STYLE = {"figure.dpi": 110, "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}


def save(figure: plt.Figure, name: str, bottom: float = 0.0) -> None:
    """Write a picture small and without a date, so that drawing it again changes nothing.

    ``bottom`` is the share of its height that is left to a legend.
    """
    figure.tight_layout(rect=(0.0, bottom, 1.0, 1.0))
    figure.savefig(IMAGES / name, metadata={"Software": None}, pil_kwargs={"optimize": True})
    plt.close(figure)
