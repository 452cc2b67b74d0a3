"""Draws the pictures of findings.md from the shipped studies, and prints the numbers of its text.

python docs/pictures/findings.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.stats import norm, sem
from style import STYLE, save

from calstudy.analysis.tables.effects import effects
from calstudy.analysis.tables.second_phase import pairs, ratio, second_phase
from calstudy.analysis.tables.table4 import table4
from calstudy.models.angle_of_repose import shipped_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED
from calstudy.models.noise import known_noise, noise_freedom, noise_table, pooled_sd
from calstudy.plan import PARAMETERS
from calstudy.records import Outcome, Phase
from calstudy.study.reading import Study, read_study

REPORTS = Path(__file__).parents[2] / "reports"
COLOURS = {"paper": "tab:orange", "robust": "tab:blue"}
FOLDERS = {"coarse": "coarse-rows", "soft": "soft"}
NAMES = {ANGLE_OF_REPOSE: "angle of repose", BULK_DENSITY: "bulk density"}


def study(fidelity: str, mode: str) -> Study:
    """A shipped study."""
    return read_study(REPORTS / FOLDERS[fidelity] / mode)


def steps() -> None:
    """Draw what the two runs of a central difference differ by, beside what two seeds differ by."""
    figure, axes = plt.subplots(2, 2, figsize=(8, 4.6), sharex=True)
    z = np.linspace(-4, 4, 200)
    for row, fidelity in zip(axes, FOLDERS, strict=True):
        of = study(fidelity, "paper")
        between = pairs(of)
        noise = known_noise(of.settings.model, of.settings.model_hash)
        freedom = noise_freedom(of.settings.model, of.settings.model_hash)
        assert noise is not None
        for panel, name in zip(row, NAMES, strict=True):
            value, low, high = ratio(between[name].to_numpy(float), noise[name], freedom)
            print(f"{fidelity} {name}: {len(between)} pairs, {value:.2f} ({low:.2f} to {high:.2f})")
            scaled = between[name] / (np.sqrt(2.0) * noise[name])
            panel.hist(scaled.clip(-4, 4), np.arange(-4, 4.1, 0.5), density=True, color=COLOURS["paper"])
            panel.plot(z, norm.pdf(z), color="0.3")
            panel.set_title(f"{NAMES[name]}, {fidelity}, {len(between)} pairs: {value:.2f}", fontsize=9)
            panel.set_yticks([])
        slope = -between.loc[between["parameter"] == "DENS", BULK_DENSITY].to_numpy(float)
        value, low, high = ratio(slope, noise[BULK_DENSITY], freedom)
        print(
            f"  bulk density by DENS: {len(slope)} pairs, {value:.2f} ({low:.2f} to {high:.2f}), on average "
            f"{slope.mean():.1f} kg/m3 (standard error {sem(slope):.1f})"
        )
        print("  " + scatter(of, fidelity))
    for panel in axes[1]:
        panel.set_xlabel("difference of the pair / that of two seeds")
    save(figure, "findings-steps.png")


def scatter(of: Study, fidelity: str) -> str:
    """Scatter of the angle where rows end, over their runs and over fresh seeds, beside the measured one."""
    near = second_phase(of).query("reach <= 0.06")
    ones = pairs(of).query("row in @near.row")[ANGLE_OF_REPOSE]
    rows = np.sqrt(np.average(near["angle_sd"] ** 2, weights=near["runs"] - 1))
    again = pd.read_parquet(REPORTS / FOLDERS[fidelity] / "again" / "runs.parquet")
    fresh = noise_table(again, shipped_model(fidelity))
    return (
        f"rows within 0.06 of an interval: {rows:.2f} deg over {near['runs'].sum()} runs in {len(near)} "
        f"rows, {np.sqrt(np.mean(ones**2) / 2):.2f} by their {len(ones)} pairs; fresh seeds "
        f"{pooled_sd(fresh)[ANGLE_OF_REPOSE]:.2f} deg at {len(fresh)} optima"
    )


def luck() -> None:
    """Draw each row's sum of squares as it was found, and as the same parameters give it with fresh seeds."""
    lines = []
    for fidelity, folder in FOLDERS.items():
        for mode in COLOURS:
            of = study(fidelity, mode)
            again = pd.read_parquet(REPORTS / folder / "again" / "runs.parquet")
            for line in of.ok.to_dict("records"):
                row = int(line["row"])
                runs = again[(again["label"] == f"{mode} {row}") & (again["outcome"] == "ok")]
                if len(runs):
                    each = of.residuals(row, runs)
                    true = np.sum(each.mean(axis=0) ** 2 - each.var(axis=0, ddof=1) / len(each))
                    lines.append((f"{fidelity} {row}", mode, float(line["dem_sum_of_squares"]), float(true)))
    figure, axes = plt.subplots(figsize=(7, 3.6))
    labels = list(dict.fromkeys(label for label, *_ in lines))
    for label, mode, found, true in lines:
        y = labels.index(label) + (0.15 if mode == "paper" else -0.15)
        x = np.sqrt(np.maximum([found, true], 0.0))
        axes.annotate("", (x[1], y), (x[0], y), arrowprops={"arrowstyle": "->", "color": COLOURS[mode]})
        axes.plot(x[0], y, "o", ms=4, color=COLOURS[mode])
    for mode, colour in COLOURS.items():
        axes.plot([], [], "o", color=colour, label=mode)
    axes.set_xlim(-0.005, 1.03 * np.sqrt(max(max(found, true) for *_, found, true in lines)))
    axes.set_yticks(range(len(labels)), labels)
    axes.set_xlabel("root of the sum of squares: as found (dot), run again with 8 fresh seeds (arrow's head)")
    axes.legend(frameon=False, loc="lower right")
    save(figure, "findings-luck.png")


def reached(of: Study) -> str:
    """How many rows reach the targets, and how many can by their samples and their intervals."""
    angle, density = (of.settings.target.values[name] for name in MEASURED)
    samples = of.evaluations[of.evaluations["phase"] == Phase.SAMPLING].groupby("row")[ANGLE_OF_REPOSE]
    outside = ((samples.min() > angle) | (samples.max() < angle)).loc[of.ok["row"]]
    held = [row for row in of.ok["row"] if "MU_PP" not in of.plan.space(of.plan.row(int(row))).box.names]

    def within(share: float, name: str, target: float) -> str:
        reached = abs(of.ok[f"dem_{name}"] / target - 1) < share
        return f"within {share:.0%} of {target:.5g} {reached.sum()}"

    close = abs(of.ok[f"dem_{BULK_DENSITY}"] / density - 1) < 0.05
    high = of.position("DENS") > 0.9
    by_weight = ", ".join(
        f"{weight:g}: {close[which].sum()} and {high[which].sum()} of {which.sum()}"
        for weight in sorted(of.ok["WRL"].unique())
        for which in [of.ok["WRL"] == weight]
    )
    return (
        f"bulk density within 5%, and DENS above 0.9 of its interval, by WRL: {by_weight}; "
        f"MU_PP held in {len(held)} rows; {within(0.15, ANGLE_OF_REPOSE, angle)}, "
        f"{within(0.05, ANGLE_OF_REPOSE, angle)}, {within(0.05, BULK_DENSITY, density)}; the angle lay "
        f"outside what {outside.sum()} sampled"
    )


def cost(of: Study) -> str:
    """DEM runs and processor time, and what all rows take at that."""
    each = of.evaluations.drop_duplicates("run_id")  # a point may be asked for more than once
    runs, failed = len(each), (each["outcome"] != Outcome.OK).sum()
    hours = each["cpu_time"].sum() / 3600
    rows, planned = len(of.ok), len(of.plan.rows)
    return (
        f"{rows} rows, {runs} runs of which {failed} failed, {hours:.2f} h; {runs / rows:.1f} runs a row of "
        f"{3600 * hours / runs:.1f} s; {planned} rows in {planned / rows * hours:.0f} h"
    )


def gained(of: Study) -> str:
    """What beats a row's first run, and which rows leave the 6 % around it."""
    second = second_phase(of)
    later = second["runs"] - 1
    far = second[second["reach"] > 0.06]
    better = far["row"][far["average"] < far["start"]]
    return (
        f"{of.ok['runs_optimisation'].mean():.1f} runs a row; better than the first: "
        f"{second['better'].mean():.2f} over rows, {np.average(second['better'], weights=later):.2f} of all; "
        f"beyond 0.06 of an interval (at most {second['reach'].max():.2f}): {listed(far['row'])}, of which "
        f"the average is better than the first in {listed(better)}"
    )


def listed(rows: pd.Series) -> str:
    """How many rows, and which."""
    return f"{len(rows)} ({', '.join(map(str, rows))})"


def twins() -> None:
    """Draw where the known parameters lie in their intervals, and where they were found."""
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.2), sharey=True)
    for panel, title, chosen in zip(
        panels, ("WRL = 0", "WRL = 0.5 or 1"), (lambda w: w == 0, lambda w: w > 0), strict=True
    ):
        for mode, colour in COLOURS.items():
            of = study("coarse", mode)
            truth = of.settings.target.truth
            assert truth is not None
            for line in of.ok.to_dict("records"):
                plan_row = of.plan.row(int(line["row"]))
                if not chosen(plan_row.WRL):
                    continue
                box = of.plan.space(plan_row).box
                for k, name in enumerate(box.names):
                    width = box.upper[k] - box.lower[k]
                    x = PARAMETERS.index(name) + (-0.15 if mode == "paper" else 0.15)
                    panel.plot(x, (line[f"dem_{name}"] - box.lower[k]) / width, "o", ms=4, color=colour)
                    at = (truth[name] - box.lower[k]) / width
                    panel.plot(PARAMETERS.index(name), at, "_", ms=28, color="0.3", zorder=0)
        panel.set(title=title, xticks=range(len(PARAMETERS)), xticklabels=PARAMETERS)
    panels[0].set_ylabel("place in the interval")
    for mode, colour in COLOURS.items():
        panels[0].plot([], [], "o", color=colour, label=mode)
    panels[0].plot([], [], "_", ms=14, color="0.3", label="truth")
    panels[0].legend(frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.1))
    save(figure, "findings-twins.png")


def numbers() -> None:
    """Print what the text says of each study: its cost, what beats a row's first run, and effects."""
    for fidelity in FOLDERS:
        for mode in COLOURS:
            of = study(fidelity, mode)
            print(f"{fidelity} {mode}: {cost(of)}")
            print("  second optimisation: " + gained(of))
            print("  " + reached(of))
        of = study(fidelity, "paper")
        for line in table4(of).to_dict("records"):
            print("  {label}: {correlation:.2f} ({low:.2f} to {high:.2f}), n = {n}".format_map(line))
        for line in effects(of).to_dict("records"):
            said = "  {factor} {levels}, {label}: {effect:.3g} ({low:.3g} to {high:.3g}) {unit}, p {p:.2g}"
            print(said.format_map(line))


if __name__ == "__main__":
    with mpl.rc_context(STYLE):
        steps()
        luck()
        twins()
    numbers()
