"""Promise against outcome on LIGGGHTS: the runs of the design stand for calibrations.

    python reports/next_test/real.py TEST OTHER_TEST FIRST LAST

The truth is the point of the k-th run of design/TEST, and what was measured is what LIGGGHTS gave there, with
the laboratory's errors on top. SAMPLES other runs of the design are the calibration: there is no second
optimisation. The noise of the run is part of the error, in the promise as in the outcome. A line a truth, set
of tests and parameter in real.csv, as in outcomes.csv.
"""

import csv
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from outcome import BOX, COLUMNS, HEAP, HERE, POINTS, SIMULATED, file_of
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES
from calstudy.calibration.posterior import log_likelihood
from calstudy.emulator.advice import foretold as simulation
from calstudy.emulator.advice.advice import emulators_by_test, question_of
from calstudy.emulator.advice.foretold import Runs, foretell
from calstudy.emulator.advice.preposterior import after
from calstudy.study.definition import read_definition

SAMPLES = 19


def of_truth(k, tests, sets, runs, folder):
    """Lines of a truth."""
    rng = np.random.default_rng([2018, k])
    names = list(dict.fromkeys(n for of in sets for n in of))
    others = rng.permutation([i for i in range(len(runs[HEAP])) if i != k])[:SAMPLES]
    values, errors = {}, {}
    for name in names:
        test, line = tests[name], runs[name].iloc[k]
        noise = dict.fromkeys(test.responses, 0.0) | dict(test.noise)
        errors[name] = {r: float(np.hypot(test.errors[r], noise[r])) for r in test.responses}
        values[name] = {r: float(line[r] + test.errors[r] * rng.standard_normal()) for r in test.responses}

    def definition(of):
        path = folder / f"{k}.toml"
        path.write_text(file_of(of, values, errors))
        return read_definition(path)

    emulators = {n: tests[n].emulator for n in names}
    given = {(t, r): e for t in errors for r, e in errors[t].items()}
    question = question_of(definition(sets[0]), None, emulators, given)
    procedure = replace(question.procedure, seed=200 + k, runs=Runs(SAMPLES, 0, 0))
    asked = [tuple((n, r) for n in of[1:] for r in tests[n].responses) for of in sets[1:]]
    found = foretell(procedure, question.now, question.tests, asked, simulated=SIMULATED)
    promised = [found.now.mean(axis=0), *(found.after[a].covariance.mean(axis=0) for a in asked)]
    space = question.procedure.space
    points = runs[HEAP].iloc[others][list(BOX)].to_numpy(float)
    truth = space.box.to_unit(runs[HEAP].iloc[k][list(BOX)].to_numpy(float))
    unit = qmc.Sobol(len(BOX), seed=k).random(POINTS)
    logs, lines = {}, []
    for name in names:
        test = tests[name]
        kriging = replace(MODES["robust"].kriging, divisors=test.proportional)
        responses = runs[name].iloc[others][list(test.responses)].to_numpy(float)
        fitted = Surrogates.fit(kriging, space, test.responses, points, responses, test.noise).averaged(k)
        means, doubts = fitted.predict_with_deviations(space.box.from_unit(unit))
        measured = np.array([values[name][r] for r in test.responses])
        sds = np.array([errors[name][r] for r in test.responses])
        logs[name] = log_likelihood(means - measured, doubts, sds)
    for of, promise in zip(sets, promised, strict=True):
        log = np.sum([logs[name] for name in of], axis=0)
        got, weights = after(unit, log[None]), np.exp(log - log.max())
        mean = weights @ unit / weights.sum()
        for i, parameter in enumerate(BOX):
            width = [float(f"{np.sqrt(c[i, i]):.4g}") for c in (promise, got.covariance[0])]
            numbers = [round(float(mean[i]), 4), SAMPLES * len(of), round(float(got.effective[0]))]
            lines.append([k, "+".join(of), parameter, round(float(truth[i]), 4), *width, *numbers])
    return lines


def main(test, other, first, last):
    """Append truths."""
    path, sets = HERE / "real.csv", [(HEAP,), (HEAP, test), (HEAP, other)]
    if not path.exists():
        path.write_text(",".join(COLUMNS) + "\n")
    there = {int(line["truth"]) for line in csv.DictReader(path.open())}
    simulation.POINTS, simulation.FIRST = 2048, 2**14
    runs = {n: pd.read_parquet(HERE / "design" / n / "runs.parquet") for n in (HEAP, test, other)}
    assert all(list(table["label"]) == list(runs[HEAP]["label"]) for table in runs.values())
    with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
        tests = question_of(None, None, emulators_by_test([]), {}).tests
        for k in range(int(first), int(last) + 1):
            if k not in there:
                lines = of_truth(k, tests, sets, runs, Path(folder))
                with path.open("a", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerows(lines)


if __name__ == "__main__":
    main(*sys.argv[1:])
