"""What goes to the terminal, and what happens when nobody is there any more."""

import os
import subprocess
import sys

from calstudy.progress import activity_in_words
from calstudy.session import Activity

TALK = """
from calstudy.terminal import messages_console
console = messages_console()
for _ in range(2000):
    console.print("x" * 100)
print("result")
"""


def test_messages_that_nobody_reads_end_neither_the_work_nor_its_results():
    """As in ``calstudy ... 2>&1 | tee log``, where Ctrl-C ends tee, too."""
    read, write = os.pipe()
    process = subprocess.Popen([sys.executable, "-c", TALK], stdout=subprocess.PIPE, stderr=write, text=True)
    os.close(write)
    os.close(read)
    out, _ = process.communicate(timeout=120)
    assert (process.returncode, out) == (0, "result\n")


def test_without_a_worker_no_time_left_is_made_up():
    words = activity_in_words(Activity(slots=0, runs_waiting=3, runs_left=3, seconds_left=60.0))
    assert words.endswith("waiting for the cluster's workers")
    assert activity_in_words(Activity(slots=1, runs_left=3, seconds_left=60.0)).endswith(
        "about 1 min 00 s left"
    )
