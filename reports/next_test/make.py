"""The emulators of the wide box, their validation and the map, from the runs that are here.

    python reports/next_test/make.py [CAMPAIGN]

CAMPAIGN is a folder of sweeps, one of each test: their lines box-* go to design/TEST, the lines fresh-* to
fresh/TEST. Then liggghts_models/TEST/emulators/coarse (of the heap: coarse-ring) is fitted to design/TEST,
and held against fresh/TEST and against its own runs, left out one by one (validation.csv). `calstudy advise`
says what each test, pair and response would tell where nothing is known (map/).
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from threadpoolctl import threadpool_limits

from calstudy.cli.main import main
from calstudy.emulator.emulator import read_emulator
from calstudy.emulator.validation import fresh_points, left_out
from calstudy.errors import NOT_DECIDED, NOT_HOLDING
from calstudy.models.find import DEFAULT_MODEL

HERE = Path(__file__).parent
MODELS = HERE.parent.parent / "liggghts_models"
BOX = (
    "DENS=2300:2700",
    "MU_PP=0.05:0.6",
    "MU_PW=0.05:0.6",
    "RF_PP=0.001:0.2",
    "RF_PW=0.001:0.2",
    "YM=4.2e8:1.25e9",
)


def emulator_of(test):
    """Folder of a test's emulator."""
    return MODELS / test / "emulators" / ("coarse-ring" if test == DEFAULT_MODEL else "coarse")


def take(campaign):
    """Copy the runs of a campaign, those to judge by apart."""
    for source in sorted(campaign.glob("*/runs.parquet")):
        runs = pq.read_table(source)
        labels = np.array(runs["label"].to_pylist())
        for folder, start in (("design", "box-"), ("fresh", "fresh-")):
            chosen = runs.filter(np.char.startswith(labels, start))
            if len(chosen):
                path = HERE / folder / source.parent.name / "runs.parquet"
                path.parent.mkdir(parents=True, exist_ok=True)
                pq.write_table(chosen, path, write_page_checksum=True)


def fit(test):
    """Fit to the runs of the Sobol' points."""
    words = ["emulator", "fit", str(HERE / "design" / test), "--model", test, "--out", str(emulator_of(test))]
    words += [] if test == DEFAULT_MODEL else ["--fidelity", "coarse"]
    code = main(words + [word for interval in BOX for word in ("--interval", interval)])
    if code not in (0, NOT_HOLDING, NOT_DECIDED):  # of some responses the runs tell little, which fit says
        sys.exit(code)


def validation(test):
    """A line for each response: bias, root mean square error and share inside 95 %, in units of the noise."""
    emulator = read_emulator(emulator_of(test))
    singles = left_out(emulator)
    fresh = HERE / "fresh" / test / "runs.parquet"
    points = pd.DataFrame(columns=["response"])
    if fresh.exists():
        points = fresh_points(emulator, pq.read_table(fresh).to_pandas())
    lines = []
    for response in emulator.responses:
        noise = float(response.process.noise_sd(np.full((1, emulator.box.dimension), 0.5))[0])
        line = {"test": test, "response": response.name, "off": len(response.off), "noise": noise}
        for name, table in (("left_out", singles), ("fresh", points)):
            of = table[table["response"] == response.name]
            error = (of["measured"] - of["predicted"]).to_numpy(float) if len(of) else np.array([np.nan])
            line |= {f"{name}_n": len(of), f"{name}_bias": error.mean() / noise}
            line |= {f"{name}_rmse": np.sqrt(np.mean(error**2)) / noise}
            line |= {f"{name}_inside": int(of["inside"].sum()) if len(of) else np.nan}
        # What the response changes by over the box, beside which its error is small or not.
        line["range"] = float(np.ptp(singles.loc[singles["response"] == response.name, "measured"])) / noise
        lines.append(line)
    return lines


def make(campaign=None):
    """All of it."""
    if campaign is not None:
        take(Path(campaign))
    tests = [path.name for path in sorted((HERE / "design").iterdir())]
    lines = []
    with threadpool_limits(1):
        for test in tests:
            fit(test)
            lines += validation(test)
    table = pd.DataFrame(lines)
    table.to_csv(HERE / "validation.csv", index=False, float_format="%.4g", lineterminator="\n")
    sys.exit(main(["advise", "--out", str(HERE / "map")]))


if __name__ == "__main__":
    make(*sys.argv[1:])
