"""Shows progress: a live bar on a terminal, a plain line from time to time elsewhere."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from rich.console import Console, ConsoleOptions, RenderResult
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.table import Column
from rich.text import Text

from calstudy.study.directory.session import SEPARATOR, Look, _parts

if TYPE_CHECKING:
    from calstudy.study.campaign import Campaign


PLAIN_INTERVAL = 30.0
LIVE_INTERVAL = 0.5


@contextlib.contextmanager
def shown(look: Callable[[], Look], console: Console) -> Iterator[None]:
    """Show on ``console`` the progress that ``look`` returns while the block runs."""
    ended = threading.Event()
    show = _live if console.is_terminal else _plain
    display = threading.Thread(target=show, args=(look, console, ended), daemon=True)
    display.start()
    try:
        yield
    finally:
        ended.set()
        display.join()


def look_at(campaign: Campaign) -> Look:
    """Progress of a campaign."""
    return Look(_share(campaign), _words(campaign), tuple(campaign.progress.rows_told))


def watching(console: Console) -> Callable[[Campaign], contextlib.AbstractContextManager[None]]:
    """Shows a campaign on ``console`` while it runs."""
    return lambda campaign: shown(partial(look_at, campaign), console)


def fitting(parts: Sequence[str], width: int) -> str:
    """As many parts as fit into a width. The last but one is dropped first, the first one never."""
    kept = list(parts)
    while len(kept) > 1 and len(SEPARATOR.join(kept)) > width:
        del kept[-2 if len(kept) > 2 else -1]
    return SEPARATOR.join(kept)


def _words(campaign: Campaign) -> list[str]:
    """What the campaign has done so far, in words."""
    p = campaign.progress
    failures = f" ({p.rows_failed} failed)" if p.rows_failed else ""
    return [f"rows {p.rows_done}/{p.rows}{failures}", *_parts(campaign.activity())]


def _share(campaign: Campaign) -> float:
    """Share of the work done. Runs under way count by the average time that they have taken so far."""
    p, did = campaign.progress, campaign.activity()
    mean = did.dem_seconds / p.runs_done if p.runs_done else campaign.expected_seconds
    busy = min(did.elapsed * did.slots, did.dem_seconds + did.runs_running * mean)
    done = max(p.runs_done, min(busy / max(mean, 1e-9), p.runs_done + did.runs_running)) + p.runs_reused
    return min(done / max(p.expected_runs, 1.0), 0.99)


@dataclass(frozen=True, slots=True)
class _Words:
    """Parts of a line that never wraps."""

    parts: Sequence[str]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield Text(fitting(self.parts, options.max_width), no_wrap=True, overflow="ellipsis")


class _WordsColumn(ProgressColumn):
    def render(self, task: Task) -> _Words:
        return _Words(task.fields["words"])


def _live(look: Callable[[], Look], console: Console, ended: threading.Event) -> None:
    columns = (
        SpinnerColumn(),
        BarColumn(bar_width=16),
        TextColumn("{task.percentage:3.0f} %"),
        _WordsColumn(table_column=Column(ratio=1)),
    )
    with Progress(
        *columns, console=console, transient=True, expand=True, refresh_per_second=1 / LIVE_INTERVAL
    ) as bar:
        task = bar.add_task("", total=1.0, words=["starting"])
        told = 0
        over = False
        while not over:
            over = ended.wait(LIVE_INTERVAL)
            seen = look()
            told = _tell(seen, told, bar.console)
            bar.update(task, completed=seen.share, words=seen.words)


def _plain(look: Callable[[], Look], console: Console, ended: threading.Event) -> None:
    said = -math.inf
    told = 0
    over = False
    while not over:
        over = ended.wait(LIVE_INTERVAL)
        seen = look()
        told = _tell(seen, told, console)
        if not over and time.monotonic() - said >= PLAIN_INTERVAL:
            said = time.monotonic()
            console.print(SEPARATOR.join(seen.words), highlight=False, soft_wrap=True)


def _tell(seen: Look, told: int, console: Console) -> int:
    """Print the news after those already told; returns how many have been told."""
    for line in seen.news[told:]:
        console.print(line, highlight=False, soft_wrap=True)
    return len(seen.news)
