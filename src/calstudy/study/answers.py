"""Answers to what calibrations ask: by a DEM run on disk, by one under way, or by a new one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

from calstudy.engines.interface import Engine
from calstudy.engines.queue import Job, Queue
from calstudy.records import Evaluation, Phase, Request, Run
from calstudy.study.directory.store import Store


@dataclass(frozen=True, slots=True)
class MaterialTest:
    """One DEM model that every parameter set runs through."""

    engine: Engine
    parameters: tuple[str, ...]
    """Those that it takes; what differs in others alone is the same DEM run."""


class Answers:
    """Answers requests by DEM runs, each of which is durable before it counts; equal ones are run once.

    Any thread may ask. ``reused`` is called for each request that needs no new run, ``ended`` with the
    evaluation of each new one.
    """

    def __init__(
        self,
        store: Store,
        queue: Queue,
        *,
        scratch: Path,
        keep_runs: bool,
        retry_failed: bool,
        several_models: bool,
        follow: Iterable[Request],
        known: Mapping[str, Run] | None,
        reused: Callable[[], None],
        ended: Callable[[Evaluation], None],
    ) -> None:
        """``follow`` are requests that are answered in place of ones that differ in their last digits.

        ``known`` are runs of other studies, by their ids.
        """
        self.store, self.queue = store, queue
        self.scratch, self.keep_runs, self.retry_failed = scratch, keep_runs, retry_failed
        self.several_models = several_models
        self.reused, self.ended = reused, ended
        self._guard = threading.Lock()
        self._known: dict[str, Future[Run]] = {}
        self._on_disk: dict[str, int] = {}
        """Runs that only the journal of a finished row has, by their ids: heaps of all rows are too large."""
        self._of_row: dict[int, set[str]] = {}
        self._stored: dict[int, dict[tuple[Phase, int, str], Evaluation]] = {}
        """By row."""
        self._asked: dict[tuple[int, Phase, int], list[Request]] = {}
        for run_id, run in (known or {}).items():
            self._known[run_id] = Future()
            self._known[run_id].set_result(run)
        for request in follow:
            self._asked.setdefault((request.row, request.phase, request.index), []).append(request)

    def take_up(self, rows: set[int], among: Iterable[int] | None = None) -> None:
        """Take what is on disk: the answers of the rows themselves, and all runs that they could share.

        ``among`` are the rows whose runs they could share; None: all rows.
        """
        finished = self.store.finished_rows()
        for row in self.store.journals() if among is None else among:
            for evaluation in self.store.journal(row, heaps=row not in finished):
                run, request = evaluation.run, evaluation.request
                self.queue.took(run)
                if row in rows:
                    self._asked.setdefault((row, request.phase, request.index), []).append(request)
                if self.retry_failed and run.broke:
                    continue
                if row in rows:
                    place = (request.phase, request.index, evaluation.run_id)
                    self._stored.setdefault(row, {})[place] = evaluation
                if row not in finished:
                    self._know(evaluation, row)
                elif not run.broke or evaluation.run_id not in self._on_disk:
                    self._on_disk[evaluation.run_id] = row

    def _know(self, evaluation: Evaluation, row: int) -> None:
        """Keep a run for whoever asks for it, until ``row`` is finished."""
        with self._guard:
            known = self._known.get(evaluation.run_id)
            if known is None or (known.done() and known.result().broke):
                known = self._known[evaluation.run_id] = Future()
                known.set_result(evaluation.run)
            self._of_row.setdefault(row, set()).add(evaluation.run_id)

    def forget(self, row: int) -> None:
        """Drop what a row that has its tables kept in memory; its journal has it."""
        with self._guard:
            self._stored.pop(row, None)
            for run_id in self._of_row.pop(row, ()):
                if self._known.pop(run_id, None) is not None:
                    self._on_disk[run_id] = row

    def ask(self, request: Request, test: MaterialTest, rank: int) -> Future[Evaluation]:
        """Future of a model's answer; a new run waits in the queue behind those of a lower rank."""
        engine, request = test.engine, self._as_asked_before(request)
        own = replace(request, parameters={name: request.parameters[name] for name in test.parameters})
        run_id = own.run_id(engine.model_hash, engine.identity)
        there = self._stored.get(request.row, {}).get((request.phase, request.index, run_id))
        answer: Future[Evaluation] = Future()
        if there is not None:
            self.reused()
            answer.set_result(there)
            return answer
        if run_id in self._on_disk and run_id not in self._known:
            for evaluation in self.store.journal(self._on_disk[run_id]):
                if not (self.retry_failed and evaluation.run.broke):
                    self._know(evaluation, request.row)
        with self._guard:
            self._of_row.setdefault(request.row, set()).add(run_id)
            run = self._known.get(run_id)
            is_first = run is None
            if run is None:
                token = self.store.lock.session.token
                job = Job(engine, own.parameters, own.seed, run_id, self.scratch, token, self.keep_runs)
                run = self._known[run_id] = self.queue.submit(job, rank=rank)
        if not is_first:
            self.reused()

        def settle(done: Future[Run]) -> None:
            try:
                model_hash = engine.model_hash if self.several_models else ""
                evaluation = Evaluation(request, run_id, done.result(), model_hash)
                self.store.record(evaluation)
                if is_first:
                    self.ended(evaluation)
                answer.set_result(evaluation)
            except BaseException as error:
                self.queue.refuse(error)
                answer.set_exception(error)

        run.add_done_callback(settle)
        return answer

    def _as_asked_before(self, request: Request) -> Request:
        """What was asked in this place before, should it differ in the last digits of the numerics alone.

        Those differ between processors and libraries. A DEM run amplifies them to another heap: a row that
        goes on elsewhere, or is run again there, would lose its runs and go its own way.
        """
        before = self._asked.get((request.row, request.phase, request.index), ())
        if request in before:
            return request
        return next((asked for asked in before if request.repeats(asked)), request)
