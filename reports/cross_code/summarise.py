"""Turns the runs of three DEM programs into tables.md, a picture, and noise.csv of the others' models.

    python reports/cross_code/summarise.py

LIGGGHTS's responses over the box are a quadratic surface through its runs at `coarse` of other reports:
the rows of coarse-rows in both modes, their optima run again, and the corners of angle_of_repose/noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import statsmodels.api as sm
from scipy.stats import t

from calstudy.models.find import NOISE_FILE, model_folder
from calstudy.models.folder import FolderModel, load_folder
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, REFERENCE
from calstudy.models.noise import difference, noise_table
from calstudy.models.targets import RepeatedRuns, write_twin
from calstudy.plan_file import load_plan

matplotlib.use("Agg")
from matplotlib import pyplot as plt

HERE = Path(__file__).parent
REPORTS, ROOT = HERE.parent, HERE.parents[1]
PARAMETERS = load_plan().parameters
UNITS = {ANGLE_OF_REPOSE: ("angle", "deg", 1), BULK_DENSITY: ("bulk density", "kg/m3", 0)}
MODES = ("paper", "robust")


def of_folder(place: Path, pattern: str) -> pd.DataFrame:
    """Lines of all tables of a folder; empty where there are none."""
    found = [pd.read_parquet(path) for path in sorted(place.glob(pattern))]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


def usable(*parts: pd.DataFrame) -> pd.DataFrame:
    """Runs that gave a heap, each once."""
    runs = pd.concat([part for part in parts if len(part)], ignore_index=True)
    return runs[runs["outcome"] == "ok"].drop_duplicates("run_id").reset_index(drop=True)


def columns(points: pd.DataFrame, degree: int) -> pd.DataFrame:
    """Parameters over their intervals, from -1/2 to 1/2, with a constant, and their products at degree 2."""
    unit = {p.name: (points[p.name] - p.lower) / (p.upper - p.lower) - 0.5 for p in PARAMETERS}
    names = list(unit)
    more = (
        {f"{a} {b}": unit[a] * unit[b] for k, a in enumerate(names) for b in names[k:]} if degree > 1 else {}
    )
    return sm.add_constant(pd.DataFrame(unit | more), has_constant="add")


def packed(runs: pd.DataFrame, response: str) -> pd.Series:
    """A response; the bulk density at the reference point's DENS, to which it is proportional."""
    return runs[response] * (REFERENCE["DENS"] / runs["DENS"] if response == BULK_DENSITY else 1.0)


def fitted(runs: pd.DataFrame, response: str, degree: int) -> sm.regression.linear_model.RegressionResults:
    """Least squares through a response over the box."""
    return sm.OLS(packed(runs, response), columns(runs, degree)).fit()


def markdown(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """A Markdown table."""
    return [f"| {' | '.join(map(str, line))} |" for line in (head, ["---"] * len(head), *rows)] + [""]


def at_points(first: pd.DataFrame, other: pd.DataFrame, names: tuple[str, str]) -> list[str]:
    """Means of both programs at each label, and their difference with its 90 % interval."""
    rows = []
    for label in dict.fromkeys(other["label"]):
        for response, (called, unit, digits) in UNITS.items():
            a, b = (runs[runs["label"] == label][response].to_numpy() for runs in (first, other))
            bias, half = difference(b, a)
            cells = [f"{x.mean():.{digits}f} ± {x.std(ddof=1):.{digits}f} ({len(x)})" for x in (a, b)]
            rows.append((label, f"{called}, {unit}", *cells, f"{bias:+.{digits}f} ± {half:.{digits}f}"))
    return markdown(("point", "response", *names, "difference, 90 % interval"), rows)


def over_the_box(liggghts: pd.DataFrame, lammps: pd.DataFrame) -> list[str]:
    """LAMMPS at points that fill the box against LIGGGHTS's surface there."""
    box = lammps[lammps["label"].str.startswith("box")]
    rows = []
    for response, (called, unit, digits) in UNITS.items():
        surface = fitted(liggghts, response, 2)
        predicted = surface.get_prediction(columns(box, 2))
        off = packed(box, response).to_numpy() - predicted.predicted_mean
        half = t.ppf(0.95, len(off) - 1) * off.std(ddof=1) / np.sqrt(len(off))
        noise = packed(lammps[lammps["label"] == "reference"], response).std(ddof=1)
        rows.append(
            (
                f"{called}, {unit}",
                len(box),
                f"{off.mean():+.{digits}f} ± {half:.{digits}f}",
                f"{off.min():+.{digits}f} to {off.max():+.{digits}f}",
                f"{off.std(ddof=1):.{digits}f}",
                f"{noise:.{digits}f}, {np.sqrt(surface.scale):.{digits}f}",
                f"{np.mean(predicted.se_mean):.{digits + 1}f}",
            )
        )
    head = (
        "response",
        "points",
        "LAMMPS - LIGGGHTS, mean",
        "range",
        "sd",
        "noise of a run: LAMMPS, LIGGGHTS",
    )
    return markdown((*head, "standard error of the surface"), rows)


def effects(liggghts: pd.DataFrame, lammps: pd.DataFrame) -> list[str]:
    """What each parameter does to a response from one end of its interval to the other, by each program."""
    rows = []
    for response, (called, unit, digits) in UNITS.items():
        fits = [fitted(runs, response, 1) for runs in (liggghts, lammps)]
        for p in PARAMETERS:
            cells = [f"{fit.params[p.name]:+.{digits}f} ± {fit.bse[p.name]:.{digits}f}" for fit in fits]
            rows.append((f"{called}, {unit}", p.name, *cells))
    return markdown(
        ("response", "parameter", f"LIGGGHTS ({len(liggghts)} runs)", f"LAMMPS ({len(lammps)})"), rows
    )


def rows_of(mode: str, place: Path, program: str, wanted: Sequence[int]) -> list[tuple[object, ...]]:
    """Lines of the table of rows."""
    found = of_folder(place, "calibrations/*.parquet")
    lines = []
    for _, line in found[found["row"].isin(wanted)].iterrows():
        free = [p.name for p in PARAMETERS if line[f"calibrated_{p.name}"]]
        optimum = ", ".join(f"{name} {line[f'dem_{name}']:.4g}" for name in free)
        reached = [f"{line[f'dem_{r}']:.{d}f} ({line[f'target_{r}']:.{d}f})" for r, (*_, d) in UNITS.items()]
        lines.append((line["row"], mode, f"{line['WRL']:g}", program, line["runs_total"], *reached, optimum))
    return lines


def ship_noise(runs: pd.DataFrame, model: FolderModel) -> None:
    """Write the model's noise.csv from the runs at its labelled points."""
    table = noise_table(runs[~runs["label"].str.startswith("box")], model).drop(columns="variant")
    table = table.drop(columns=[name for name in table if "_bias" in name])
    path = ROOT / "liggghts_models" / model.name / NOISE_FILE
    table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")


def ship_twin(runs: pd.DataFrame, model: FolderModel) -> None:
    """Write the twin of the rows: means at the reference point."""
    there = runs[runs["label"] == "reference"]
    mean, sd = (
        {name: float(x) for name, x in of.items()}
        for of in (there[[*MEASURED]].mean(), there[[*MEASURED]].std())
    )
    command = "calstudy sweep reports/cross_code/lammps/design.csv, label reference"
    write_twin(
        HERE / "twins.csv",
        model,
        there["engine"].iloc[0],
        REFERENCE,
        RepeatedRuns(mean, sd, len(there), 0),
        command,
    )


def picture(liggghts: pd.DataFrame, lammps: pd.DataFrame, tiny: pd.DataFrame, yade: pd.DataFrame) -> None:
    """Each program's responses against LIGGGHTS's at the same parameters."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    for ax, (response, (called, unit, _)) in zip(axes, UNITS.items(), strict=True):
        surface = fitted(liggghts, response, 2)
        expected = surface.get_prediction(columns(lammps, 2)).predicted_mean
        at = lammps["DENS"] / REFERENCE["DENS"] if response == BULK_DENSITY else 1.0
        ax.plot(expected * at, lammps[response], "o", color="#0072B2", label="LAMMPS, coarse")
        means = [runs.groupby("label")[response].mean() for runs in (tiny, yade)]
        ax.plot(means[0][means[1].index], means[1], "^", color="#D55E00", label="YADE, tiny, means of 3")
        ends = [min(ax.get_xlim()[0], ax.get_ylim()[0]), max(ax.get_xlim()[1], ax.get_ylim()[1])]
        ax.plot(ends, ends, color="0.5", linewidth=1, label="equal")
        ax.set(
            xlabel=f"{called} by LIGGGHTS, {unit}",
            ylabel=f"{called} by the other program, {unit}",
            aspect="equal",
        )
    axes[0].legend(frameon=False)
    figure.savefig(ROOT / "docs" / "images" / "cross_code.png", dpi=150, metadata={"Software": None})


def runs_of_all() -> dict[str, pd.DataFrame]:
    """Runs by what they are: LIGGGHTS's, LAMMPS's sweep and with its rows, YADE's, and LIGGGHTS's corners."""
    rows = REPORTS / "coarse-rows"
    noise = pd.read_parquet(REPORTS / "angle_of_repose" / "noise" / "runs.parquet")
    corners = {f: noise[(noise["fidelity"] == f) & (noise["variant"] == "ring")] for f in ("coarse", "tiny")}
    evaluations = [of_folder(rows / mode, "evaluations/*.parquet") for mode in MODES]
    again = pd.read_parquet(rows / "again" / "runs.parquet")
    sweep = usable(pd.read_parquet(HERE / "lammps" / "runs.parquet"))
    return {
        "liggghts": usable(corners["coarse"], again, *evaluations),
        "sweep": sweep,
        "lammps": usable(sweep, *(of_folder(HERE / mode, "evaluations/*.parquet") for mode in MODES)),
        "yade": usable(pd.read_parquet(HERE / "yade" / "runs.parquet")),
        **corners,
    }


def tables(runs: dict[str, pd.DataFrame]) -> str:
    """All tables as Markdown."""
    rows = []
    for mode in MODES:
        made = sorted(of_folder(HERE / mode, "calibrations/*.parquet")["row"])
        rows += rows_of(mode, REPORTS / "coarse-rows" / mode, "LIGGGHTS", made)
        rows += rows_of(mode, HERE / mode, "LAMMPS", made)
    reference = runs["sweep"][runs["sweep"]["label"] == "reference"]
    head = (
        "row",
        "mode",
        "WRL",
        "program",
        "DEM runs",
        "angle (target), deg",
        "bulk density (target), kg/m3",
    )
    parts = {
        "LAMMPS at the reference point, `coarse`": at_points(
            runs["coarse"], reference, ("LIGGGHTS (runs)", "LAMMPS (runs)")
        ),
        "LAMMPS over the box, `coarse`": over_the_box(runs["liggghts"], runs["sweep"]),
        "Effects, from one end of the interval to the other": effects(runs["liggghts"], runs["lammps"]),
        "Rows of the plan, `coarse`, each to the program's own twin": markdown(
            (*head, "found"), sorted(rows, key=lambda line: (line[1], line[0]))
        ),
        "YADE, `tiny`": at_points(runs["tiny"], runs["yade"], ("LIGGGHTS (runs)", "YADE (runs)")),
    }
    text = [
        "# Three programs in numbers",
        "",
        "Made by `summarise.py`; [the page](README.md) says what they mean.",
    ]
    return "\n".join([*text, "", *(x for title, part in parts.items() for x in (f"## {title}", "", *part))])


if __name__ == "__main__":
    runs = runs_of_all()
    for of, name, fidelity in (("sweep", "lammps", "coarse"), ("yade", "yade", "tiny")):
        ship_noise(runs[of], load_folder(model_folder(f"angle_of_repose_{name}"), fidelity=fidelity))
    ship_twin(runs["sweep"], load_folder(model_folder("angle_of_repose_lammps"), fidelity="coarse"))
    (HERE / "tables.md").write_text(tables(runs))
    picture(runs["liggghts"], runs["sweep"], runs["tiny"], runs["yade"])
