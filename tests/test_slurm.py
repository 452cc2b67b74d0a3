"""The examples of the page on clusters on a real SLURM of one node, whose jobs are cancelled and requeued."""

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

from beads_in_a_box import MODEL, SCRIPT
from calstudy.cli import main as cli
from calstudy.errors import MISSED
from calstudy.study.directory.journal import read_journal
from calstudy.study.directory.session import read_sessions
from calstudy.study.directory.store import finished_rows
from closed_form import wait_for
from fake_liggghts import COMMAND
from same_tables import assert_same, tables

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "how-to" / "clusters.md"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.geteuid() != 0 or not shutil.which("slurmctld") or not shutil.which("munged"),
        reason="scripts/slurm needs root, slurmctld, slurmd, slurm-client and munge",
    ),
]
PATIENCE = 240.0
STUDY = "plan run --rows 1 --fidelity tiny --budget 8"
ARRAY = "plan run --rows 1,5,8 --fidelity tiny --budget 4"


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
    (code,) = re.findall(
        r"```python\n(import subprocess\nfrom dask_jobqueue.*?)```", PAGE.read_text(), re.DOTALL
    )
    words = [sys.executable, "-m", "calstudy", *STUDY.split(), "--study", str(study)]
    return replaced(
        code,
        ("cores=4", "cores=1"),
        ('"4GB"', '"1GB"'),
        ("04:00:00", "00:02:00"),
        ('"230m"', '"70s"'),
        ('"5m"', '"5s"'),
        ("maximum_jobs=16", "maximum_jobs=2"),
        ('["calstudy", "plan", "run", "--fidelity", "soft", "--study", "studies/soft"]', repr(words)),
        ('"64"', '"2"'),
        ('"/tmp/calstudy"', repr(str(study.with_name("scratch")))),
    )


def replaced(code, *replacements):
    """Code of the page with other words; each must be there."""
    for was, now in replacements:
        assert was in code, was
        code = code.replace(was, now)
    return code


def array_script(study: Path) -> str:
    """The page's job array with smaller numbers and another study."""
    (code,) = re.findall(r"```bash\n(#!/bin/bash\n#SBATCH --array.*?)```", PAGE.read_text(), re.DOTALL)
    return replaced(
        code,
        ("--array=1-8", "--array=1-3"),
        ("ID/8", "ID/3"),
        ("--ntasks=4", "--ntasks=1"),
        ("04:00:00", "00:01:00"),
        ("calstudy plan run --fidelity soft", f"{sys.executable} -m calstudy {ARRAY}"),
        ("studies/soft", str(study)),
        ("/tmp/calstudy", str(study.with_name("scratch"))),
        (" --time-limit 3h50m", ""),  # so that the walltime is what ends them
    )


def test_a_job_array_survives_what_happens_to_its_elements(slurm, tmp_path, monkeypatch):
    """One is killed, one requeued, and the others reach their walltime; then the same script goes on."""
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.setenv("FAKE_LIGGGHTS_SECONDS", "4")
    study = tmp_path / "study"
    (tmp_path / "array.sh").write_text(array_script(study))

    def lines(row):
        path = study / "journal" / f"row-{row:02d}.jsonl"
        return path.read_bytes().count(b"\n") if path.exists() else 0

    def submit():
        (*_, job) = slurm("sbatch", f"--chdir={tmp_path}", str(tmp_path / "array.sh"))
        return job

    def over(job):
        return not slurm("squeue", "--noheader", f"--jobs={job}") or None

    job = submit()
    wait_for(lambda: all(lines(row) >= 2 for row in (1, 5, 8)), PATIENCE)
    slurm("scancel", "--signal=KILL", "--full", f"{job}_1")
    slurm("scontrol", "requeue", f"{job}_2")
    wait_for(lambda: over(job), PATIENCE)
    states = [one.state for one in read_sessions(study)]
    assert "interrupted" in states, "SIGTERM at the walltime was heard"
    assert len(finished_rows(study)) < 3
    monkeypatch.setenv("FAKE_LIGGGHTS_SECONDS", "0")
    job = submit()
    wait_for(lambda: over(job), PATIENCE)
    logs = "\n".join(path.read_text() for path in tmp_path.glob("slurm-*.out"))
    assert finished_rows(study) == {1, 5, 8}, logs
    for row in (1, 5, 8):
        runs = [e.run_id for e in read_journal(study / "journal" / f"row-{row:02d}.jsonl").evaluations]
        assert len(runs) == len(set(runs)), "a DEM run that was on disk has been run again"
    undisturbed = tmp_path / "undisturbed"
    assert cli.main([*ARRAY.split(), "--study", str(undisturbed)]) in (0, MISSED)
    assert_same(tables(study), tables(undisturbed))


@pytest.mark.liggghts
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="LIGGGHTS is there without mpirun")
def test_ranks_run_on_what_the_scheduler_was_asked_for(slurm, tmp_path):
    assert "`--ranks 2` and four DEM runs at once need `--ntasks=8`" in PAGE.read_text()
    (tmp_path / "box").mkdir()
    (tmp_path / "box" / "in.box").write_text(SCRIPT)
    (tmp_path / "box" / "model.toml").write_text(MODEL.replace("ranks = 2\n", ""))
    words = f"{sys.executable} -m calstudy simulate --model box --set MU=0.3 --ranks 2 --out run"
    slurm("sbatch", "--wait", "--ntasks=2", "--nodes=1", f"--chdir={tmp_path}", f"--wrap={words}")
    assert "2 by 1 by 1 MPI processor grid" in (tmp_path / "run" / "log.liggghts").read_text()


def test_a_worker_of_dask_has_processors_for_the_ranks_of_its_runs():
    jobs = pytest.importorskip("dask_jobqueue")
    assert "`cores=4, job_cpu=8`" in PAGE.read_text()
    with jobs.SLURMCluster(cores=4, job_cpu=8, processes=1, memory="4GB") as cluster:
        script = cluster.job_script()
    assert "--cpus-per-task=8" in script and "--nthreads 4" in script


def test_the_example_of_the_page_survives_what_happens_to_jobs(slurm, tmp_path, monkeypatch):
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.setenv("FAKE_LIGGGHTS_SECONDS", "4")
    pytest.importorskip("dask_jobqueue")
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
