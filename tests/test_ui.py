"""The page in the browser: who is let in, and what it shows of a project."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from calstudy.study.run.project import Project
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

    def __init__(self, directory: Path, **variables: str) -> None:
        words = [sys.executable, "-m", "calstudy", "ui", str(directory), "--no-browser", "--workers", "2"]
        environment = {**os.environ, "CALSTUDY_LIGGGHTS": COMMAND, "OMP_NUM_THREADS": "1"} | variables
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


def project(directory: Path, text: str = FILE) -> Project:
    (directory / "calibration.toml").write_text(text)
    return Project(directory / "calibration.toml", directory / "studies" / "calibration")


FIELDS = (
    ("parameters", "MU_PP", 1),
    ("parameters", "DENS"),
    ("targets", "angle_of_repose_deg", "sd"),
    ("seed",),
)


def test_all_mistakes_are_told_at_once_each_by_its_field(tmp_path: Path) -> None:
    of = project(tmp_path)
    assert of.mistakes(FIELDS) == {}
    for keys, value in (
        (("seed",), '"x"'),
        (("parameters", "MU_PP"), '[0.1, "0,5"]'),
        (("parameters", "DENS"), "2.5"),
    ):
        of.set(keys, value)
    found = of.mistakes(FIELDS)
    assert set(found) == {("seed",), ("parameters", "MU_PP", 1), ("parameters", "DENS")}
    assert "2500" in found["parameters", "DENS"]
    assert str(tmp_path) not in "".join(found.values())


def test_a_mistake_of_no_field_is_told_too(tmp_path: Path) -> None:
    assert "is not TOML" in project(tmp_path, "mode = [").mistakes(FIELDS)[()]
    assert "no_such" in project(tmp_path, f"no_such = 1\n{FILE}").mistakes(FIELDS)[()]


# ---- in a browser ----------------------------------------------------------------------------------

PATIENCE = 120_000
"""ms; a browser and a calibration share the machine with other tests."""
PHOTOGRAPH = Path(__file__).parent.parent / "docs" / "images" / "photograph1.jpg"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("no Chromium is installed; scripts/test installs it where it may")
    with playwright.sync_playwright() as running:
        launched = running.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield launched
        launched.close()


def opened(browser: Any, address: str, width: int) -> Any:
    """A window of its own on the page."""
    page = browser.new_context(viewport={"width": width, "height": 900}).new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(address)
    return page


def wait_for(happened: Callable[[], bool]) -> None:
    """Wait until something has happened outside the browser."""
    end = time.monotonic() + PATIENCE / 1000
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.1)


FOCUSED = """(() => {
    const e = document.activeElement;
    const text = (e.innerText || "") + (e.ariaLabel || "") + (e.labels ? e.labels[0]?.innerText || "" : "");
    return text.length < 80 ? text : "";
})()"""
"""What has the focus, by its text or name; empty for what holds the whole page."""


def tab_to(page: Any, text: str, backwards: bool = False) -> None:
    """Move the focus by keyboard to what has a text or name."""
    for _ in range(80):
        page.keyboard.press("Shift+Tab" if backwards else "Tab")
        if text in page.evaluate(FOCUSED):
            return
    raise AssertionError(f"{text} cannot be reached by keyboard")


def step_by_keys(page: Any, there: str) -> None:
    """Go to another step by arrow keys."""
    for _ in range(80):
        page.keyboard.press("Shift+Tab")
        if page.evaluate("document.activeElement.getAttribute('role')") == "tab":
            break
    for key in ["ArrowRight"] * 6 + ["ArrowLeft"] * 6:
        if there in page.evaluate(FOCUSED):
            break
        page.keyboard.press(key)
        page.wait_for_timeout(100)
    page.keyboard.press("Enter")


@pytest.mark.slow
def test_a_calibration_by_keyboard_alone_outlives_its_browsers(browser: Any, tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(FILE)
    server = Served(tmp_path, FAKE_LIGGGHTS_UNTIL=str(tmp_path / "go"))
    top = server.address.partition("/?")[0]
    loaded: list[str] = []
    try:
        page = opened(browser, server.address, 400)
        page.on("request", lambda request: loaded.append(request.url))
        page.reload()
        page.get_by_text("Parameters", exact=True).wait_for()
        step_by_keys(page, "4 Run")
        tab_to(page, "Calibrate")
        page.keyboard.press("Enter")
        page.get_by_text(re.compile("^Running: process")).first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 400
        other = opened(browser, server.address, 1300)
        other.get_by_text(re.compile("^Running: process")).first.wait_for()
        assert other.get_by_role("button", name="Go on").is_disabled()
        for window in (page, other):
            window.context.close()
        (tmp_path / "go").write_text("")

        page = opened(browser, server.address, 1300)
        page.on("request", lambda request: loaded.append(request.url))
        page.get_by_text("Finished.", exact=True).first.wait_for()
        step_by_keys(page, "5 Result")
        page.get_by_text("Turn it by hand").wait_for()
        tab_to(page, "MU_PP")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.closest('[role=slider]').ariaLabel") == "MU_PP"
        page.keyboard.press("Control+ArrowRight")
        page.get_by_text(re.compile("^held at")).wait_for()
        step_by_keys(page, "6 Take away")
        page.get_by_text(re.compile("^variable MU_PP equal|variable MU_PP equal")).wait_for()
        page.context.close()
        assert [url for url in loaded if not url.startswith((top, "data:", top.replace("http", "ws")))] == []
        card = json.loads((tmp_path / "studies" / "calibration" / "report" / "material.json").read_text())
        assert card["parameters"]["MU_PP"]["optimum"] >= 0.1
    finally:
        server.end()


@pytest.mark.slow
def test_each_mistake_stands_beside_its_field_until_it_is_mended(browser: Any, served: Served) -> None:
    page = opened(browser, served.address, 400)
    page.get_by_role("tab", name=re.compile("Material")).click()
    rows = {name: page.locator(".row-of", has_text=name) for name in ("MU_PP", "DENS")}
    for name, label, text in (("MU_PP", "to", "0,5"), ("DENS", "value", "2.5")):
        rows[name].get_by_label(label, exact=True).fill(text)
        page.keyboard.press("Tab")
    rows["DENS"].get_by_text(re.compile("it looks like g/cm3: write 2500")).wait_for()
    rows["MU_PP"].get_by_text(re.compile("'0,5'; give a number")).wait_for()
    for name, label, text in (("MU_PP", "to", "0.5"), ("DENS", "value", "2500")):
        rows[name].get_by_label(label, exact=True).fill(text)
        page.keyboard.press("Tab")
    page.get_by_text(re.compile("give a number|it looks like")).first.wait_for(state="detached")
    page.context.close()


@pytest.mark.slow
def test_the_angle_follows_an_outline_that_is_dragged_and_is_kept(browser: Any, tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(FILE)
    server = Served(tmp_path)
    try:
        page = opened(browser, server.address, 1300)
        page.get_by_role("tab", name=re.compile("Photo")).click()
        page.locator("input[type=file]").set_input_files(PHOTOGRAPH)
        angle = page.locator(".numbers .verdict")
        page.get_by_text("22.7° (left 23.7°, right 21.8°)").wait_for()
        box = page.locator(".photograph circle").nth(4).bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(box["x"], box["y"] - 40, steps=3)
        page.mouse.up()
        page.get_by_text("Corrected by hand.").wait_for()
        wait_for(lambda: (tmp_path / ".calstudy" / "photographs.json").exists())
        page.wait_for_timeout(1000)
        dragged = angle.inner_text()
        page.context.close()

        page = opened(browser, server.address, 400)
        page.get_by_role("tab", name=re.compile("Photo")).click()
        page.get_by_text("Corrected by hand.").wait_for()
        assert page.locator(".numbers .verdict").inner_text() == dragged
        page.get_by_role("button", name="Use as a target").click()
        page.get_by_text("angle_of_repose_flank_deg, deg").wait_for()
        assert "angle_of_repose_deg" not in (text := (tmp_path / "calibration.toml").read_text())
        assert "angle_of_repose_flank_deg = { value = " in text
        page.context.close()

        (tmp_path / ".calstudy" / "photographs.json").write_text('{"a.png": {"points": 3}}')
        page = opened(browser, server.address, 1300)
        page.get_by_role("tab", name=re.compile("Photo")).click()
        page.get_by_text(re.compile("photographs.json is damaged; delete it")).wait_for()
        page.get_by_text("22.7° (left 23.7°, right 21.8°)").wait_for()
        page.context.close()
    finally:
        server.end()
