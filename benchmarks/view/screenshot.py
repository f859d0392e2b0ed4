"""The picture of `gelgap view` in the guides: `python -m gelgap.benchmarks.view.screenshot docs/pictures/view.jpg`.

It needs Playwright and a Chromium (Debian: apt-get install chromium).
"""

import argparse
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from gelgap.render import Illumination, Sensor
from gelgap.sim import Elastomer, Pose
from gelgap.view import Configuration

SIZE_PX = (1560, 860)
POSE = Pose(depth_mm=0.9, shear_x_mm=0.35, shear_y_mm=-0.15, point_x_mm=0.6, point_y_mm=0.3)
JPEG_QUALITY = 82
_PATIENCE_S = 900.0
# Chromium without a screen, a GPU or a word with the network.
_FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


def find_chromium() -> str | None:
    """Return the path of a Chromium; None if there is none."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@contextmanager
def browser_page(address: str) -> Iterator[Any]:
    """Open an address in a Chromium without a screen, and yield Playwright's page of it.

    Raises
    ------
    RuntimeError
        If there is no Chromium.
    """
    from playwright.sync_api import sync_playwright

    chromium = find_chromium()
    if chromium is None:
        raise RuntimeError("no Chromium was found; install it, on Debian with: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(_FLAGS))
        try:
            page = browser.new_page(viewport={"width": SIZE_PX[0], "height": SIZE_PX[1]})
            page.set_default_timeout(1e3 * _PATIENCE_S)
            page.goto(address)
            page.get_by_text("contact radius").first.wait_for()
            yield page
        finally:
            browser.close()


def take(path: Path, settle_s: float) -> None:
    """Open the page on a press, wait until the gel is solved and the browser has drawn it, and take the picture."""
    from gelgap.view import open_page

    start = Configuration(Elastomer.preset("e04"), Sensor.preset("paper"), Illumination.preset("i0"), POSE)
    opened = open_page(replace(start, pose=replace(POSE, depth_mm=0.7)), port=0)
    try:
        with browser_page(opened.address) as page:
            page.get_by_text("interpolated").first.wait_for()
            # The first picture takes longer than those that a knob gives.
            opened.controls.depth.value = POSE.depth_mm
            time.sleep(settle_s)
            if (close := page.locator(".mantine-Notification-closeButton")).count():
                close.first.click()
                time.sleep(1.0)
            page.screenshot(path=str(path), type="jpeg", quality=JPEG_QUALITY)
    finally:
        opened.close()


def main() -> None:
    """Take the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path, help="the JPEG file to write")
    parser.add_argument(
        "--settle-s", type=float, default=15.0, help="seconds that a browser gets to draw the scene"
    )
    arguments = parser.parse_args()
    take(arguments.path, arguments.settle_s)


if __name__ == "__main__":
    main()
