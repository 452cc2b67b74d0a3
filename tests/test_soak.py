"""A small part of the soak (``scripts/soak``): the harness itself, and that it finds what it looks for."""

import pytest

from calstudy.disk import files
from soak import faults, fuzz, kills, memory

pytestmark = pytest.mark.slow


def test_a_fault_at_any_operation_on_the_disk_loses_and_repeats_no_run(tmp_path):
    found = faults.check(tmp_path, step=29)
    assert found["faults"] >= 10 and found["dies, died"] == found["faults"] / 2


def test_a_run_that_counts_before_it_is_on_disk_is_found(tmp_path, monkeypatch):
    """Negative control: without the journal, a machine that dies repeats what had been told as done."""
    monkeypatch.setattr(files.Journal, "append", lambda self, line: None)
    with pytest.raises(AssertionError):
        faults.check(tmp_path, step=29, hows=(faults.DIES,))


def test_corrupted_files_are_read_or_refused_in_one_line(tmp_path):
    found = fuzz.check(tmp_path, cases=400)
    assert found["cases"] >= 300 and found["read"] > 20 and found["refused in one line"] > 100


def test_commands_that_are_killed_go_on_to_the_same_tables(tmp_path):
    found = kills.check(tmp_path, len(kills.COMMANDS), kills.LEAST)
    assert {found[name] for name in kills.COMMANDS} == {1}, "each long command is killed"


def test_allocations_that_fail_lose_and_repeat_no_run(tmp_path):
    found = memory.check(tmp_path, cases=4, seed=1)
    assert sum(found.get(end, 0) for end in ("an error", "died", "hung, and ended by SIGTERM")) >= 1
