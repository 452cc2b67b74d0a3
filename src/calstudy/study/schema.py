"""Tables of a study: columns, types, units and meanings, as stored in the Parquet column metadata.

Which columns there are follows from what is calibrated, which ``Quantities`` names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from calstudy.models.find import Declared
from calstudy.records import OPTIMISATION, RAYLEIGH_TIME_STEP, Evaluation, Phase, Response, Run

if TYPE_CHECKING:
    from calstudy.calibration.task import Calibration, Task

SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class Quantities:
    """Parameters and measured responses of a study."""

    parameters: tuple[tuple[str, str], ...]
    """Names with their units."""
    responses: tuple[Response, ...]
    """All that the models give."""
    targets: tuple[str, ...]
    """Those responses that are calibrated to."""
    phases: tuple[Phase, ...] = (Phase.SAMPLING, *OPTIMISATION)
    """What asks for DEM runs."""

    @classmethod
    def of(cls, model: Declared) -> Quantities:
        """All that a model takes and gives."""
        return cls(tuple(model.parameters.items()), model.responses, tuple(r.name for r in model.responses))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter and response, the Rayleigh time-step included."""
        return dict(self.parameters) | self.measured | {RAYLEIGH_TIME_STEP: "s"}

    @property
    def measured(self) -> dict[str, str]:
        """Unit of each response that a DEM run measures."""
        return {response.name: response.unit for response in self.responses}

    @property
    def given(self) -> tuple[str, ...]:
        """Names of all responses that a run has, the Rayleigh time-step included."""
        return (*self.measured, RAYLEIGH_TIME_STEP)

    @property
    def targeted(self) -> dict[str, str]:
        """Unit of each response that is calibrated to."""
        return {name: unit for name, unit in self.measured.items() if name in self.targets}

    @property
    def short(self) -> dict[str, str]:
        """What narrow tables call each response, the Rayleigh time-step included."""
        return {r.name: r.short or r.name for r in self.responses} | {RAYLEIGH_TIME_STEP: "Rayleigh"}


VARYING = ("wall_time", "cpu_time", "host", "finished_at")
"""Columns that differ between equal studies; every other column is the same on the same processor."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table."""

    name: str
    type: pa.DataType
    unit: str
    meaning: str


def _text(name: str, meaning: str) -> Column:
    return Column(name, pa.string(), "", meaning)


def _count(name: str, meaning: str) -> Column:
    return Column(name, pa.int64(), "1", meaning)


def _number(name: str, unit: str, meaning: str) -> Column:
    return Column(name, pa.float64(), unit, meaning)


def _flag(name: str, meaning: str) -> Column:
    return Column(name, pa.bool_(), "", meaning)


def _numbers(prefix: str, units: Mapping[str, str], meaning: str) -> list[Column]:
    return [_number(f"{prefix}{name}", unit, f"{name} {meaning}") for name, unit in units.items()]


TIME_STEP = {RAYLEIGH_TIME_STEP: "s"}


PROVENANCE = (
    _text("study", "identity of the study: hash of plan, model, engine, mode, budget, seed and target"),
    _count("row", "run number of the plan's row (Table B-1)"),
    _text("model", "LIGGGHTS model"),
    _count("deck", "version of the model's deck"),
    _text("model_hash", "SHA-256 of all that decides a run's responses but parameters, seed and engine"),
    _text("fidelity", "fidelity of the model"),
    _text("variant", "variant of the model"),
    _text("engine", "program and version that ran the model"),
    _text("calstudy", "version of calstudy"),
    _text("mode", "mode of the procedure: paper or robust"),
)

TIMES = (
    _number("wall_time", "s", "elapsed time"),
    _number("cpu_time", "s", "processor time of the DEM program"),
    _text("host", "machine that ran it"),
    _text("finished_at", "end in UTC, ISO 8601"),
)


def run_columns(quantities: Quantities) -> tuple[Column, ...]:
    """What a table says of a DEM run."""
    return (
        _text("run_id", "identity of the DEM run: model, engine, parameters, seed"),
        _count("seed", "seed of the run, from which LIGGGHTS's three prime seeds are drawn"),
        *_numbers("", dict(quantities.parameters), "of the run"),
        *_numbers("", quantities.measured | TIME_STEP, "of the DEM model; NaN where the run gave none"),
        _text("outcome", "ok, no_heap, failed, timed_out or unmeasurable"),
        _text("reason", "why the outcome is not ok, and the end of the log"),
        _number("heap_radius", "m", "radius r_f of the heap (Appendix A)"),
        _number("heap_height", "m", "height h_f of the heap less one particle diameter (Appendix A)"),
        _count("beads_poured", "beads inserted"),
        _count("beads_filled", "beads left below the fill height"),
        _count("beads_heap", "beads on the plate at the end"),
        _count("beads_lost", "beads that left the plate"),
        _number("engine_time_step", "s", "time-step of the simulation, that of the softened material"),
        _number("simulated_time", "s", "from the first bead to the heap at rest"),
        *TIMES,
    )


def evaluation_columns(quantities: Quantities) -> tuple[Column, ...]:
    """Columns of the table of DEM runs."""
    return (
        *PROVENANCE,
        _text("phase", "what asked for the run: " + ", ".join(quantities.phases)),
        _count("index", "number of the request within row and phase, from 0"),
        *run_columns(quantities),
    )


def sweep_columns(quantities: Quantities) -> tuple[Column, ...]:
    """Columns of a sweep's runs: those of a study's runs without study, row and mode."""
    return (
        _text("label", "what the design calls the run"),
        *(column for column in PROVENANCE if column.name not in ("study", "row", "mode")),
        *run_columns(quantities),
    )


def calibration_columns(quantities: Quantities) -> tuple[Column, ...]:
    """Columns of the table of results."""
    parameters, targets = dict(quantities.parameters), quantities.targeted
    responses = targets | TIME_STEP
    return (
        *PROVENANCE,
        _number("WRL", "-", "weighting factor of the Rayleigh time-step (Eq. 10)"),
        _count("SPP", "samples per calibrated parameter (Eq. 11)"),
        *(_flag(f"calibrated_{p}", f"whether {p} was calibrated, or constant") for p in parameters),
        _text("target_kind", "paper, twin or set"),
        _text("target_origin", "where the target comes from"),
        *(_number(f"target_{r}", targets[r], f"desired {r} (Eq. 9)") for r in targets),
        *(
            _flag(
                f"reachable_{r}",
                f"whether the Kriging models of the samples reach the desired {r}",
            )
            for r in targets
        ),
        *(
            _number(f"sampled_{r}_{end}", targets[r], f"{end} of the sampled {r}")
            for r in targets
            for end in ("min", "max")
        ),
        _text("outcome", "ok or failed"),
        _text("reason", "why the calibration failed, or gave up its cheap fidelity or earlier study"),
        *_numbers("kriging_", parameters, "at the Kriging optimum"),
        *_numbers("kriging_", responses, "of the Kriging models at the Kriging optimum"),
        _number("kriging_sum_of_squares", "-", "sum of squared residuals at the Kriging optimum (Eq. 9, 10)"),
        _text("kriging_stop", "why the first optimisation ended"),
        *(
            _number(f"leave_one_out_rmse_{r}", targets[r], f"leave-one-out error of the Kriging model of {r}")
            for r in targets
        ),
        *(
            _number(f"kriging_noise_{r}", targets[r], f"noise that the Kriging model of {r} estimates")
            for r in targets
        ),
        *(
            _text(f"kriging_at_bound_{r}", f"hyperparameters of the Kriging model of {r} at a bound")
            for r in targets
        ),
        *_numbers("dem_", parameters, "at the DEM optimum"),
        *_numbers("dem_", responses, "of the DEM model at the DEM optimum"),
        _number("dem_sum_of_squares", "-", "sum of squared residuals at the DEM optimum"),
        _text("dem_stop", "why the second optimisation ended"),
        _text("dem_run_id", "the DEM run at the DEM optimum"),
        *_numbers("last_", parameters, "at the last point that the second optimisation tried"),
        *_numbers("last_", responses, "of the DEM model there"),
        _count("iterations", "iterations of the second optimisation"),
        *(_count(f"runs_{phase}", f"DEM runs asked for by the phase {phase}") for phase in quantities.phases),
        _count("runs_optimisation", "DEM runs of the second optimisation"),
        _count("runs_total", "DEM runs of the calibration"),
        _count("runs_failed", "DEM runs without usable responses"),
        _count("samples_left_out", "samples that the surrogates had to do without"),
        *TIMES,
    )


HEAPS = (
    *PROVENANCE,
    _text("run_id", "the DEM run at the row's DEM optimum"),
    *(Column(axis, pa.float32(), "m", f"{axis} of the bead's centre") for axis in "xyz"),
    _number("particle_diameter", "m", "diameter of the simulated beads"),
)

SWEEP_HEAPS = (
    _text("run_id", "the DEM run"),
    *(Column(axis, pa.float32(), "m", f"{axis} of the bead's centre") for axis in "xyz"),
)


@cache
def tables_of(quantities: Quantities) -> dict[str, tuple[Column, ...]]:
    """Columns of each table of a study."""
    return {
        "evaluations": evaluation_columns(quantities),
        "calibrations": calibration_columns(quantities),
        "heaps": HEAPS,
    }


_REPLICATE = (
    _count("replicate", "number of the replicate, from 1"),
    _count("seed", "the study's plus the replicate: of its samples and noise, and its draw of the emulator"),
)
_LEFT_OUT = {column.name for column in (*PROVENANCE, *TIMES)} | {"dem_run_id"}


@cache
def replicated_of(quantities: Quantities) -> dict[str, tuple[Column, ...]]:
    """Columns of each table of a study's replicates: those that say nothing of an emulator are not there."""
    tables = tables_of(quantities)
    kept = {"phase", "index", *dict(quantities.parameters), *quantities.measured, "outcome"}
    return {
        "replicates": (
            *PROVENANCE,
            *_REPLICATE,
            *(column for column in tables["calibrations"] if column.name not in _LEFT_OUT),
        ),
        "replicate_runs": (
            *PROVENANCE,
            *_REPLICATE,
            *(column for column in tables["evaluations"] if column.name in kept),
        ),
    }


TABLES = ("evaluations", "calibrations", "heaps")
"""Tables of every study."""
REPLICATED = ("replicates", "replicate_runs")
"""Tables of a study with replicates on an emulator."""
MEANINGS = {
    "evaluations": "every DEM run of every row",
    "calibrations": "one line a row: what the calibration found",
    "heaps": "the beads of the heap at each row's DEM optimum",
    "replicates": "what the calibrations of each replicate of the study found, one file a replicate",
    "replicate_runs": "every answer of the emulator to them, one file a replicate",
}


@cache
def arrow_schema(table: str, quantities: Quantities) -> pa.Schema:
    """Arrow schema of a table of a study or of its replicates, with units and meanings as metadata."""
    tables = replicated_of(quantities) if table in REPLICATED else tables_of(quantities)
    return schema_of(tables[table], table)


def schema_of(columns: Sequence[Column], table: str) -> pa.Schema:
    """Arrow schema of columns, with unit and meaning in each field's metadata."""
    fields = [pa.field(c.name, c.type, metadata={"unit": c.unit, "meaning": c.meaning}) for c in columns]
    return pa.schema(fields, metadata={"calstudy_schema": str(SCHEMA_VERSION), "table": table})


def markdown(quantities: Quantities) -> str:
    """The tables of a study as Markdown, for the documentation; a test holds the two together."""
    parts = []
    for name, columns in {**tables_of(quantities), **replicated_of(quantities)}.items():
        parts += [f"## {name}", "", f"{MEANINGS[name][0].upper()}{MEANINGS[name][1:]}.", ""]
        parts += ["| column | type | unit | meaning |", "|---|---|---|---|"]
        parts += [f"| `{c.name}` | {c.type} | {c.unit} | {c.meaning} |" for c in columns]
        parts.append("")
    return "\n".join(parts)


def result_line(
    task: Task, found: Calibration | None, reason: str, evaluations: Sequence[Evaluation]
) -> dict[str, Any]:
    """Line of the table of calibrations."""
    runs = [evaluation.run for evaluation in evaluations]
    phases = [evaluation.request.phase for evaluation in evaluations]
    target, dimension = task.cost.target, task.space.box.dimension
    line: dict[str, Any] = {
        "WRL": task.cost.WRL,
        "SPP": None if task.samples is None else task.samples // dimension,
        **{f"calibrated_{p.name}": p.name in task.space.calibrated for p in task.space.parameters},
        "target_kind": target.kind,
        "target_origin": target.origin,
        **{f"target_{name}": value for name, value in target.values.items()},
        "outcome": "ok" if found else "failed",
        "reason": found.alone if found else reason,
        **{f"runs_{phase}": phases.count(phase) for phase in Phase},
        "runs_optimisation": sum(phase in OPTIMISATION for phase in phases),
        "runs_total": len(runs),
        "runs_failed": sum(not task.usable(run) for run in runs),
        "samples_left_out": sum(
            not task.usable(run)
            for run, phase in zip(runs, phases, strict=True)
            if phase in (Phase.SAMPLING, Phase.CHEAP)
        ),
        "wall_time": sum(run.wall_time for run in runs),
        "cpu_time": sum(run.cpu_time for run in runs),
        "host": runs[-1].host if runs else "",
        "finished_at": max((run.finished_at for run in runs), default=""),
    }
    if found is None:
        return line
    for name, (low, high) in found.sampled_range.items():
        line[f"sampled_{name}_min"], line[f"sampled_{name}_max"] = low, high
    for name, inside in found.reachable.items():
        line[f"reachable_{name}"] = inside
    for name, diagnostics in found.diagnostics.items():
        line[f"leave_one_out_rmse_{name}"] = diagnostics.leave_one_out_rmse
        line[f"kriging_noise_{name}"] = diagnostics.noise_sd
        line[f"kriging_at_bound_{name}"] = ", ".join(diagnostics.at_bound)
    for prefix, point in (("kriging_", found.kriging), ("dem_", found.dem), ("last_", found.last)):
        line |= {f"{prefix}{name}": value for name, value in {**point.parameters, **point.responses}.items()}
    return line | {
        "samples_left_out": found.left_out,
        "kriging_sum_of_squares": found.kriging.sum_of_squares,
        "kriging_stop": str(found.kriging_stop),
        "dem_sum_of_squares": found.dem.sum_of_squares,
        "dem_stop": str(found.dem_stop),
        "dem_run_id": found.dem_evaluation.run_id,
        "iterations": found.iterations,
    }


BEAD_COUNTS = {"poured": "poured", "filled": "filled", "heap": "on_plate", "lost": "lost"}
"""Counts of beads by their stored name: columns ``beads_NAME``, and keys of a journal."""


def evaluation_line(evaluation: Evaluation) -> dict[str, Any]:
    """Line of the table of evaluations, without what all lines of a row share."""
    request, run = evaluation.request, evaluation.run
    return {
        "phase": str(request.phase),
        "index": request.index,
        "run_id": evaluation.run_id,
        "seed": request.seed,
        **request.parameters,
        **run_line(run),
        "host": run.host,
        "finished_at": run.finished_at,
    }


def run_line(run: Run) -> dict[str, Any]:
    """What the table of evaluations says of a run itself, by its columns' names."""
    beads = run.beads
    return {
        **run.responses,
        "outcome": str(run.outcome),
        "reason": run.reason,
        "heap_radius": run.radius,
        "heap_height": run.height,
        **{f"beads_{k}": getattr(beads, name) if beads else None for k, name in BEAD_COUNTS.items()},
        "engine_time_step": run.engine_time_step,
        "simulated_time": run.simulated_time,
        "wall_time": run.wall_time,
        "cpu_time": run.cpu_time,
    }
