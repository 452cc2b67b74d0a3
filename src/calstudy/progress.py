"""Shows the progress of long work: a live bar on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn
from rich.table import Column

from calstudy.session import Activity

if TYPE_CHECKING:
    from calstudy.campaign import Campaign

PLAIN_INTERVAL = 30.0
LIVE_INTERVAL = 0.5


@dataclass(frozen=True, slots=True)
class Look:
    """What is shown of long work at one moment."""

    share: float
    """Of the work, done."""
    words: str
    news: str = ""
    """What was finished last; shown once."""


@contextlib.contextmanager
def shown(look: Callable[[], Look], console: Console) -> Iterator[None]:
    """Show the progress that ``look`` tells on ``console`` while the block runs."""
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
    """What is shown of a campaign."""
    return Look(_share(campaign), _words(campaign), campaign.progress.last_row)


def duration(seconds: float) -> str:
    """Time in words, to two units."""
    seconds = round(seconds)
    if seconds < 60:
        return f"{seconds} s"
    minutes, seconds = divmod(seconds, 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min"


def activity_in_words(did: Activity) -> str:
    """What a session has done so far, what it does, and how long it will take."""
    asked = did.runs_done + did.runs_reused
    failures = f", {did.runs_failed} failed" if did.runs_failed else ""
    used = "" if math.isnan(did.utilisation) else f" · {did.utilisation:.0%} used"
    nobody = did.slots == 0 and did.runs_waiting > 0
    left = "waiting for the cluster's workers" if nobody else f"about {duration(did.seconds_left)} left"
    return (
        f"DEM runs {asked} of about {asked + did.runs_left}{failures} · {did.runs_running} running{used} · "
        f"{duration(did.elapsed)} · {left}"
    )


def _words(campaign: Campaign) -> str:
    p = campaign.progress
    failures = f" ({p.rows_failed} failed)" if p.rows_failed else ""
    return f"rows {p.rows_done}/{p.rows}{failures} · {activity_in_words(campaign.activity())}"


def _share(campaign: Campaign) -> float:
    """Share of the work done; runs under way count by the time that they have taken on average."""
    p, did = campaign.progress, campaign.activity()
    mean = did.dem_seconds / p.runs_done if p.runs_done else campaign.expected_seconds
    busy = min(did.elapsed * did.slots, did.dem_seconds + did.runs_running * mean)
    done = max(p.runs_done, min(busy / max(mean, 1e-9), p.runs_done + did.runs_running)) + p.runs_reused
    return min(done / max(p.expected_runs, 1.0), 0.99)


def _live(look: Callable[[], Look], console: Console, ended: threading.Event) -> None:
    columns = (
        SpinnerColumn(),
        BarColumn(bar_width=16),
        TextColumn("{task.percentage:3.0f} %"),
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=False)),
    )
    with Progress(*columns, console=console, transient=True, refresh_per_second=1 / LIVE_INTERVAL) as bar:
        task = bar.add_task("starting", total=1.0)
        news = ""
        over = False
        while not over:
            over = ended.wait(LIVE_INTERVAL)
            seen = look()
            if seen.news != news:
                news = seen.news
                bar.console.print(news, highlight=False)
            bar.update(task, completed=seen.share, description=seen.words)


def _plain(look: Callable[[], Look], console: Console, ended: threading.Event) -> None:
    said = -math.inf
    news = ""
    over = False
    while not over:
        over = ended.wait(LIVE_INTERVAL)
        seen = look()
        if seen.news != news:
            news = seen.news
            console.print(news, highlight=False, soft_wrap=True)
        if not over and time.monotonic() - said >= PLAIN_INTERVAL:
            said = time.monotonic()
            console.print(seen.words, highlight=False, soft_wrap=True)
