"""Stress for the renderer: memory over many frames, and random presses compared with the finest quality."""

import gc
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, show, write_json
from gelgap.benchmarks.render.scenes import PAPER_LIGHTS, drawn_scene, sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor

FRAMES, QUICK_FRAMES = 20_000, 1_500
PRESSES, QUICK_PRESSES = 60, 12
SIZE_PX = (160, 120)
FLAT_WITHIN_MIB = 20.0
# No pixel may differ from the finest sampling by more than this, in linear light.
PATCH = 0.08


def run(quick: bool, out_dir: Path) -> None:
    """Print memory over frames and the worst of the random presses; write JSON to `out_dir`."""
    trail = memory(QUICK_FRAMES if quick else FRAMES)
    growth_mib = float(trail["resident MiB"].iloc[-1] - trail["resident MiB"][1])
    note = f"grew {growth_mib:.1f} MiB after the first tenth; target: {FLAT_WITHIN_MIB:g} MiB"
    show(f"Memory over {trail['frame'].iloc[-1]} frames; a new renderer every 500", trail, note)
    presses = pd.DataFrame(map(random_press, range(QUICK_PRESSES if quick else PRESSES)))
    presses = presses.sort_values("worst pixel", ascending=False)
    patches = (presses["worst pixel"] > PATCH).sum()
    note = f"of {len(presses)} presses, {patches} have a pixel that is off by more than {PATCH} or not finite"
    show("Random presses, standard against fine, linear light", presses[:8], note)
    write_json(out_dir / "stability-render.json", {"memory": trail, "presses": presses})


def memory(frames: int) -> pd.DataFrame:
    """Render many frames through renderers that come and go; return the resident memory along the way."""
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
    return pd.DataFrame(rows, columns=["frame", "resident MiB"])


def random_press(seed: int) -> Results:
    """Render a drawn press at standard and at fine quality, and compare."""
    scene = drawn_scene(seed)
    renderers = (
        MembraneRenderer(scene.sensor(), scene.light(), SIZE_PX, name) for name in ("standard", "fine")
    )
    standard, fine = (renderer.linear(*scene.membrane(), markers=False) for renderer in renderers)
    off = np.abs(standard - fine)
    off[~np.isfinite(off) | (np.minimum(standard, fine) < 0)] = np.inf
    return {"scene": scene.name, "worst pixel": off.max(), "mean": off.mean()}
