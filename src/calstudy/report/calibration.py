"""The report of ``calibrate``: the optimum beside its targets, the solution space, and lines to paste.

``STUDY/report/report.html`` is one self-contained page. ``solutions.parquet`` has the solution space, and
``parameters.in`` the calibrated values as lines for a LIGGGHTS script.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from calstudy.analysis.exhibit import Column, Picture, Table, render
from calstudy.analysis.figures.figure9 import draw
from calstudy.analysis.figures.heap import HeapPicture
from calstudy.calibration.confirmation import confirmation_in_words, tolerance_verdict
from calstudy.calibration.solutions import QUANTILES, reach
from calstudy.disk.files import cannot_write, write_atomically
from calstudy.disk.ours import make_directory
from calstudy.records import STOPPED
from calstudy.report.card import holdout_in_words, holdout_table, write_card
from calstudy.report.curves import curve_pictures, singly_targeted
from calstudy.report.page import Block, Part, page
from calstudy.report.pasted import liggghts_lines, rounded
from calstudy.report.pictures import convergence
from calstudy.report.solution_space import (
    correlations_table,
    made_up_for_in_words,
    narrowing_table,
    outside,
    pictures_of,
    solutions_in_words,
    write_solutions,
)
from calstudy.study.reading import Result

FOLDER = "report"
MINIMISED = "to be minimised"
"""Verdict of an objective without a tolerance."""
PAGE, SOLUTIONS, LINES = "report.html", "solutions.parquet", "parameters.in"


# ---- tables -----------------------------------------------------------------------------------------


def responses_table(result: Result) -> Table:
    """Each response beside its target, its tolerance and the model's noise."""
    task, line, noise = result.definition.task, result.line, result.noise
    errors, again = task.cost.target.sd, result.confirmed
    responses = [*result.responses.values()] if again is None else again.mean
    lines = []
    for one in reach(task, result.surrogates):
        name = one.response
        tolerance = task.tolerances.get(name, 0.0)
        found = line[f"dem_{name}"]
        deviation = float(task.cost.deviations(np.array(responses))[task.cost.responses.index(name)])
        hidden = 2 * math.hypot(noise[name], errors.get(name, 0.0))
        near = "the noise and error" if name in errors else "the noise"
        fresh = again_of(result, name)
        lines.append(
            {
                "response": name,
                "unit": result.units[name],
                "target": one.target,
                "tolerance": tolerance or math.nan,
                "optimum": found,
                "deviation": deviation,
                "kriging": line[f"kriging_{name}"],
                "noise": noise[name],
                "noise_is": "known" if name in (task.noise or {}) else "estimated",
                "low": one.low,
                "low_sd": one.low_sd,
                "high": one.high,
                "high_sd": one.high_sd,
                "error": errors.get(name, math.nan),
                **fresh,
                "verdict": tolerance_verdict(deviation, tolerance, fresh["probability"])
                if tolerance
                else MINIMISED
                if one.is_minimised
                else (f"within twice {near}" if abs(deviation) <= hidden else f"beyond {near}"),
                "reachable": one.reachable,
                "sure": one.is_sure,
            }
        )
    columns = (
        Column("response", "Response"),
        Column("target", "Target", ".5g"),
        *([Column("error", "Its error (sd)", ".2g")] if errors else []),
        Column("tolerance", "Tolerance", ".3g"),
        Column("optimum", "DEM optimum", ".5g"),
        *again_columns(result),
        Column("deviation", "Deviation", "+.3g"),
        Column("noise", "Noise (sd of one run)", ".2g"),
        Column("noise_is", "Noise is"),
        Column("kriging", "Kriging expected", ".5g"),
        Column("low", "Mean within reach: from", ".5g"),
        Column("low_sd", "sd", ".2g"),
        Column("high", "to", ".5g"),
        Column("high_sd", "sd", ".2g"),
        Column("unit", "Unit"),
        Column("verdict", "Verdict"),
    )
    notes = [
        f"{one['response']}: the target is "
        + ("OUT OF REACH inside the intervals" if one["sure"] else "AT THE EDGE of what the intervals reach")
        for one in lines
        if not (one["reachable"] and one["sure"])
    ]
    if told := chi_square_in_words(result):
        notes.append(told)
    return Table("responses", "Responses at the optimum", pd.DataFrame(lines), columns, notes)


def again_of(result: Result, name: str) -> dict[str, float]:
    """Columns of a response's line in the table of responses; NaN without a confirmation."""
    found = result.confirmed
    if found is None:
        return dict.fromkeys(("again", "again_error", "seen", "probability"), math.nan)
    k = result.definition.task.cost.responses.index(name)
    return {
        "again": float(found.mean[k]),
        "again_error": float(found.standard_error[k]),
        "seen": float(found.seen[k]),
        "probability": float(found.within[k]),
    }


def again_columns(result: Result) -> list[Column]:
    """These columns; none without a confirmation."""
    if result.confirmed is None:
        return []
    return [
        Column("again", "Run again: mean", ".5g"),
        Column("again_error", "its standard error", ".2g"),
        Column("probability", "P(within tolerance)", ".2f"),
        Column("seen", "Noise seen (sd)", ".2g"),
    ]


def chi_square_in_words(result: Result) -> str:
    """How far the run at the optimum is from the measured values; empty if no error is known.

    Responses with a weight, such as the points of a curve, are left out: their squares are not a chi-square.
    """
    cost = result.definition.task.cost
    found = cost.deviations([*result.responses.values()])
    squares = {
        name: deviation**2 / (cost.target.sd[name] ** 2 + result.noise[name] ** 2)
        for name, deviation in zip(cost.responses, map(float, found), strict=True)
        if name in cost.target.sd and cost.target.weight.get(name, 1.0) == 1.0
    }
    if not squares:
        return ""
    total = sum(squares.values())
    return (
        f"Chi-square of the optimum's run, by the measurements' errors and the noise of a run: {total:.3g} "
        f"for {len(squares)} response(s). A run at the true parameters is as far off or farther with "
        f"probability {chi2.sf(total, len(squares)):.2g}; if that is below 0.05, suspect the errors, the "
        "intervals or the model."
    )


def parameters_table(result: Result) -> Table:
    """Each parameter's interval, optima and solutions, with remarks."""
    task, line = result.definition.task, result.line
    box, solutions = task.space.box, result.solutions
    lines = []
    for p in task.space.parameters:
        entry: dict[str, Any] = {"parameter": p.name, "unit": p.unit, "optimum": line[f"dem_{p.name}"]}
        entry |= {"interval": p.interval, "kriging": math.nan, "solutions_low": math.nan}
        entry |= {"solutions_high": math.nan, "remark": ""}
        if p.name in box.names:
            low, high = solutions.interval(box.names.index(p.name))
            remarks = [
                p.said(entry["optimum"]) if p.texts else "",
                result.bounds.get(p.name, ""),
                outside(result, p.name, low, high),
                "left free by the targets" if p.name in result.free else "",
            ]
            entry |= {
                "kriging": line[f"kriging_{p.name}"],
                "solutions_low": task.space.shown(p.name, low),
                "solutions_high": task.space.shown(p.name, high),
                "remark": "; ".join(filter(None, remarks)),
            }
        elif p.formula is not None and len(solutions.points):
            low, high = np.quantile(task.space.values(p.name, solutions.points), QUANTILES)
            entry |= {"kriging": line[f"kriging_{p.name}"], "solutions_low": low, "solutions_high": high}
        lines.append(entry)
    columns = (
        Column("parameter", "Parameter"),
        Column("interval", "Interval"),
        Column("kriging", "Kriging optimum", ".4g"),
        Column("optimum", "DEM optimum", ".4g"),
        Column("solutions_low", "Middle 90 % of solutions: from", ".4g"),
        Column("solutions_high", "to", ".4g"),
        Column("unit", "Unit"),
        Column("remark", "Remark"),
    )
    notes = [solutions_in_words(result), *(f"{line}." for line in made_up_for_in_words(result))]
    return Table("parameters", "Parameters", pd.DataFrame(lines), columns, notes)


def kriging_table(result: Result) -> Table:
    """Diagnostics of the surrogates, to be looked at before they are trusted."""
    lines = [
        {
            "response": name,
            "unit": result.units[name],
            "sampled_low": result.line[f"sampled_{name}_min"],
            "sampled_high": result.line[f"sampled_{name}_max"],
            "error_samples": result.line[f"leave_one_out_rmse_{name}"],
            "error": d.leave_one_out_rmse,
            "largest": d.largest_standardised_residual,
            "noise": d.noise_sd,
            "at_bound": ", ".join(d.at_bound) or "none",
        }
        for name, d in result.surrogates.diagnostics.items()
    ]
    columns = (
        Column("response", "Response"),
        Column("sampled_low", "Sampled: from", ".5g"),
        Column("sampled_high", "to", ".5g"),
        Column("error_samples", "Leave-one-out error, samples", ".3g"),
        Column("error", "all runs", ".3g"),
        Column("largest", "Largest standardised error", ".2f"),
        Column("noise", "Noise as fitted", ".2g"),
        Column("unit", "Unit"),
        Column("at_bound", "Hyperparameters at a bound"),
    )
    note = (
        "Samples: the Kriging models of the first optimisation. All runs: those of the solution space. A "
        "standardised error above 3 is suspicious. Noise as fitted is what these runs show, drawn to the "
        "known noise, if any. The known noise stands beside the responses, and is the one that counts."
    )
    if result.definition.prior is not None and not result.line["reason"]:
        note += " Samples and all runs are here those of the earlier study, which is the prior."
    return Table("kriging", "Kriging models", pd.DataFrame(lines), columns, [note])


# ---- lines to paste ---------------------------------------------------------------------------------


def values_of(result: Result) -> dict[str, float]:
    """All parameters at the DEM optimum, with all digits."""
    return {p.name: float(result.line[f"dem_{p.name}"]) for p in result.definition.task.space.parameters}


def lines_of(result: Result, values: Mapping[str, float]) -> list[str]:
    """Values as lines of a LIGGGHTS script."""
    head = f"# calibrated by calstudy to {result.settings.target.origin}; study {result.settings.id}"
    return liggghts_lines(result.definition, head, values)


def block(result: Result) -> Block:
    """The lines to paste, rounded to what the noise supports."""
    values = result.definition.task.space.filled(
        {name: value for name, value in values_of(result).items() if name not in result.following}
        | rounded(result.surrogates, result.noise, result.optimum_point)
    )
    note = (
        "Rounded: the last place is at most a tenth of the change that the noise of one run hides. "
        f"{LINES} beside this page has all digits."
    )
    return Block("liggghts", "Lines for a LIGGGHTS script", lines_of(result, values), [note])


# ---- files ------------------------------------------------------------------------------------------


@threadpool_limits.wrap(limits=1)
def write_report(result: Result, directory: str | Path) -> list[Path]:
    """Write the page, the solutions and the lines to ``report`` in a directory; returns their paths.

    All is computed on one thread: on more, matrices this small take ten times as long beside other work.
    SetupError: they cannot be written.
    """
    directory = Path(directory)
    folder = directory / FOLDER
    lines = lines_of(result, values_of(result))
    parts: list[Part] = [
        responses_table(result),
        parameters_table(result),
        *([holdout_table(result)] if result.definition.held_out else []),
        *(
            _picture(f"heap{k}", "The heap at the optimum", draw(heap))
            for k, heap in enumerate(heaps_of(result))
        ),
        *curve_pictures(result),
        *(
            _picture("runs", "DEM runs", convergence(result.evaluations, result.line, of, _title(result)))
            for of in (singly_targeted(result),)
            if of
        ),
        kriging_table(result),
        correlations_table(result),
        narrowing_table(result),
        block(result),
    ]
    parts[2:2] = pictures_of(result)
    html = page(f"Calibration: {result.definition.path.stem}", lead(result), facts(result), parts)
    try:
        make_directory(folder, directory)
        write_atomically(folder / PAGE, html.encode(), directory)
        write_atomically(folder / LINES, ("\n".join(lines) + "\n").encode(), directory)
    except OSError as error:
        raise cannot_write(folder, error) from error
    write_solutions(result, folder / SOLUTIONS, directory)
    return [folder / name for name in (PAGE, SOLUTIONS, LINES)] + write_card(result, folder, directory)


def missed(result: Result) -> list[str]:
    """Responses outside their tolerance or, without one, beyond twice their noise."""
    table = responses_table(result).frame
    return list(table["response"][~table["verdict"].str.startswith(("within", MINIMISED))])


def lead(result: Result) -> str:
    """First paragraph of the page, and last one on the terminal."""
    table, task = responses_table(result).frame, result.definition.task
    met = ~table["response"].isin(missed(result))
    said = [f"{int(met.sum())} of {len(table)} responses are {'/'.join(sorted(set(table['verdict'][met])))}"]
    if not met.all():
        said = [*(said if met.any() else []), f"missed: {', '.join(missed(result))}"]
    if result.confirmed is not None:
        said.append(confirmation_in_words(result.confirmed, task.until))
    if result.definition.held_out:
        said.append(holdout_in_words(result))
    if result.bounds:
        said += [f"{name}: {what}" for name, what in result.bounds.items()]
    if result.free:
        said.append(f"the targets leave {', '.join(result.free)} free")
    if result.definition.prior is not None:
        said.append(f"prior: {result.definition.prior.verdict(result.line['reason'])}")
    elif result.line["reason"]:
        said.append(f"the cheap fidelity was given up: {result.line['reason']}")
    said.append(
        f"{result.line['runs_total']} DEM runs, {result.line['runs_failed']} of them failed; "
        f"the second optimisation ended: {STOPPED[result.line['dem_stop']]}"
    )
    return "; ".join(said) + "."


def facts(result: Result) -> dict[str, str]:
    """What was calibrated, for the top of the page."""
    task, settings, prior = result.definition.task, result.settings, result.definition.prior
    models = [
        f"{chosen.label}: {chosen.model.name}"
        + (f", {chosen.fidelity} fidelity, {chosen.variant}" if chosen.fidelity else "")
        + f"; hash {chosen.model.hash}"
        for chosen in result.definition.models
    ]
    return {
        "File": str(result.definition.path),
        "Models": " | ".join(models),
        "Engine": settings.engine,
        "Procedure": f"{settings.mode} mode, seed {settings.seed}, WRL {task.cost.WRL:g}",
        **({"Prior": prior.verdict(result.line["reason"])} if prior is not None else {}),
        "Target": settings.target.origin,
        "Rayleigh time-step": "not known: a model has no particles"
        if math.isnan(step := result.line["dem_rayleigh_time_step"])
        else f"{step:.4g} s at the optimum (Eq. 1)",
        "Study": settings.id,
        "calstudy": settings.calstudy,
    }


def heaps_of(result: Result) -> list[HeapPicture]:
    """Heaps at the optimum, one for each model that leaves a heap."""
    found = []
    for run_id, beads in result.heaps.groupby("run_id", sort=False):
        run = result.evaluations[result.evaluations["run_id"] == run_id].iloc[0]
        angle = math.degrees(math.atan2(run["heap_height"], run["heap_radius"]))
        found.append(
            HeapPicture(
                beads=1e3 * beads[["x", "y", "z"]].to_numpy(float),
                diameter=1e3 * float(beads["particle_diameter"].iloc[0]),
                radius=1e3 * run["heap_radius"],
                height=1e3 * run["heap_height"],
                angle=angle,
                says=f"{run['model']} {run['fidelity']}, {len(beads)} beads: {angle:.1f} deg",
            )
        )
    return found


def _title(result: Result) -> str:
    return f"{result.line['runs_total']} DEM runs"


def _picture(name: str, title: str, figure: Figure, notes: Sequence[str] = ()) -> Picture:
    return Picture(name, title, render(figure, ["svg"]), notes)
