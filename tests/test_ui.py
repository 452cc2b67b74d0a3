"""The page in the browser: who is let in, and what it shows of a project."""

from __future__ import annotations

import base64
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from fake_liggghts import COMMAND

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install '.[ui]'")

FILE = """\
mode = "robust"
seed = 1
WRL = 0.0
budget = 4
confirm = 1

[[models]]
name = "angle_of_repose"
fidelity = "tiny"

[parameters]
DENS = 2500.0    # kg/m3
MU_PP = [0.1, 0.3]
MU_PW = 0.2
RF_PP = [0.001, 0.1]
RF_PW = 0.01
YM = 4.175e8

[targets]
angle_of_repose_deg = { value = 25.0, tolerance = 2.0 }
"""


class Served:
    """A server of a project, as its own process."""

    def __init__(self, directory: Path) -> None:
        words = [sys.executable, "-m", "calstudy", "ui", str(directory), "--no-browser", "--workers", "2"]
        environment = {**os.environ, "CALSTUDY_LIGGGHTS": COMMAND, "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment)
        assert self.process.stdout is not None
        self.process.stdout.readline()
        self.address = self.process.stdout.readline().strip()

    def end(self) -> None:
        """End the server, as Ctrl+C does."""
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=60)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    directory = tmp_path_factory.mktemp("project")
    (directory / "calibration.toml").write_text(FILE)
    (directory / "photographs").mkdir()
    (directory / "photographs" / "heap.png").write_bytes(b"secret")
    server = Served(directory)
    yield server
    server.end()


class Stay(urllib.request.HTTPRedirectHandler):
    """Follows no redirection."""

    def redirect_request(self, *_: object) -> None:
        return None


def status(address: str, cookie: str = "") -> tuple[int, str]:
    """Status of an answer, and the cookie that it sets."""
    request = urllib.request.Request(address, headers={"Cookie": cookie} if cookie else {})
    try:
        with urllib.request.build_opener(Stay).open(request, timeout=30) as answer:
            return answer.status, answer.headers.get("Set-Cookie", "").partition(";")[0]
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers.get("Set-Cookie", "").partition(";")[0]


def handshake(address: str, cookie: str, origin: str) -> int:
    """Status of the answer to a websocket's handshake."""
    place = urlsplit(address)
    with socket.create_connection((place.hostname, place.port), timeout=30) as connection:
        key = base64.b64encode(b"0123456789abcdef").decode()
        lines = [
            "GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1",
            f"Host: {place.netloc}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            f"Sec-WebSocket-Key: {key}",
            "Sec-WebSocket-Version: 13",
            f"Origin: {origin}",
            f"Cookie: {cookie}",
            "",
            "",
        ]
        connection.sendall("\r\n".join(lines).encode())
        return int(connection.recv(100).split()[1])


PLACES = (
    "/",
    "/photographs/heap.png",
    "/files/report.html",
    "/_nicegui_ws/socket.io/?EIO=4&transport=polling",
)


@pytest.mark.slow
def test_nothing_is_shown_without_the_token(served: Served) -> None:
    top = served.address.partition("/?")[0]
    given, cookie = status(served.address)
    assert (given, bool(cookie)) == (303, True)
    wrong = f"{cookie.partition('=')[0]}=nonsense"
    assert [status(f"{top}{place}")[0] for place in PLACES] == [403] * 4
    assert [status(f"{top}{place}", wrong)[0] for place in PLACES] == [403] * 4
    assert status(f"{top}/?token=nonsense", cookie) == (403, "")
    assert status(f"{top}/photographs/heap.png", cookie)[0] == 200
    assert status(f"{top}/photographs/..%2fcalibration.toml", cookie)[0] == 404


@pytest.mark.slow
def test_a_websocket_needs_the_token_and_a_page_of_this_server(served: Served) -> None:
    top = served.address.partition("/?")[0]
    cookie = status(served.address)[1]
    assert handshake(top, cookie, top) == 101
    assert handshake(top, "", top) == 403
    assert handshake(top, cookie, "http://127.0.0.1:1") == 403
    assert handshake(top, cookie, "http://example.org") == 403


def test_the_token_is_another_one_each_time_and_the_port_is_this_machines(served: Served) -> None:
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=[\w-]{22}", served.address)
