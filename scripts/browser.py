"""Calibrate glass beads in the browser, from three photographs to the material card, as a person would.

    python scripts/browser.py DIRECTORY [--browser /usr/bin/chromium] [--fidelity coarse]

It clicks, types and drags in a headless browser on the page of ``calstudy ui``; LIGGGHTS must be there. In
mid-run it closes the browser, ends the server, and opens both again; it pauses and goes on. DIRECTORY then
holds the project, and pictures of each step at 400 and 1300 pixels. It prints how long each step
took. The same command goes on with a project that was left.
"""

from __future__ import annotations

import argparse
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright

from calstudy.report.card import read_card

ROOT = Path(__file__).parent.parent
PHOTOGRAPHS = [ROOT / "docs" / "images" / f"photograph{k}.jpg" for k in (1, 2, 3)]
WIDTHS = (400, 1300)
HEIGHT = 900
PATIENCE = 3_600_000
"""ms that a step may take."""
SPHERE_MM = "50"


@contextmanager
def served(directory: Path) -> Iterator[str]:
    """Address of the page of a project, while the block runs."""
    words = [sys.executable, "-m", "calstudy", "ui", str(directory), "--no-browser"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield process.stdout.readline().strip()
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)


def opened(browser: Browser, address: str) -> Page:
    """A window of its own on the page."""
    page = browser.new_context(viewport={"width": WIDTHS[1], "height": HEIGHT}).new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(address)
    return page


def step(page: Page, name: str) -> None:
    """Go to a step."""
    page.get_by_role("tab", name=re.compile(name)).click()


def picture(page: Page, directory: Path, name: str) -> None:
    """Keep how a step looks, narrow and wide."""
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": HEIGHT})
        page.wait_for_timeout(1500)
        page.screenshot(path=directory / "pictures" / f"{name}-{width}.png", full_page=True)


def drag(page: Page, handle: Locator, x: float, y: float) -> None:
    """Drag a handle to a place of the picture, given in shares of its width and height."""
    box, frame = handle.bounding_box(), page.locator(".photograph img").bounding_box()
    assert box is not None and frame is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(frame["x"] + x * frame["width"], frame["y"] + y * frame["height"], steps=5)
    page.mouse.up()
    page.wait_for_timeout(1000)


def measure(page: Page, directory: Path) -> None:
    """Step 1: upload, correct an outline and undo it, drag the scale onto the sphere."""
    step(page, "Photo")
    with page.expect_file_chooser() as chooser:
        page.locator(".upload .q-uploader__header a, .upload .q-uploader__header button").last.click()
    chooser.value.set_files(PHOTOGRAPHS)
    expect(page.get_by_text(re.compile(r"3 photograph\(s\) together"))).to_be_visible()
    page.get_by_label("Photograph", exact=True).click()
    page.get_by_role("option", name="photograph1.jpg").click()
    handles, angle = page.locator(".photograph circle"), page.locator(".numbers .verdict")
    expect(handles).to_have_count(19)
    found = angle.inner_text()
    drag(page, handles.nth(4), 0.38, 0.35)
    expect(angle).not_to_have_text(found)
    print(f"outline corrected: {found} -> {angle.inner_text()}")
    page.get_by_role("button", name="As it was found").click()
    expect(angle).to_have_text(found)
    for handle, x in ((17, 0.763), (18, 0.972)):
        drag(page, handles.nth(handle), x, 0.467)
    page.get_by_label("mm of the purple line").fill(SPHERE_MM)
    page.keyboard.press("Tab")
    expect(page.get_by_text(re.compile(r"Height .* mm, radius"))).to_be_visible()
    print(page.get_by_text(re.compile(r"Height .* mm, radius")).inner_text().replace("\n", " "))
    print(page.get_by_text(re.compile(r"together:")).inner_text())
    picture(page, directory, "1-photo")
    page.get_by_role("button", name="Use as a target").click()


def describe(page: Page, directory: Path, fidelity: str) -> None:
    """Step 2: the fidelity, and the bulk density, whose missing error is told beside it."""
    expect(page.get_by_text(re.compile("has an error and bulk_density has none"))).to_be_visible()
    picture(page, directory, "2-mistake")
    page.get_by_label("angle_of_repose: fidelity").click()
    page.get_by_role("option", name=fidelity, exact=True).click()
    row = page.locator(".row-of", has_text="bulk_density")
    for label, text in (("measured", "1530"), ("its error (sd)", "6"), ("tolerance", "15")):
        row.get_by_label(label).fill(text)
        page.keyboard.press("Tab")
        page.wait_for_timeout(1000)
    expect(page.get_by_text(re.compile("has an error and bulk_density has none"))).to_have_count(0)
    picture(page, directory, "2-material")


def calibrate(directory: Path, page: Page) -> None:
    """Steps 3 and 4, until the first runs have ended; then the browser is closed in mid-run."""
    step(page, "Trial")
    page.get_by_role("button", name="Try it").click()
    expect(page.get_by_text(re.compile("Nothing was run"))).to_be_visible()
    picture(page, directory, "3-trial")
    step(page, "Run")
    page.get_by_role("button", name="Calibrate").click()
    under_way = page.locator(".note", has_text=re.compile(r"DEM runs ([2-9]|\d\d) of about"))
    expect(under_way.first).to_be_visible()
    expect(page.get_by_text("The heap of the latest run")).to_be_visible()
    picture(page, directory, "4-run")
    page.context.close()


def finish(browser: Browser, directory: Path, address: str) -> None:
    """The page opened again: pause, go on, and the result with its trade-offs and files."""
    page = opened(browser, address)
    step(page, "Run")
    expect(page.locator(".state")).to_have_text(re.compile(r"^(Running|Paused|Finished)"))
    if page.locator(".state").inner_text().startswith("Running"):
        page.get_by_role("button", name="Pause").click()
    if not page.locator(".state").inner_text().startswith("Finished"):
        expect(page.locator(".state")).to_have_text("Paused.")
        page.get_by_role("button", name="Go on").click()
        expect(page.get_by_text("The heap of the latest run")).to_be_visible()
        picture(page, directory, "4-going-on")
    expect(page.get_by_text("Finished.", exact=True).first).to_be_visible()
    step(page, "Result")
    slider = page.get_by_role("slider", name="MU_PP")
    expect(slider).to_be_visible()
    before = page.locator(".tradeoff").all_inner_texts()
    slider.locator("[tabindex]").first.focus()
    for _ in range(4):
        page.keyboard.press("PageUp")  # ten steps of the slider
    page.wait_for_timeout(3000)
    print(f"by hand: {before} -> {page.locator('.tradeoff').all_inner_texts()}")
    picture(page, directory, "5-result")
    step(page, "Take away")
    picture(page, directory, "6-take-away")
    with page.context.expect_page() as report:
        page.get_by_role("link", name="report.html").click()
    expect(report.value.get_by_role("heading", level=1)).to_contain_text("Calibration")
    card = read_card(directory / "studies" / "calibration" / "report" / "material.json")
    print(f"card {card.content['id']}: {card.optimum}")


def main() -> None:
    """Walk all steps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("directory", type=Path)
    parser.add_argument("--browser", default="/usr/bin/chromium")
    parser.add_argument("--fidelity", default="coarse")
    a = parser.parse_args()
    (a.directory / "pictures").mkdir(parents=True, exist_ok=True)
    expect.set_options(timeout=PATIENCE)
    times = [time.monotonic()]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=a.browser, args=["--no-sandbox"])
        if not (a.directory / "studies" / "calibration").exists():
            with served(a.directory) as address:
                page = opened(browser, address)
                measure(page, a.directory)
                describe(page, a.directory, a.fidelity)
                times.append(time.monotonic())
                calibrate(a.directory, page)
            times.append(time.monotonic())
        with served(a.directory) as address:
            finish(browser, a.directory, address)
        times.append(time.monotonic())
        browser.close()
    steps = ("photo and file", "trial and first runs", "the rest")[-len(times) + 1 :]
    for what, begin, end in zip(steps, times, times[1:], strict=False):
        print(f"{what}: {end - begin:.0f} s")


if __name__ == "__main__":
    main()
