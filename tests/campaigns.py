"""Campaigns on the closed form: rows, modes that are quick, and what is on disk when one is interrupted."""

from dataclasses import replace

from calstudy.calibration.modes import MODES
from calstudy.calibration.sampling import latin_hypercube
from calstudy.models.heap import PROPORTIONAL
from calstudy.study.directory.store import Store, read_table
from closed_form import (
    PAPER,
    study_settings,
)

ROWS = (1, 53)
QUICK_ROBUST = replace(
    MODES["robust"].knowing(PROPORTIONAL), design=lambda n, d, rng: latin_hypercube(n, d, rng)
)
SMALL_PAPER = replace(PAPER, second_optimisation=replace(PAPER.second_optimisation, budget=20))


def on_disk(directory, rows=ROWS):
    """Identities of all runs that are durable."""
    ids = set(read_table(directory, "evaluations")["run_id"])
    for row in rows:
        ids |= {evaluation.run_id for evaluation in Store(directory, study_settings()).journal(row)}
    return ids


def interrupt_after(calls, stop):
    """What an engine does on a call: it stops the campaign at that call, counted from 0."""
    return lambda number: stop.set() if number == calls else None
