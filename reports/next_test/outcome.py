"""Promise against outcome: what `calstudy advise` says that tests leave, and what calibrations leave.

    python reports/next_test/outcome.py TEST OTHER_TEST FIRST LAST [EMULATORS]

For the hidden truths FIRST to LAST, with the laboratory's errors drawn: the advice on a file with the heap
alone, then calibrations (mode robust, the model a draw of its own) with the heap alone and with each of two
tests. A line a truth, set of tests and parameter in outcomes.csv; what is there is not made again. EMULATORS
is a folder with a folder of each test; without it the shipped ones answer.
"""

import csv
import sys
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES
from calstudy.calibration.posterior import log_likelihood
from calstudy.calibration.procedure import calibrate
from calstudy.emulator.advice import foretold as simulation
from calstudy.emulator.advice.advice import emulators_by_test, question_of
from calstudy.emulator.advice.foretold import foretell
from calstudy.emulator.advice.preposterior import after
from calstudy.emulator.emulator import read_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.models.angle_of_repose import shipped_model
from calstudy.models.find import model_folder
from calstudy.models.folder import load_folder
from calstudy.records import Evaluation
from calstudy.study.definition import read_definition

HERE = Path(__file__).parent
HEAP = "angle_of_repose"
BOX = {
    "DENS": (2300.0, 2700.0),
    "MU_PP": (0.05, 0.6),
    "MU_PW": (0.05, 0.6),
    "RF_PP": (0.001, 0.2),
    "RF_PW": (0.001, 0.2),
    "YM": (4.2e8, 1.25e9),
}
SIMULATED = 4
POINTS = 2**13
COLUMNS = ["truth", "tests", "parameter", "value", "promised", "got", "mean", "runs", "effective"]


def file_of(tests, values, errors):
    """Text of a calibration's file: a test's responses have its name before them."""
    lines = ['mode = "robust"', "seed = 1", "WRL = 0"]
    for test in tests:
        lines += ["[[models]]", f'name = "{test}"', f'label = "{test}"', 'fidelity = "coarse"']
    lines += [
        "[parameters]",
        *(f"{name} = [{low}, {high}]" for name, (low, high) in BOX.items()),
        "[targets]",
    ]
    lines += [
        f"{test}_{name} = {{ value = {value!r}, sd = {errors[test][name]!r} }}"
        for test in tests
        for name, value in values[test].items()
    ]
    return "\n".join(lines) + "\n"


def calibrated(definition, engines, seed):
    """Covariance (d, d), mean (d,), effective points and DEM runs of a calibration, in the unit cube."""
    task = replace(definition.task, seed=seed)
    answered = []

    def evaluate(requests):
        new = [
            Evaluation.joined(
                [
                    Evaluation(r, "", engine.run(r.parameters, r.seed, Path(), threading.Event()))
                    for engine in engines
                ]
            )
            for r in requests
        ]
        answered.extend(new)
        return new

    calibrate(task, evaluate)
    points = np.array([task.space.point(e.request.parameters) for e in answered])
    responses = np.array([task.measured(e.run) for e in answered])
    divisors = {n: p for chosen in definition.models for n, p in chosen.proportional.items()}
    kriging = replace(MODES["robust"].kriging, divisors=divisors)
    names = task.cost.responses
    fitted = Surrogates.fit(kriging, task.space, names, points, responses, task.noise).averaged(task.seed)
    unit = qmc.Sobol(task.space.box.dimension, seed=seed).random(POINTS)
    means, doubts = fitted.predict_with_deviations(task.space.box.from_unit(unit))
    errors = np.array([task.cost.target.sd[name] for name in names])
    log = log_likelihood(task.cost.deviations(means), doubts, errors)
    found = after(unit, log[None])
    weights = np.exp(log - log.max())
    return (
        found.covariance[0],
        weights @ unit / weights.sum(),
        found.effective[0],
        len(answered) * len(engines),
    )


def of_truth(k, tests, sets, emulators, folder):
    """Lines of a truth: what was promised and what came out, for each set of tests."""
    rng = np.random.default_rng([2017, k])
    unit = 0.1 + 0.8 * qmc.Sobol(len(BOX), seed=2017).random(64)[k]
    low, high = np.array(list(BOX.values())).T
    truth = dict(zip(BOX, low + unit * (high - low), strict=True))
    values, errors, engines = {}, {}, {}
    for name in dict.fromkeys(n for of in sets for n in of):
        test = tests[name]
        model = model_of(name)
        engines[name] = EmulatorEngine(model, emulators[name], 1000 + k, rounded=True, prefix=f"{name}_")
        exact = engines[name].twin(truth).values
        errors[name] = {r: float(test.errors[r]) for r in test.responses}
        values[name] = {r: float(exact[r] + errors[name][r] * rng.standard_normal()) for r in test.responses}

    def definition(of):
        path = folder / f"{k}.toml"
        path.write_text(file_of(of, values, errors))
        return read_definition(path)

    chosen = {n: emulators[n] for n in dict.fromkeys(n for of in sets for n in of)}
    question = question_of(
        definition(sets[0]), None, chosen, {(t, r): e for t in errors for r, e in errors[t].items()}
    )
    question = replace(question, procedure=replace(question.procedure, seed=100 + k))
    asked = [tuple((n, r) for n in of[1:] for r in tests[n].responses) for of in sets[1:]]
    foretold = foretell(question.procedure, question.now, question.tests, asked, simulated=SIMULATED)
    promised = [foretold.now.mean(axis=0), *(foretold.after[a].covariance.mean(axis=0) for a in asked)]
    lines = []
    for of, promise in zip(sets, promised, strict=True):
        got, mean, effective, runs = calibrated(definition(of), [engines[n] for n in of], k)
        for i, name in enumerate(BOX):
            width = [float(f"{np.sqrt(c[i, i]):.4g}") for c in (promise, got)]
            numbers = [round(float(mean[i]), 4), runs, round(float(effective))]
            lines.append([k, "+".join(of), name, round(float(unit[i]), 4), *width, *numbers])
    return lines


def model_of(name):
    """The test at the emulators' fidelity."""
    return shipped_model("coarse") if name == HEAP else load_folder(model_folder(name), fidelity="coarse")


def main(test, other, first, last, emulators=None):
    """Append the truths that are not there yet."""
    path = HERE / "outcomes.csv"
    sets = [(HEAP,), (HEAP, test), (HEAP, other)]
    given = [read_emulator(at) for at in sorted(Path(emulators).iterdir())] if emulators else []
    known = emulators_by_test(given)
    there = set()
    if path.exists():
        there = {int(line["truth"]) for line in csv.DictReader(path.open())}
    else:
        path.write_text(",".join(COLUMNS) + "\n")
    simulation.POINTS, simulation.FIRST = 2048, 2**14  # widths of a tenth of the box need no more
    with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
        tests = question_of(None, None, known, {}).tests
        for k in range(int(first), int(last) + 1):
            if k in there:
                continue
            lines = of_truth(k, tests, sets, known, Path(folder))
            with path.open("a", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(lines)


if __name__ == "__main__":
    main(*sys.argv[1:])
