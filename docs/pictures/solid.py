"""Draws the pictures of solid.md from the shipped bands, and prints the tables of its text.

python docs/pictures/solid.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pandas as pd
from style import STYLE, save

from calstudy.analysis.replicates.entries import ALL_ROWS

EMULATED = Path(__file__).parents[2] / "reports" / "emulated"
COLOURS = {
    "full-ring": "black",
    "soft-ring": "tab:blue",
    "soft-ring-twin": "tab:green",
    "soft-wide": "tab:orange",
}
NAMES = {
    "full-ring": "full, plate that ends at the ring, 22 deg",
    "soft-ring": "soft, the same",
    "soft-ring-twin": "soft, its own angle as target",
    "soft-wide": "soft, wide plate, 22 deg",
}
SHORT = {"full-ring": "full", "soft-ring": "ring", "soft-ring-twin": "twin", "soft-wide": "wide"}
PUBLISHED = "tab:red"
CLAIMS = {
    "C01": "3/4 of the rows within 15 % of the angle",
    "C02": "9 in 10 within 5 % of the bulk density",
    "C03": "every row ends by small improvement",
    "C04": "DENS ends near the top, YM near the bottom",
    "C05": "MU_PW and RF_PW end all over",
    "C06": "Kriging's optima are nearly the DEM's",
    "C07": "both models' responses go together",
    "C08": "Kriging: main effects alone significant",
    "C09": "DEM: these four interactions, not MU_PW",
    "C10": "MU_PP and RF_PP the one correlated pair",
    "C11": "WRL makes the time-step larger",
    "C12": "WRL leaves the angle alone",
    "C13": "WRL raises bulk density by < 5 %",
    "C14": "second optimisation takes 10 to 55 runs",
    "C15": "more samples save runs, not at WRL = 1",
    "C16": "runs grow with SPP",
    "C17": "51 runs a calibration",
    "C18": "SPP does not change the responses",
    "C21": "static and rolling friction uncorrelated",
    "C22": "the second optimisation improves the cost",
    "C23": "YM changes neither response",
}
"""Claims that replicates can decide, in a few words (C19 is of the plan, C20 of the cost of DEM)."""
SELDOM, OFTEN = 0.2, 0.8


def tables(name: str) -> dict[str, pd.DataFrame]:
    """Shipped studies' tables of that name, each by the study's folder."""
    return {
        study: pd.read_csv(EMULATED / study / "tables" / f"{name}.csv")
        for study in COLOURS
        if (EMULATED / study).exists()
    }


def shares(column: str) -> pd.DataFrame:
    """Share of replicates by claim (lines) and study (columns)."""
    found = {
        study: table.dropna(subset=[column]).set_index("where")[column]
        for study, table in tables("bands_claims").items()
    }
    return pd.DataFrame(found).loc[list(CLAIMS)]


def kind(line: pd.Series) -> str:
    """What a claim is, from the share of replicates in which its figures lie within its limits."""
    if (line >= OFTEN).all():
        return "solid"
    if (line <= SELDOM).all():
        return "not found"
    if line.max() >= OFTEN and line.min() <= SELDOM:
        return "the deck or the target decides"
    return "luck"


def claims() -> None:
    """Print and draw how often each claim would have been made."""
    met, holds = shares("met"), shares("holds")
    print("| | claim, in our words | " + " | ".join(SHORT[study] for study in met) + " | |")
    print("|---" * (len(met.columns) + 3) + "|")
    for claim, label in CLAIMS.items():
        cells = " | ".join(f"{met.loc[claim, s]:.2f} ({holds.loc[claim, s]:.2f})" for s in met)
        print(f"| {claim} | {label} | {cells} | {kind(met.loc[claim])} |")
    figure, axes = plt.subplots(figsize=(8, 5.2))
    for y, claim in enumerate(CLAIMS):
        axes.axhline(y, color="0.92", zorder=0)
        for k, study in enumerate(met):
            offset = 0.2 * (k - (len(met.columns) - 1) / 2)
            axes.plot(met.loc[claim, study], y + offset, "o", ms=4.5, color=COLOURS[study])
    for study in met:
        axes.plot([], [], "o", color=COLOURS[study], label=NAMES[study])
    for at in (SELDOM, OFTEN):
        axes.axvline(at, color="0.6", lw=0.8, ls=":")
    axes.set(xlim=(-0.03, 1.03), xlabel="share of the replicates whose numbers meet the claim")
    axes.set_yticks(range(len(CLAIMS)), [f"{label}  {claim}" for claim, label in CLAIMS.items()])
    axes.invert_yaxis()
    figure.legend(frameon=False, ncols=2, loc="lower center")
    save(figure, "solid-claims.png", bottom=0.09)


def changed() -> None:
    """Print how often each claim holds, is open and does not hold by the rule that was changed."""
    every = {
        study: table.dropna(subset=["holds"]).set_index("where")
        for study, table in tables("bands_claims").items()
    }
    print("\n| | " + " | ".join(SHORT[study] for study in every) + " |")
    print("|---" * (len(every) + 1) + "|")
    for claim in CLAIMS:
        lines = [
            table.loc[[f"{claim}, changed"]] for table in every.values() if f"{claim}, changed" in table.index
        ]
        if lines:
            said = (line[["holds", "open", "fails"]].iloc[0] for line in lines)
            print(f"| {claim} | " + " | ".join(", ".join(f"{x:.2f}" for x in three) for three in said) + " |")


def correlations() -> None:
    """Draw the bands of Tables 4 and 6 and the shares of Table 5, with the published values."""
    figure, panels = plt.subplots(1, 3, figsize=(9.5, 4.6), width_ratios=(1, 1, 1.2))
    every = tables("bands")
    first = next(iter(every.values()))
    for panel, where in zip(panels, ("Table 4", "Table 6", "Table 5"), strict=True):
        chosen = first[(first["where"] == where) & ~first["entry"].str.endswith(ALL_ROWS.format(""))]
        names = [e for e in chosen["entry"] if where != "Table 5" or e.startswith("DEM")]
        for k, (study, table) in enumerate(every.items()):
            lines = table[table["where"] == where].set_index("entry").loc[names]
            y = [n + 0.2 * (k - (len(every) - 1) / 2) for n in range(len(names))]
            if where == "Table 5":
                panel.plot(lines["significant"], y, "o", ms=4, color=COLOURS[study])
            else:
                panel.hlines(y, lines["low"], lines["high"], color=COLOURS[study], lw=3, alpha=0.5)
                panel.plot(lines["median"], y, "|", ms=7, color=COLOURS[study])
        said = chosen.set_index("entry").loc[names, "published"]
        x = (said < 0.05).astype(float) if where == "Table 5" else said
        panel.plot(x, range(len(names)), "D", ms=4.5, mfc="none", color=PUBLISHED)
        panel.set_yticks(range(len(names)), [n.removeprefix("DEM: ") for n in names])
        panel.invert_yaxis()
        panel.set_title(where)
        panel.set_xlabel("share with p < 0.05, DEM optima" if where == "Table 5" else "correlation")
    for study in every:
        panels[0].plot([], [], "s", color=COLOURS[study], label=NAMES[study])
    panels[0].plot([], [], "D", mfc="none", color=PUBLISHED, label="published")
    figure.legend(frameon=False, ncols=3, loc="lower center")
    save(figure, "solid-tables.png", bottom=0.1)


if __name__ == "__main__":
    with mpl.rc_context(STYLE):
        claims()
        changed()
        correlations()
