"""
Your own sensor
===============

One TOML file describes camera, coating, markers and LEDs; a press shows what it sees.
"""

import sys
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np

from gelgap.render import MembraneRenderer, Sensor
from gelgap.sim import Elastomer, Pose, Sphere, solve_pose


def main(
    sensor_file: Path | str | None = None,
    picture: Path | str = "own_sensor.png",
    quality: str = "standard",
) -> np.ndarray:
    sensor = Sensor.load(sensor_file or Path(__file__).with_suffix(".toml"))
    assert sensor.illumination is not None, "the file describes LEDs as well"
    gel = Elastomer(young_modulus_mpa=0.25, poisson_ratio=0.485, friction=0.7, thickness_mm=4.25)
    state = solve_pose(gel, Sphere(diameter_mm=4.0), Pose(depth_mm=0.8, shear_x_mm=0.3), quality)
    renderer = MembraneRenderer(sensor, sensor.illumination, size_px=(320, 240))
    pixels = renderer.picture(state.x_mm, state.y_mm, state.displacement_mm, rng=np.random.default_rng(0))
    cv2.imwrite(str(picture), pixels[..., ::-1])
    print(f"force {np.round(state.force_n, 3)} N")
    return pixels


if __name__ == "__main__":
    plt.imshow(main(*sys.argv[1:]))
    plt.axis("off")
    plt.show()
