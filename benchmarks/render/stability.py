"""Stress for the renderer: memory over many frames, and random presses compared with the finest quality."""

import gc
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, show, write_json
from gelgap.benchmarks.render.scenes import PAPER_LIGHTS, sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor, Variation, vary_illumination

FRAMES, QUICK_FRAMES = 20_000, 1_500
PRESSES, QUICK_PRESSES = 60, 12
FLAT_WITHIN_MIB = 20.0
# No pixel may differ from the finest sampling by more than this, in linear light.
PATCH = 0.08


def run(quick: bool, out_dir: Path) -> None:
    """Print memory over frames and the worst of the random presses; write JSON to `out_dir`."""
    used = memory(QUICK_FRAMES if quick else FRAMES)
    presses = pd.DataFrame(map(random_press, range(QUICK_PRESSES if quick else PRESSES)))
    rendered = presses[presses["refused"] == ""].sort_values("worst pixel", ascending=False, kind="stable")
    patches = int(((rendered["worst pixel"] > PATCH) | ~rendered["finite"]).sum())
    show(
        "Random presses, standard against fine, linear light",
        rendered.drop(columns=["finite", "refused"])[:8],
        note=f"{len(rendered)} rendered, {len(presses) - len(rendered)} refused as folded, {patches} with a pixel off "
        f"by more than {PATCH} or not finite",
    )
    write_json(out_dir / "stability-render.json", {"memory": used, "presses": presses, "patches": patches})


def memory(frames: int) -> Results:
    """Render many frames through renderers that come and go; print the resident memory along the way."""
    import psutil

    sensor, rng = Sensor.preset("paper"), np.random.default_rng(1)
    lights = [Illumination.preset(name) for name in PAPER_LIGHTS]
    x, y, displacement = sphere_dent(0.8, (0.3, 0.1))
    renderers = [MembraneRenderer(sensor, light) for light in lights]
    rows = []
    for frame in range(frames + 1):
        if frame % (frames // 10) == 0:
            gc.collect()
            rows.append((frame, psutil.Process().memory_info().rss / 2**20))
        if frame % 500 == 499:
            size_px = (64 + 16 * (frame // 500 % 12), 48)
            renderers[frame // 500 % 3] = MembraneRenderer(sensor, lights[frame // 500 % 3], size_px)
        renderers[frame % 3].picture(x, y, displacement * rng.uniform(0.2, 1.0), rng=rng)
    trail = pd.DataFrame(rows, columns=["frame", "resident MiB"])
    growth = float(trail["resident MiB"].iloc[-1] - trail["resident MiB"][1])
    note = f"grew {growth:.1f} MiB after the first tenth; target: {FLAT_WITHIN_MIB:g} MiB"
    show(f"Memory over {frames} frames; a new renderer every 500", trail, note)
    return {"trail": trail, "growth_mib": growth, "flat": growth < FLAT_WITHIN_MIB}


def random_press(seed: int) -> Results:
    """Render one random press under a random light at standard and at fine quality, and compare."""
    rng = np.random.default_rng(seed)
    depth = float(rng.uniform(0.05, 1.2))
    angle, drag = rng.uniform(0, 2 * np.pi), float(rng.uniform(0, 0.7) * depth)
    point = (float(rng.uniform(-3.75, 3.75)), float(rng.uniform(-2.6, 2.6)))
    light = f"i{rng.integers(3)}"
    variation = Variation(led_position_mm=0.8, led_angle_deg=10)
    lit = Sensor.preset("paper"), vary_illumination(Illumination.preset(light), variation, rng), (160, 120)
    membrane = sphere_dent(depth, (drag * np.cos(angle), drag * np.sin(angle)), point)
    press = {"depth mm": depth, "drag mm": drag, "x mm": point[0], "y mm": point[1], "light": light}
    outcome = {"worst pixel": 0.0, "mean": 0.0, "finite": True, "refused": ""}
    try:
        renderers = [MembraneRenderer(*lit, quality) for quality in ("standard", "fine")]
        standard, fine = (renderer.linear(*membrane, markers=False) for renderer in renderers)
    except ValueError as error:
        return press | outcome | {"refused": str(error)}
    difference = np.abs(standard - fine)
    finite = bool(np.isfinite([standard, fine]).all() and min(standard.min(), fine.min()) >= 0)
    return press | outcome | {"worst pixel": difference.max(), "mean": difference.mean(), "finite": finite}
