"""Whether the solution space is what it says: simulation-based calibration on a shipped emulator.

    OMP_NUM_THREADS=1 python benchmarks/posterior.py ranks --out ranks.csv    (ten minutes for 240 cases)
    OMP_NUM_THREADS=1 python benchmarks/posterior.py --fidelity full --cheap soft ranks --out two.csv
    python benchmarks/posterior.py table ranks.csv
    python benchmarks/posterior.py emcee --cases 2                             (needs emcee; a minute)

Each case draws true parameters from the uniform prior of all six intervals, and the DEM model from the
emulator's posterior. Measured values are drawn at the truth: in even cases the mean response with a known
error, in odd ones a single run, without a known error. A calibration in mode ``robust`` with its noisy runs
then gives a solution space. If that is right, the rank of the true value among values drawn from the solution
space is uniform, for any quantity (Talts et al., arXiv 1804.06788): here each parameter, the surrogates' mean
of each response, and the likelihood. ``table`` tests it by chi-square, and prints how often the middle 50 and
90 % hold the truth. With
``--cheap`` the calibration has two fidelities, and the DEM model is an independent draw from either emulator.

``emcee`` draws the same densities with an independent sampler and compares means and standard deviations.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from calstudy.calibration.cost import Cost
from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES
from calstudy.calibration.posterior import log_likelihood
from calstudy.calibration.procedure import calibrate, fit
from calstudy.calibration.solutions import Solutions, errors_of, solve
from calstudy.calibration.task import Runs, Task
from calstudy.emulator.emulator import Answers, Emulator, read_emulator, shipped_emulator
from calstudy.errors import NumericsError
from calstudy.models.angle_of_repose import DEFAULT_MODEL, load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, PROPORTIONAL
from calstudy.parameters import Array, Space
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import Evaluation, Outcome, Phase, Request, Run, Target
from calstudy.study.fidelities import cheap_of

PLAN = load_plan()
SPACE = Space(PLAN.parameters, tuple(PARAMETERS))
ERRORS = {ANGLE_OF_REPOSE: 0.5, BULK_DENSITY: 5.0}
"""Known errors of the even cases."""
RANKED = 199
"""Values drawn from each solution space, so that ranks are 0 to 199."""
DRAWN = 200
"""Points of each solution space: fewer than a report has, for speed."""
BINS = 20
CHEAP_DRAW = 10_000
"""What is added to the number of a case for its draw of the cheap fidelity."""
COLUMNS = ("case", "runs", *(f"rank_{name}" for name in (*PARAMETERS, *MEASURED, "likelihood")), "failure")


@dataclass(frozen=True)
class Model:
    """The DEM model of one case: a draw from the emulator's posterior; callable as ``evaluate``."""

    emulator: Emulator
    answers: dict[str, Answers]

    @classmethod
    def drawn(cls, emulator: Emulator, number: int) -> Model:
        """A draw from an emulator's posterior."""
        return cls(emulator, emulator.draw(number))

    def responses(self, parameters: dict[str, float]) -> tuple[Array, Array]:
        """Means and standard deviations of a run of the measured responses (m,)."""
        at = np.clip(self.emulator.point(parameters), 0.0, 1.0)
        of = [(self.answers[r.name], r.name) for r in self.emulator.responses]
        factors = [parameters[PROPORTIONAL[name]] if name in PROPORTIONAL else 1.0 for name in MEASURED]
        means = np.array([one.noise_free(at)[0] for one, _ in of]) * factors
        return means, np.array([one.noise_sd(at)[0] for one, _ in of]) * factors

    def __call__(self, requests: Sequence[Request]) -> list[Evaluation]:
        """Noisy answers."""
        found = []
        for request in requests:
            means, noise = self.responses(dict(request.parameters))
            values = means + noise * np.random.default_rng(request.seed).standard_normal(len(means))
            run = Run(Outcome.OK, "", dict(zip(MEASURED, map(float, values), strict=True)), 0.0, 0.0)
            found.append(Evaluation(request, "", run))
        return found


@dataclass(frozen=True)
class Case:
    """A truth, and what a calibration to measurements of it says."""

    truth: Array
    task: Task
    surrogates: Surrogates
    solutions: Solutions
    runs: int

    def log_likelihood(self, points: Array) -> Array:
        """Logarithms (k,) of the likelihood of points (k, d), without a constant."""
        means, doubts = self.surrogates.predict_with_deviations(points)
        errors = np.array([*self.solutions.errors.values()])
        return log_likelihood(self.task.cost.deviations(means), doubts, errors)

    def ranks(self) -> dict[str, int]:
        """Ranks of the true values, 0 to RANKED."""
        drawn = self.solutions.points[:: len(self.solutions.points) // RANKED][:RANKED]
        at = np.vstack([self.truth, drawn])
        means = self.surrogates.predict(at)
        values = {
            **dict(zip(PARAMETERS, at.T, strict=True)),
            **dict(zip(MEASURED, means.T, strict=True)),
            "likelihood": self.log_likelihood(at),
        }
        return {f"rank_{name}": int((v[1:] < v[0]).sum()) for name, v in values.items()}


@dataclass(frozen=True)
class Fidelities:
    """The emulators of a case, and what is known of them."""

    emulator: Emulator
    cheap: Emulator | None
    of_cheap: Cheap | None
    """None for one fidelity, as is its emulator."""

    @classmethod
    def of(cls, fidelity: str, cheap: str | None) -> Fidelities:
        """By their names."""
        emulators = [
            read_emulator(shipped_emulator(DEFAULT_MODEL, name, "ring")) for name in (fidelity, cheap) if name
        ]
        if cheap is None:
            return cls(emulators[0], None, None)
        pair = load_model(PLAN.fixed, fidelity), load_model(PLAN.fixed, cheap)
        known = cheap_of([pair], SPACE.complete(SPACE.box.centre))
        known = replace(known, is_measured=False, noise=known_noise(emulators[1]))
        return cls(emulators[0], emulators[1], known)


def case_of(given: Fidelities, number: int, noise: dict[str, float], averaged: bool = True) -> Case:
    """Calibrate a case; NumericsError if the calibration fails."""
    rng = np.random.default_rng([2026, number])
    box = SPACE.box
    truth = box.from_unit(rng.random(box.dimension))
    model = Model.drawn(given.emulator, number)
    cheap = model if given.cheap is None else Model.drawn(given.cheap, CHEAP_DRAW + number)
    means, sds = model.responses(SPACE.complete(truth))
    errors = np.array([ERRORS[name] for name in MEASURED]) if number % 2 == 0 else sds
    measured = means + errors * rng.standard_normal(len(means))
    target = Target(
        dict(zip(MEASURED, map(float, measured), strict=True)),
        "set",
        f"case {number}",
        sd=ERRORS if number % 2 == 0 else {},
    )
    cost = Cost(SPACE, target, 0.0, (PLAN.fixed.particles,))
    mode = MODES["robust"].knowing(PROPORTIONAL, ratios=dict.fromkeys(MEASURED, ("YM", "DENS")))
    task = Task(1, SPACE, None, cost, mode, 1000 + number, 1, noise, cheap=given.of_cheap)
    runs = Runs(task, lambda _: ())

    def evaluate(requests: Sequence[Request]) -> list[Evaluation]:
        found = (cheap if requests[0].phase is Phase.CHEAP else model)(requests)
        runs.answers += [(SPACE.point(e.request.parameters), e) for e in found]
        return found

    if calibrate(task, evaluate).alone:
        task = replace(task, cheap=None)
    surrogates = fit(task, runs)
    surrogates = surrogates.averaged(task.seed) if averaged else surrogates
    solutions = solve(task, surrogates, errors_of(task, noise), DRAWN)
    return Case(truth, task, surrogates, solutions, len(runs.answers))


def known_noise(emulator: Emulator) -> dict[str, float]:
    """Standard deviations of a run in the middle of the box."""
    _, sds = Model(emulator, emulator.means()).responses(SPACE.complete(SPACE.box.centre))
    return dict(zip(MEASURED, map(float, sds), strict=True))


def rank(given: Fidelities, cases: Sequence[int], out: Path, averaged: bool) -> None:
    """Append a line for each case that is not in the file yet."""
    if not out.exists():
        out.write_text(",".join(COLUMNS) + "\n")
    done, noise = set(pd.read_csv(out)["case"]), known_noise(given.emulator)
    for number in sorted(set(cases) - done):
        line: dict[str, object] = {"case": number, "failure": ""}
        try:
            case = case_of(given, number, noise, averaged)
            line |= {"runs": case.runs, **case.ranks()}
        except NumericsError as error:
            line["failure"] = str(error)
        with out.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS).writerow(line)
    print(f"{out}: {len(cases)} cases")


def uniformity(ranks: Array, bins: int = BINS) -> float:
    """Probability of a chi-square as large as that of the ranks (n,), 0 to RANKED, were they uniform."""
    counts = np.bincount(ranks.astype(int) * bins // (RANKED + 1), minlength=bins)
    expected = len(ranks) / bins
    return float(chi2.sf(((counts - expected) ** 2 / expected).sum(), bins - 1))


def table(paths: Sequence[Path]) -> None:
    """Print, in Markdown, the test of each quantity: of all cases, of known errors, and of single runs."""
    lines = pd.concat([pd.read_csv(path) for path in paths])
    failed = lines["failure"].notna()
    lines = lines[~failed]
    print(
        f"{len(lines)} cases, {lines['runs'].mean():.1f} runs each; {int(failed.sum())} calibrations failed\n"
    )
    print("| quantity | p, all | p, known errors | p, single runs | middle 50 % | middle 90 % |")
    print("|---|---|---|---|---|---|")
    even = lines["case"] % 2 == 0
    for name in COLUMNS[2:-1]:
        ranks = lines[name].to_numpy()
        share = (ranks + 0.5) / (RANKED + 1)
        held = [float((np.abs(share - 0.5) <= half / 2).mean()) for half in (0.5, 0.9)]
        p = [uniformity(ranks), *(uniformity(lines[name][of].to_numpy(), BINS // 2) for of in (even, ~even))]
        cells = (name.removeprefix("rank_"), *(f"{x:.3f}" for x in p), *(f"{x:.3f}" for x in held))
        print(f"| {' | '.join(cells)} |")


def beside_emcee(given: Fidelities, cases: int, steps: int) -> None:
    """Print means and standard deviations by both samplers, in shares of each interval."""
    import emcee

    noise, d = known_noise(given.emulator), len(PARAMETERS)
    print("| case | parameter | mean | emcee | sd | emcee |\n|---|---|---|---|---|---|")
    for number in range(cases):
        case = case_of(given, number, noise)
        box = SPACE.box

        def density(unit: Array, case: Case = case) -> Array:
            inside = np.all((unit >= 0.0) & (unit <= 1.0), axis=1)
            found = case.log_likelihood(SPACE.box.from_unit(np.clip(unit, 0.0, 1.0)))
            return np.where(inside, found, -np.inf)

        rng = np.random.default_rng(number)
        sampler = emcee.EnsembleSampler(64, d, density, vectorize=True)
        sampler.random_state = np.random.RandomState(number).get_state()
        sampler.run_mcmc(rng.random((64, d)), steps)
        chain = sampler.get_chain(discard=steps // 5, flat=True)
        own = box.to_unit(case.solutions.points)
        for k, name in enumerate(PARAMETERS):
            cells = (own[:, k].mean(), chain[:, k].mean(), own[:, k].std(), chain[:, k].std())
            print(f"| {number} | {name} | {' | '.join(f'{x:.3f}' for x in cells)} |")
        time = sampler.get_autocorr_time(quiet=True).max()
        print(f"case {number}: emcee's autocorrelation time {time:.0f} of {steps} steps", file=sys.stderr)


def main() -> None:
    """Rank cases, print the table, or compare with emcee."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--fidelity", default="soft")
    parser.add_argument("--cheap", help="fidelity of the cheap runs; default: one fidelity")
    kinds = parser.add_subparsers(dest="kind", required=True)
    ranks = kinds.add_parser("ranks")
    ranks.add_argument("--cases", type=int, default=240)
    ranks.add_argument("--first", type=int, default=0, help="number of the first case")
    ranks.add_argument("--out", type=Path, required=True)
    ranks.add_argument("--most-probable", action="store_true", help="hyperparameters are not averaged")
    kinds.add_parser("table").add_argument("files", type=Path, nargs="+")
    beside = kinds.add_parser("emcee")
    beside.add_argument("--cases", type=int, default=2)
    beside.add_argument("--steps", type=int, default=10000)
    a = parser.parse_args()
    if a.kind == "table":
        return table(a.files)
    given = Fidelities.of(a.fidelity, a.cheap)
    with threadpool_limits(1):
        if a.kind == "ranks":
            return rank(given, range(a.first, a.first + a.cases), a.out, not a.most_probable)
        return beside_emcee(given, a.cases, a.steps)


if __name__ == "__main__":
    main()
