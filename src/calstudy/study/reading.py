"""A study as it is read for analysis: its settings, its plan, and the tables of its finished rows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd

from calstudy.calibration.confirmation import Confirmed, confirmed
from calstudy.calibration.fidelities.surrogates import FidelityRuns, TwoSurrogates
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES
from calstudy.calibration.narrowing import Profile, profiles
from calstudy.calibration.solutions import (
    Solutions,
    density_of,
    errors_of,
    in_the_way,
    left_free,
    noise_of,
    solve,
)
from calstudy.calibration.task import cost_of
from calstudy.errors import InputError, StoreError
from calstudy.parameters import Array
from calstudy.plan import NAMED, PARAMETERS, TESTS, Plan
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Phase
from calstudy.study.definition import Definition
from calstudy.study.definition.models import knowing
from calstudy.study.directory.store import read_table
from calstudy.study.settings import StudySettings, read_settings
from calstudy.written import html_table

OPTIMA = {"kriging": "Kriging", "dem": "DEM"}
"""The two data sets of sections 3.1 and 3.2: optimum and responses on the Kriging and on the DEM model."""
SWITCHES = ("MU_PP", "MU_PW", "YM", "RF_PW")
"""Factors of the plan that say whether a parameter is calibrated, in the order of Table B-1."""


@dataclass(frozen=True, eq=False)
class Study:
    """Tables as ``calstudy.study.schema`` documents them, by plan row; equal to itself alone."""

    settings: StudySettings
    plan: Plan
    calibrations: pd.DataFrame
    evaluations: pd.DataFrame
    heaps: pd.DataFrame
    replicated: pd.DataFrame | None = None
    """What each replicate on an emulator says to the paper's numbers (``replicated``); None without any."""
    replicated_rows: pd.DataFrame | None = None
    """What the calibrations of the replicates found; None where that is not asked for."""
    replicated_tests: pd.DataFrame | None = None
    """Rows of the replicates of a plan with several material tests; None without any."""
    beside: Study | None = None
    """Another study with replicates, to be compared with."""
    confirmed: pd.DataFrame | None = None
    """Runs with fresh seeds at the DEM optima; None where that is not asked for (``analysis.fresh_runs``)."""

    def _repr_html_(self) -> str:
        """What the study is and how far it is: what a notebook shows."""
        s = self.settings
        lines = (
            ("model", f"{s.model}, {s.fidelity} fidelity, {s.variant}"),
            ("engine", s.engine),
            ("mode, seed", f"{s.mode}, {s.seed}"),
            ("target", s.target.origin),
            ("rows finished", f"{len(self.ok)} of {self.planned}"),
            ("rows failed", str(len(self.failed))),
            ("DEM runs", str(len(self.evaluations))),
        )
        return html_table(f"study {s.id}", (), lines)

    @property
    def planned(self) -> int:
        """Number of rows of the plan."""
        return len(self.plan.rows)

    @cached_property
    def ok(self) -> pd.DataFrame:
        """Calibrations that succeeded: what every statistic is made from."""
        return self.calibrations[self.calibrations["outcome"] == "ok"].reset_index(drop=True)

    @cached_property
    def failed(self) -> pd.DataFrame:
        """Calibrations that failed, with their reasons."""
        return self.calibrations[self.calibrations["outcome"] != "ok"].reset_index(drop=True)

    @property
    def unfinished(self) -> list[int]:
        """Rows of the plan that the study does not have yet."""
        return sorted({row.run for row in self.plan.rows} - set(self.calibrations["row"]))

    def only(self, rows: Collection[int]) -> Study:
        """The study with some of its rows; the others count as not finished."""
        calibrations, evaluations, heaps = (
            table[table["row"].isin(rows)] for table in (self.calibrations, self.evaluations, self.heaps)
        )
        return replace(
            self,
            calibrations=calibrations.reset_index(drop=True),
            evaluations=evaluations,
            heaps=heaps,
        )

    def residuals(self, row: int, runs: pd.DataFrame) -> Array:
        """Residuals (n, m) of runs, whose columns are those of evaluations, by a row's cost (Eq. 9, 10)."""
        of_plan = self.plan.row(row)
        points = runs[list(self.plan.space(of_plan).box.names)].to_numpy(float)
        cost = cost_of(self.plan, of_plan, self.settings.target)
        return np.asarray(cost.residuals(points, runs[list(cost.responses)].to_numpy(float)))

    @property
    def common(self) -> tuple[str, ...]:
        """Responses at the optima that all rows have, the Rayleigh time-step included."""
        if not self.plan.tests:
            return self.settings.quantities.given
        return (*self.plan.tests[0].targets, RAYLEIGH_TIME_STEP)

    def where_calibrated(self, *parameters: str) -> pd.DataFrame:
        """Successful rows in which all of the parameters were calibrated."""
        chosen = self.ok[[f"calibrated_{p}" for p in parameters]].all(axis=1)
        return self.ok[chosen]

    def deviation(self, response: str, model: str = "dem") -> pd.Series:
        """Calibrated response minus the desired one, over the successful rows."""
        return self.ok[f"{model}_{response}"] - self.settings.target.values[response]

    def position(self, parameter: str, model: str = "dem") -> Array:
        """Place of the optimum in its interval, 0 to 1, over the rows where it was calibrated."""
        interval = next(p for p in self.plan.parameters if p.name == parameter)
        values = self.where_calibrated(parameter)[f"{model}_{parameter}"].to_numpy(float)
        place: Array = (values - interval.lower) / (interval.upper - interval.lower)
        return place

    def factors(self) -> pd.DataFrame:
        """Plan's factors, responses and run counts of the successful rows, for tests of effects."""
        names = ["WRL", "SPP"]
        frame = self.ok[["row", *names]].astype(float)
        for name in SWITCHES:
            frame[name] = self.ok[f"calibrated_{name}"].astype(float)
        if self.plan.tests:
            frame[TESTS] = [float(self.plan.row(row).TESTS or 0) for row in self.ok["row"]]
        for name in self.common:
            frame[name] = self.ok[f"dem_{name}"]
        for name in self.settings.target.values:
            frame[f"distance_{name}"] = self.deviation(name).abs()
        for name in ("runs_optimisation", "runs_total"):
            frame[name] = self.ok[name].astype(float)
        return frame

    def optima(self, model: str) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Parameters and responses at one model's optima (Table 5), successful rows."""
        responses = list(self.common)
        return (
            self.ok[[f"{model}_{p}" for p in PARAMETERS]].set_axis(list(PARAMETERS), axis=1),
            self.ok[[f"{model}_{r}" for r in responses]].set_axis(responses, axis=1),
        )

    def left_out(self) -> str:
        """What no statistic of this study contains, and why; empty when nothing is missing."""
        parts = []
        if len(self.failed):
            rows = ", ".join(
                f"{row} ({reason or 'no reason stored'})"
                for row, reason in zip(self.failed["row"], self.failed["reason"], strict=True)
            )
            parts.append(f"left out because the calibration failed: row {rows}")
        if self.unfinished:
            parts.append(f"{len(self.unfinished)} of {self.planned} rows are not finished")
        return "; ".join(parts)

    def provenance(self, n: int | None = None) -> str:
        """One line for captions: n, fidelity, engine, target, and what was left out."""
        s = self.settings
        rows = f"n = {len(self.ok) if n is None else n} rows of {self.planned}"
        where = f"{s.at}, {s.mode} mode, {s.engine}"
        left_out = self.left_out()
        return f"{rows}; {where}; target: {s.target.origin}." + (
            f" {left_out[0].upper()}{left_out[1:]}." if left_out else ""
        )


def plan_of(directory: Path, settings: StudySettings, plan_file: Path | None = None) -> Plan:
    """Plan of the study in ``directory``, from a file or from the package; InputError where it is another."""
    if settings.case is not None:
        raise InputError(
            f"{directory} is a calibration of one's own, not rows of a plan; "
            f"its results are in {directory / 'report' / 'report.html'}, which 'calstudy calibrate' writes"
        )
    if plan_file is None and settings.plan in NAMED:
        plan_file = Path(settings.plan)
    plan = load_plan(plan_file)
    if plan.hash != settings.plan_hash:
        raise InputError(
            f"{directory} was made with another plan (hash {settings.plan_hash[:12]}) than "
            f"{plan.origin} ({plan.hash[:12]}); name its file with --plan"
        )
    return plan


def read_study(directory: str | Path, plan_file: Path | None = None) -> Study:
    """Read the finished rows of a study, which may be running still.

    Raises StoreError when the directory is no study or a table is damaged, InputError when the plan at
    hand is not the one that the study was made with.
    """
    directory = Path(directory)
    settings = read_settings(directory)
    plan = plan_of(directory, settings, plan_file)
    # Calibrations first: a row that finishes meanwhile has its other tables in place before this one.
    quantities = settings.quantities
    calibrations = read_table(directory, "calibrations", quantities).sort_values("row", ignore_index=True)
    finished = set(calibrations["row"])
    unknown = finished - {row.run for row in plan.rows}
    if unknown:
        raise StoreError(
            f"{directory}/calibrations holds row {min(unknown)}, which the plan has not; "
            "restore the study, or remove that row's files"
        )
    evaluations, heaps = (read_table(directory, name, quantities) for name in ("evaluations", "heaps"))
    evaluations, heaps = (t[t["row"].isin(finished)] for t in (evaluations, heaps))
    if settings.tests:
        evaluations = _joined(evaluations)
    without = finished - set(evaluations["row"])
    if without:
        raise StoreError(
            f"{directory}/evaluations lacks row {min(without)}, which is in calibrations; "
            "restore the file, or delete the row's files in calibrations and heaps to run it again"
        )
    return Study(settings, plan, calibrations, evaluations, heaps)


def _joined(evaluations: pd.DataFrame) -> pd.DataFrame:
    """One line for each parameter set that a row asked for, with the responses of all its material tests.

    It has the first test's run, whose heap is stored.
    """
    groups = evaluations.groupby(["row", "phase", "index"], sort=False)
    # Each response is that of one test; the others' lines have NaN there.
    found = groups.first().reset_index()[list(evaluations.columns)]
    by = groups["outcome"].agg(lambda of: next((o for o in of if o != Outcome.OK), str(Outcome.OK)))
    return found.assign(
        outcome=by.to_numpy(),
        wall_time=groups["wall_time"].sum().to_numpy(),
        cpu_time=groups["cpu_time"].sum().to_numpy(),
    )


@dataclass(frozen=True)
class Result:
    """A finished calibration, read from its study directory."""

    definition: Definition
    settings: StudySettings
    line: Mapping[str, Any]
    """Its line of the table of calibrations."""
    evaluations: pd.DataFrame
    heaps: pd.DataFrame

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter and response."""
        return self.settings.quantities.units

    @property
    def optimum(self) -> dict[str, float]:
        """Calibrated parameters at the DEM optimum, in their units."""
        return {name: float(self.line[f"dem_{name}"]) for name in self.definition.task.space.box.names}

    @property
    def following(self) -> tuple[str, ...]:
        """Parameters that follow from others."""
        return tuple(p.name for p in self.definition.task.space.parameters if p.formula is not None)

    @property
    def optimum_point(self) -> Array:
        """The DEM optimum as a point (d,) of the box."""
        return self.definition.task.space.point(self.optimum)

    @property
    def responses(self) -> dict[str, float]:
        """Responses at the optimum, as the model gave them."""
        return {name: float(self.line[f"dem_{name}"]) for name in self.definition.task.cost.responses}

    @cached_property
    def surrogates(self) -> Surrogates:
        """Kriging models of all usable runs, second optimisation included, as ``robust`` fits them.

        NumericsError where too few runs are usable.
        """
        task, settings = self.definition.task, knowing(MODES["robust"], self.definition.models).kriging
        expensive = self.runs(self.evaluations["phase"] != Phase.CHEAP)
        names = task.cost.responses
        if task.cheap is not None and not self.line["reason"]:
            cheap = task.cheap.earlier or self.runs(self.evaluations["phase"] == Phase.CHEAP)
            return TwoSurrogates.of(settings, task.space, names, task.cheap, (cheap, expensive), task.noise)
        return Surrogates.fit(settings, task.space, names, expensive.points, expensive.responses, task.noise)

    @cached_property
    def confirmed(self) -> Confirmed | None:
        """What the runs with fresh seeds at the optimum say; None without any."""
        task = self.definition.task
        again = self.runs(self.evaluations["phase"] == Phase.CONFIRMATION).usable
        chosen = np.all(again.points == self.optimum_point, axis=1)
        if not chosen.any():
            return None
        assumed = np.array([self.noise[name] for name in task.cost.responses])
        return confirmed(again.responses[chosen], task.good, assumed)

    def runs(self, chosen: pd.Series) -> FidelityRuns:
        """Runs of a part of the table of evaluations."""
        task = self.definition.task
        points, responses = [], []
        for _, runs in self.evaluations[chosen].groupby(["phase", "index"], sort=False):
            # Each response is that of one model; NaN where it gave none.
            run = runs.iloc[0]
            points.append(task.space.point({name: float(run[name]) for name in task.space.box.names}))
            responses.append(runs[list(task.cost.responses)].max().to_numpy(float))
        return FidelityRuns(
            np.array(points).reshape(-1, task.space.box.dimension),
            np.array(responses).reshape(-1, len(task.cost.responses)),
        )

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviation of one run of each response: known, or else what Kriging estimates."""
        return noise_of(self.definition.task, self.surrogates)

    @cached_property
    def averaged(self) -> Surrogates:
        """The Kriging models averaged over plausible hyperparameters, for the solution space."""
        return self.surrogates.averaged(self.definition.task.seed)

    @cached_property
    def solutions(self) -> Solutions:
        """What else does as well: the posterior."""
        task = self.definition.task
        return solve(task, self.averaged, errors_of(task, self.noise))

    @cached_property
    def profiles(self) -> list[Profile]:
        """Profile of each calibrated parameter: how well the others can fit at each of its values."""
        task = self.definition.task
        density = density_of(task, self.averaged, self.solutions.errors)
        drawn = task.space.box.to_unit(self.solutions.points)
        return profiles(lambda u: density.prior(u) + density.fit(u), drawn, density.first, task.seed)

    @cached_property
    def free(self) -> list[str]:
        """Parameters that the targets leave free."""
        return left_free(self.definition.task, self.solutions)

    @cached_property
    def bounds(self) -> dict[str, str]:
        """What is in the way of what, by parameter."""
        found = in_the_way(self.definition.task, self.surrogates, self.optimum_point)
        return {b.parameter: f"its {b.end} bound is in the way" for b in found}

    def _repr_html_(self) -> str:
        """Targets and responses, intervals and optimum: what a notebook shows."""
        task, units = self.definition.task, self.units
        return html_table(
            "calibrated to",
            ("response", "target", "optimum", "unit"),
            [
                (n, f"{v:.5g}", f"{self.responses[n]:.5g}", units[n])
                for n, v in task.cost.target.values.items()
            ],
        ) + html_table(
            f"{self.line['runs_total']} runs, {self.line['runs_failed']} failed",
            ("parameter", "interval", "optimum", "unit"),
            [
                (p.name, p.interval, f"{self.optimum[p.name]:.4g}", p.unit)
                for p in task.space.parameters
                if p.name in self.optimum
            ],
        )


def read_result(directory: Path, definition: Definition, settings: StudySettings) -> Result | None:
    """Result of a finished study; None where the calibration failed."""
    tables = {
        name: read_table(directory, name, settings.quantities)
        for name in ("calibrations", "evaluations", "heaps")
    }
    if tables["calibrations"].empty:
        raise StoreError(f"{directory}: the calibration is not finished; run the same command again")
    line = cast(dict[str, Any], tables["calibrations"].to_dict("records")[0])
    if line["outcome"] != "ok":
        return None
    return Result(definition, settings, line, tables["evaluations"], tables["heaps"])
