"""Promise against outcome on LIGGGHTS: whole calibrations to hidden truths.

    python reports/next_test/hidden.py CAMPAIGN FIRST LAST TEST...

For the hidden truths FIRST to LAST, the heap and each TEST are run once there on LIGGGHTS, with the
laboratory's error on top; the noise of that run is part of the error. Then `calstudy calibrate` (mode
`robust`) goes with the heap alone and with each TEST, into CAMPAIGN/TRUTH, and on if it was interrupted. A
line a truth, set of tests and parameter in hidden.csv, as in outcomes.csv: what was promised before any of
these runs, and the solution space of the calibration. A set that is there is not calibrated again.
"""

import csv
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from outcome import BOX, COLUMNS, HEAP, HERE, SIMULATED, file_of, model_of
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from calstudy.emulator.advice import foretold as simulation
from calstudy.emulator.advice.advice import emulators_by_test, question_of
from calstudy.emulator.advice.foretold import foretell
from calstudy.engines.choose import open_engine
from calstudy.study.definition import read_definition
from calstudy.study.run.definition import calibrate_file
from calstudy.study.run.work import Running

SEED = 2019


def truth_of(k):
    """Point in the unit cube, and the parameters."""
    unit = 0.1 + 0.8 * qmc.Sobol(len(BOX), seed=SEED).random(64)[k]
    low, high = np.array(list(BOX.values())).T
    return unit, dict(zip(BOX, map(float, low + unit * (high - low)), strict=True))


def measured(k, names, tests, folder):
    """Values and errors by test and response."""
    rng, (_, truth) = np.random.default_rng([SEED, k]), truth_of(k)
    values, errors = {}, {}
    for name in names:
        test = tests[name]
        run = open_engine(model=model_of(name)).run(truth, 1000 + k, folder / name, threading.Event())
        assert run.usable, run.reason
        noise = dict.fromkeys(test.responses, 0.0) | dict(test.noise)
        errors[name] = {r: float(np.hypot(test.errors[r], noise[r])) for r in test.responses}
        values[name] = {
            r: float(run.responses[r] + test.errors[r] * rng.standard_normal()) for r in test.responses
        }
    return values, errors


def of_truth(k, tests, sets, campaign):
    """Lines of a truth, for one set of tests after the other."""
    folder = campaign / f"truth-{k}"
    names = list(dict.fromkeys(n for of in sets for n in of))
    written = folder / "errors.csv"
    if not written.exists():
        folder.mkdir(parents=True, exist_ok=True)
        values, errors = measured(k, names, tests, folder / "measured")
        for of in sets:
            (folder / f"{'-'.join(of)}.toml").write_text(file_of(of, values, errors))
        lines = [(n, r, repr(e)) for n in errors for r, e in errors[n].items()]
        with written.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)
    given = {(n, r): float(e) for n, r, e in csv.reader(written.open())}
    alone = read_definition(folder / f"{HEAP}.toml")
    question = question_of(alone, None, {n: tests[n].emulator for n in names}, given)
    question = replace(question, procedure=replace(question.procedure, seed=300 + k))
    asked = [tuple((n, r) for n in of[1:] for r in tests[n].responses) for of in sets[1:]]
    found = foretell(question.procedure, question.now, question.tests, asked, simulated=SIMULATED)
    promised = [found.now.mean(axis=0), *(found.after[a].covariance.mean(axis=0) for a in asked)]
    unit, _ = truth_of(k)
    for of, promise in zip(sets, promised, strict=True):
        path = folder / f"{'-'.join(of)}.toml"
        result = calibrate_file(path, folder / "studies" / path.stem, Running(workers=1))
        drawn = result.definition.task.space.box.to_unit(result.solutions.points)
        lines = []
        for i, name in enumerate(BOX):
            widths = [float(f"{w:.4g}") for w in (np.sqrt(promise[i, i]), drawn[:, i].std())]
            numbers = [round(float(drawn[:, i].mean()), 4), len(result.evaluations), len(drawn)]
            lines.append([k, "+".join(of), name, round(float(unit[i]), 4), *widths, *numbers])
        yield lines


def main(campaign, first, last, *names):
    """Append truths and sets that are not there yet."""
    path, sets = HERE / "hidden.csv", [(HEAP,), *((HEAP, name) for name in names)]
    if not path.exists():
        path.write_text(",".join(COLUMNS) + "\n")
    there = {(int(line["truth"]), line["tests"]) for line in csv.DictReader(path.open())}
    simulation.POINTS, simulation.FIRST = 2048, 2**14
    with threadpool_limits(1):
        tests = question_of(None, None, emulators_by_test([]), {}).tests
        for k in range(int(first), int(last) + 1):
            for lines in of_truth(k, tests, sets, Path(campaign)):
                new = [line for line in lines if (k, line[1]) not in there]
                with path.open("a", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerows(new)


if __name__ == "__main__":
    main(*sys.argv[1:])
