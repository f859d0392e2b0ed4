"""The guides' pictures of presses, of objects, and of the page of `gelgap view`.

python scripts/guide_pictures.py docs/pictures           # --quality draft: in seconds
python scripts/guide_pictures.py docs/pictures --objects # always at draft: three minutes of a core
python scripts/guide_pictures.py docs/pictures --view    # needs Playwright and a Chromium (apt-get install chromium)
"""

import argparse
import shutil
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelgap.benchmarks.render.scenes import OWN_LIT_SENSORS, STORED_SCENES, stored_reference
from gelgap.render import Illumination, MembraneRenderer, Sensor
from gelgap.render.imaging import difference_picture, encode
from gelgap.sim import Elastomer, MembraneState, Pose, Sphere, load_indenter, solve_pose, solve_poses
from gelgap.sim.objects import OBJECTS
from gelgap.sim.problem import QualityName

Picture = NDArray[np.uint8]

POSES = (Pose(depth_mm=0.2), Pose(depth_mm=0.5), Pose(depth_mm=0.8), Pose(depth_mm=0.8, shear_x_mm=0.3))
LIGHTS = ("i0", "i1", "i2")
SIZE_PX = (320, 240)
OBJECT_GEL, OBJECT_SENSOR = "e04", "gelsight-mini-fitted"
OBJECT_POSE = Pose(depth_mm=0.4)
# Letters take minutes.
DRAWN_OBJECTS = [name for name in OBJECTS if name != "letters"]
OBJECT_SIZE_PX, OBJECTS_PER_ROW = (200, 150), 6
PAGE_SIZE_PX = (1560, 860)
PAGE_POSE = Pose(depth_mm=0.9, shear_x_mm=0.35, shear_y_mm=-0.15, point_x_mm=0.6, point_y_mm=0.3)
PATIENCE_S = 900.0
SETTLE_S = 15.0  # in which a browser draws the scene
# Chromium without a screen, a GPU or a word with the network.
FLAGS = (
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


def draw_presses(folder: Path, quality: QualityName) -> None:
    """Solve the presses of gel b0 and write all pictures of them, and the sheet beside the path tracer.

    Raises
    ------
    RuntimeError
        If a press did not converge.
    """
    states = solve_poses(Elastomer.preset("b0"), Sphere(diameter_mm=3.0), POSES, quality)
    if not all(state.converged for state in states):
        raise RuntimeError("a press did not converge, and has no picture; try another --quality")
    rows = list(zip(*(under(light, states) for light in LIGHTS), strict=True))
    save(folder / "illuminations.png", rows[-1:])
    save(folder / "render-presses.jpg", rows)
    save(folder / "render-sensors.jpg", [seen_by(name, states[1::2]) for name in OWN_LIT_SENSORS])
    sheet = []
    for scene in STORED_SCENES:
        reference = stored_reference(scene)
        renderer = MembraneRenderer(scene.sensor(), scene.light(), reference.shape[1::-1])
        ours = renderer.linear(*scene.membrane(), markers=False)
        label = f"{scene.name}: path tracer, standard, 10 x difference"
        sheet.append(compared(label, encode(reference), encode(ours)))
    save(folder / "render-contact-sheet.jpg", sheet)


def draw_objects(path: Path) -> None:
    """Solve a press of each object but one, and draw it by the sensor `paper` under i0 and, below, by a fitted one.

    Raises
    ------
    RuntimeError
        If a press did not converge.
    """
    import cv2

    gel, states = Elastomer.preset(OBJECT_GEL), []
    for name in DRAWN_OBJECTS:
        states.append(solve_pose(gel, load_indenter(name), OBJECT_POSE, "draft"))
        if not states[-1].converged:
            raise RuntimeError(f"the press of {name} did not converge, and has no picture")
    # The first of those by a sensor with LEDs of its own is its reference.
    shown = under(LIGHTS[0], states), seen_by(OBJECT_SENSOR, states)[1:]
    small = [
        [cv2.resize(each, OBJECT_SIZE_PX, interpolation=cv2.INTER_AREA) for each in row] for row in shown
    ]
    for picture, name in zip(small[0], DRAWN_OBJECTS, strict=True):
        cv2.putText(picture, name, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
    for row in small:
        row += [np.zeros_like(row[0])] * (-len(row) % OBJECTS_PER_ROW)
    starts = range(0, len(states), OBJECTS_PER_ROW)
    save(path, [row[start : start + OBJECTS_PER_ROW] for start in starts for row in small])


def compared(label: str, reference: Picture, rendered: Picture) -> list[Picture]:
    """Return a labelled picture, what is rendered, and 128 plus ten times their difference."""
    import cv2

    shown = [reference, rendered, difference_picture(rendered, reference, 10)]
    row = [cv2.resize(each, SIZE_PX, interpolation=cv2.INTER_AREA) for each in shown]
    cv2.putText(row[0], label, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
    return row


def under(light: str, states: Iterable[MembraneState]) -> list[Picture]:
    """Return the pictures of presses under an illumination of the sensor `paper`."""
    renderer = MembraneRenderer(Sensor.preset("paper"), Illumination.preset(light), SIZE_PX)
    return [renderer.picture(state.x_mm, state.y_mm, state.displacement_mm) for state in states]


def seen_by(sensor_name: str, states: Sequence[MembraneState]) -> list[Picture]:
    """Return the reference and the pictures of presses by a sensor with LEDs of its own, with noise."""
    sensor = Sensor.preset(sensor_name)
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX)
    rng = np.random.default_rng(0)
    presses = [renderer.picture(s.x_mm, s.y_mm, s.displacement_mm, rng=rng) for s in states]
    return [renderer.reference(rng=rng), *presses]


def save(path: Path, rows: Sequence[Sequence[Picture]]) -> None:
    """Write rows of pictures as one file."""
    import cv2

    sheet = np.vstack([np.hstack(row) for row in rows])
    cv2.imwrite(str(path), sheet[..., ::-1])


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
        browser = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        try:
            page = browser.new_page(viewport={"width": PAGE_SIZE_PX[0], "height": PAGE_SIZE_PX[1]})
            page.set_default_timeout(1e3 * PATIENCE_S)
            page.goto(address)
            page.get_by_text("contact radius").first.wait_for()
            yield page
        finally:
            browser.close()


def draw_view(path: Path) -> None:
    """Open the page on a press, wait until the gel is solved and the browser has drawn it, and take the picture."""
    from gelgap.view.page import Page
    from gelgap.view.state import Configuration

    start = replace(PAGE_POSE, depth_mm=0.7)
    gel, sensor = Elastomer.preset("e04"), Sensor.preset("paper")
    opened = Page(Configuration(gel, sensor, Illumination.preset("i0"), start), "127.0.0.1", 0)
    try:
        with browser_page(opened.address) as page:
            page.get_by_text("interpolated").first.wait_for()
            # The first picture takes longer than those that a knob gives.
            opened.controls.depth.value = PAGE_POSE.depth_mm
            time.sleep(SETTLE_S)
            if (close := page.locator(".mantine-Notification-closeButton")).count():
                close.first.click()
                time.sleep(1.0)
            page.screenshot(path=str(path), type="jpeg", quality=82)
    finally:
        opened.close()


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="where the pictures go")
    parser.add_argument("--quality", choices=("draft", "standard"), default="standard")
    parser.add_argument("--objects", action="store_true", help="draw objects.jpg instead")
    parser.add_argument("--view", action="store_true", help="take view.jpg instead")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    if arguments.view:
        draw_view(arguments.folder / "view.jpg")
    elif arguments.objects:
        draw_objects(arguments.folder / "objects.jpg")
    else:
        draw_presses(arguments.folder, arguments.quality)


if __name__ == "__main__":
    main()
