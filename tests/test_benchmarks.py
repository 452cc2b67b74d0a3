"""Every benchmark, and every script that made a picture or a table, still runs, as small as it can be."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from calstudy.calibration.modes import MODES
from calstudy.calibration.task import tasks_of
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.errors import MISSED
from calstudy.models.heap import ANGLE_OF_REPOSE, PROPORTIONAL
from calstudy.plan_file import load_plan
from closed_form import run_study
from fake_liggghts import COMMAND

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
BENCHMARKS = {path.name for path in (ROOT / "benchmarks").glob("*.py")}
ELSEWHERE = """
import runpy, sys
from pathlib import Path
script = Path(sys.argv[1])
sys.path.insert(0, str(script.parent))
import style
style.IMAGES = Path(sys.argv[2])
runpy.run_path(str(script), run_name="__main__")
"""
IMPORTED = """
import runpy, sys
from pathlib import Path
sys.path.insert(0, str(Path(sys.argv[1]).parent))
runpy.run_path(sys.argv[1], run_name="imported")
"""
SMALL = {
    "calibration_cost.py": ["--count 1 --out {tmp}/cost.csv"],
    "campaign.py": ["-- --rows 1 --fidelity tiny --budget 4 --workers 2 --study {tmp}/study"],
    "confirmed.py": ["design reports/soft/paper --out {tmp}/design.csv", "table reports/soft/paper"],
    "coverage.py": ["reports/emulated/soft-ring"],
    "dem.py": [
        "pairs --fidelity tiny --points 2 --out {tmp}/pairs.parquet",
        "replay --fidelity tiny --points 1",
        "show {tmp}/pairs.parquet",
    ],
    "earlier_study.py": ["--seeds 1 --materials mirrored --out {tmp}/earlier.csv"],
    "first_optimisation.py": ["design {tmp}", "table {tmp}", "replicates {tmp}/replicated"],
    "guarantee.py": ["--count 1 --out {tmp}/guarantee.csv"],
    "numerics.py": ["--seeds 2 --rows 1"],
    "posterior.py": ["ranks --cases 2 --out {tmp}/ranks.csv", "table {tmp}/ranks.csv"],
    "photographs.py": ["--each 1 --only nothing,pitch"],
    "reach.py": ["--rows 1 --seeds 1"],
    "real_rows.py": ["design {tmp}", "table reports/coarse-rows"],
    "fewer_runs.py": ["draw 0 1 version3 10_6_0.3 --out {tmp}/fewer.csv"],
    "two_fidelities.py": ["--seeds 1 --weights 0.5 --out {tmp}/two.csv"],
    "steep.py": ["--designs 0"],
    "scale.py": [
        "rows --rows 2",
        "sweep --runs 20",
        "journal --threads 2 --runs 20",
        "commands --tries 1",
        "slots --slots 4 --runs 40 --rows 4",
        "reopen --lines 200",
    ],
}
"""Of each benchmark, the smallest arguments of each kind of work; {tmp} is a directory of the test."""
PAGES = ("findings", "modes", "solid")
"""Pages whose pictures are drawn from shipped data; those of material_tests need the files of a run."""
ON_LIGGGHTS = {"dem.py"}


def run(*words: str, **options) -> str:
    """Standard output of a Python program that ends well."""
    ended = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True, **options)
    assert ended.returncode in (0, MISSED), ended.stderr
    return ended.stdout


def test_every_benchmark_is_run_here():
    assert set(SMALL) == BENCHMARKS


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.liggghts] * (n in ON_LIGGGHTS)) for n in sorted(SMALL)]
)
def test_a_benchmark_runs(name, tmp_path, monkeypatch):
    if name not in ON_LIGGGHTS:
        monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    if name in ("first_optimisation.py", "real_rows.py"):
        for mode in ("paper", "robust"):
            run_study(tmp_path / mode, (1, 2))
    if name == "first_optimisation.py":
        options = ["--engine", "emulator", "--fidelity", "coarse", "--rows", "1,2", "--replicates", "1"]
        run("-m", "calstudy", "plan", "run", *options, "--study", str(tmp_path / "replicated"))
    for arguments in SMALL[name]:
        said = run(f"benchmarks/{name}", *(word.format(tmp=tmp_path) for word in arguments.split()))
        assert said.strip()


def test_the_comparison_with_peers_runs_in_its_reduced_form(tmp_path):
    words = ["--quick", "--only", "robust,random", "--workers", "1", "--out", str(tmp_path)]
    assert "4 of 4: random on failing" in run("benchmarks/peers/compare.py", *words)
    lines = pd.read_parquet(tmp_path / "lines.parquet")
    assert set(lines["method"]) == {"robust", "random"}
    assert lines["excess"].notna().all()
    assert "## failing, 16 runs" in (tmp_path / "tables.md").read_text()
    assert (tmp_path / "curves.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", PAGES)
def test_the_pictures_of_a_page_are_drawn(page, tmp_path):
    run("-c", ELSEWHERE, f"docs/pictures/{page}.py", str(tmp_path))
    drawn = {path.name for path in tmp_path.iterdir()}
    assert drawn == {path.name for path in (ROOT / "docs" / "images").glob(f"{page}-*.png")}


def test_the_photographs_of_the_pages_are_rendered(tmp_path):
    run("-c", ELSEWHERE, "docs/pictures/photographs.py", str(tmp_path))
    drawn = {path.name for path in tmp_path.iterdir()}
    assert drawn == {path.name for path in (ROOT / "docs" / "images").glob("photograph?.jpg")}


def test_the_shipped_designs_are_what_their_script_writes(tmp_path):
    here = ROOT / "reports" / "angle_of_repose"
    copy = tmp_path / "designs.py"
    copy.write_bytes((here / "designs.py").read_bytes())
    run(str(copy))
    written = {path.parent.name: pd.read_csv(path) for path in tmp_path.glob("*/design.csv")}
    assert written
    for name, design in written.items():
        pd.testing.assert_frame_equal(design, pd.read_csv(here / name / "design.csv"))


def test_the_shipped_design_of_the_optima_is_what_its_script_writes(tmp_path):
    run("benchmarks/confirmed.py", "design", "reports/soft/paper", "--out", str(tmp_path / "design.csv"))
    shipped = ROOT / "reports" / "soft" / "confirmed" / "design.csv"
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "design.csv"), pd.read_csv(shipped))


def test_a_target_that_no_mean_reaches_is_hardly_ever_said_to_be_within():
    """Rows that hold MU_PP on the soft emulator: their least mean is some 2 deg above the target."""
    found = runpy.run_path(str(ROOT / "benchmarks" / "reach.py"), run_name="imported")
    plan, emulator = load_plan(), read_emulator(shipped_emulator("angle_of_repose", "soft", "ring"))
    mode = MODES["robust"].knowing(PROPORTIONAL)
    lines = []
    for seed in (1, 2):
        for row in (4, 15, 33):
            task = tasks_of(plan, found["TARGET"], mode, seed)[row]
            true = found["true_means"](emulator, task)
            lines += found["ends_of"](emulator, task, seed, true)
    lower = pd.DataFrame(lines).query(f"response == '{ANGLE_OF_REPOSE}' and end == 'lower'")
    assert (lower["true"] > 23.5).all()
    # Within reach is said from a standard deviation inside on; OUT OF REACH from one outside on.
    assert not (lower["said"] + lower["sd"] <= 22).any()
    assert (lower["said"] - lower["sd"] > 22).mean() > 0.5
    assert (lower["before"] <= 22).mean() > 0.3


def test_the_rows_that_reach_the_targets_are_told():
    assert "A target is outside for 36 of 72 rows" in run("reports/angle_of_repose/gate.py")


@pytest.mark.parametrize(
    "script",
    [
        "reports/emulated/table5_by_chance.py",
        "reports/angle_of_repose/rules.py",
        "reports/angle_of_repose/summarise.py",
    ],
)
def test_a_script_that_takes_long_finds_what_it_imports(script):
    run("-c", IMPORTED, script)
