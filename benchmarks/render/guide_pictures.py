"""The guides' pictures of presses: `python -m gelgap.benchmarks.render.guide_pictures docs/pictures`."""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelgap.benchmarks.render.accuracy import draw_contact_sheet
from gelgap.benchmarks.render.path_tracer import stored_reference
from gelgap.benchmarks.render.scenes import OWN_LIT_SENSORS, STORED_SCENES
from gelgap.render import Illumination, MembraneRenderer, Sensor
from gelgap.sim import Elastomer, MembraneState, Pose, QualityName, Sphere, solve_poses

POSES = (Pose(depth_mm=0.2), Pose(depth_mm=0.5), Pose(depth_mm=0.8), Pose(depth_mm=0.8, shear_x_mm=0.3))
LIGHTS = ("i0", "i1", "i2")
SIZE_PX = (320, 240)

Picture = NDArray[np.uint8]


def write(folder: Path, quality: QualityName) -> None:
    """Solve the presses of gel b0 and write all pictures of them, and the sheet beside the path tracer.

    Raises
    ------
    RuntimeError
        If a press did not converge.
    """
    folder.mkdir(parents=True, exist_ok=True)
    states = solve_poses(Elastomer.preset("b0"), Sphere(diameter_mm=3.0), POSES, quality)
    if not all(state.converged for state in states):
        raise RuntimeError("a press did not converge, and has no picture; try another --quality")
    rows = list(zip(*(under(light, states) for light in LIGHTS), strict=True))
    save(folder / "illuminations.png", rows[-1:])
    save(folder / "render-presses.jpg", rows)
    save(folder / "render-sensors.jpg", [seen_by(name, states[1::2]) for name in OWN_LIT_SENSORS])
    draw_contact_sheet(folder / "render-contact-sheet.jpg", beside_the_path_tracer())


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


def beside_the_path_tracer() -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return name, path-traced picture and picture at `standard` of every stored scene, in linear light."""
    sheet = []
    for scene in STORED_SCENES:
        reference = stored_reference(scene)
        size_px = (reference.shape[1], reference.shape[0])
        renderer = MembraneRenderer(scene.sensor(), scene.light(), size_px)
        sheet.append((scene.name, reference, renderer.linear(*scene.membrane(), markers=False)))
    return sheet


def save(path: Path, rows: Sequence[Sequence[Picture]]) -> None:
    """Write rows of pictures as one file."""
    import cv2

    sheet = np.vstack([np.hstack(row) for row in rows])
    cv2.imwrite(str(path), sheet[..., ::-1])


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the pictures go")
    parser.add_argument("--quality", choices=("draft", "standard"), default="standard")
    arguments = parser.parse_args()
    write(arguments.folder, arguments.quality)


if __name__ == "__main__":
    main()
