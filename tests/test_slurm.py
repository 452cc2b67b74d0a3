"""The example of the page on clusters on a real SLURM of one node, whose jobs are cancelled and requeued."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calstudy.cli import main as cli
from calstudy.errors import MISSED
from closed_form import wait_for
from fake_liggghts import COMMAND
from same_tables import assert_same, tables

ROOT = Path(__file__).parent.parent
pytest.importorskip("dask_jobqueue")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.geteuid() != 0 or not shutil.which("slurmctld") or not shutil.which("munged"),
        reason="scripts/slurm needs root, slurmctld, slurmd, slurm-client and munge",
    ),
]
PATIENCE = 240.0
STUDY = "plan run --rows 1 --fidelity tiny --budget 8"


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """A SLURM of this machine alone; what it answers to a command."""
    folder = tmp_path / "slurm"
    subprocess.run([ROOT / "scripts" / "slurm", "start", folder], check=True, timeout=120)
    monkeypatch.setenv("SLURM_CONF", str(folder / "slurm.conf"))
    try:
        yield lambda *words: subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()
    finally:
        subprocess.run(["scancel", "--user", "root"], check=False)
        time.sleep(2)
        subprocess.run([ROOT / "scripts" / "slurm", "stop", folder], check=True)


def example(study: Path) -> str:
    """The page's example with smaller numbers and another study; each replacement must find its place."""
    page = (ROOT / "docs" / "how-to" / "clusters.md").read_text()
    (code,) = re.findall(r"```python\n(import subprocess\nfrom dask_jobqueue.*?)```", page, re.DOTALL)
    words = [sys.executable, "-m", "calstudy", *STUDY.split(), "--study", str(study)]
    for was, now in (
        ("cores=4", "cores=1"),
        ('"4GB"', '"1GB"'),
        ("04:00:00", "00:02:00"),
        ('"230m"', '"70s"'),
        ('"5m"', '"5s"'),
        ("maximum_jobs=16", "maximum_jobs=2"),
        ('["calstudy", "plan", "run", "--fidelity", "soft", "--study", "studies/soft"]', repr(words)),
        ('"64"', '"2"'),
        ('"/tmp/calstudy"', repr(str(study.with_name("scratch")))),
    ):
        assert was in code, was
        code = code.replace(was, now)
    return code


def test_the_example_of_the_page_survives_what_happens_to_jobs(slurm, tmp_path, monkeypatch):
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.setenv("FAKE_LIGGGHTS_SECONDS", "4")
    study = tmp_path / "study"
    (tmp_path / "example.py").write_text(example(study))

    def running():
        return slurm("squeue", "--noheader", "--states=RUNNING", "--format=%A")

    def finished():
        path = study / "journal" / "row-01.jsonl"
        return path.read_bytes().count(b"\n") if path.exists() else 0

    (node,) = slurm("sinfo", "--noheader", "--format=%n")
    with (
        (tmp_path / "log").open("w") as log,
        subprocess.Popen(
            [sys.executable, "example.py"], cwd=tmp_path, stdout=log, stderr=log, start_new_session=True
        ) as process,
    ):
        try:
            wait_for(lambda: finished() >= 1, PATIENCE)
            slurm("scancel", running()[0])
            wait_for(lambda: finished() >= 3 and running(), PATIENCE)
            slurm("scontrol", "requeue", running()[0])
            wait_for(lambda: finished() >= 5 and running(), PATIENCE)
            slurm("scontrol", "update", f"nodename={node}", "state=drain", "reason=test")
            slurm("scancel", *running())
            time.sleep(5)
            slurm("scontrol", "update", f"nodename={node}", "state=resume")
            assert process.wait(PATIENCE) in (0, MISSED), (tmp_path / "log").read_text()
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    monkeypatch.delenv("FAKE_LIGGGHTS_SECONDS")
    undisturbed = tmp_path / "undisturbed"
    assert cli.main([*STUDY.split(), "--study", str(undisturbed)]) in (0, MISSED)
    assert_same(tables(study), tables(undisturbed))
