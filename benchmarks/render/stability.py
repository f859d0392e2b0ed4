"""Stress for the renderer: memory over many frames, and random presses compared with the finest quality."""

import gc
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor, Variation, vary_illumination

FRAMES, QUICK_FRAMES = 20_000, 1_500
PRESSES, QUICK_PRESSES = 60, 12
FLAT_WITHIN_MIB = 20.0
# No pixel may differ from the finest sampling by more than this, in linear light.
PATCH = 0.08


@dataclass(frozen=True)
class RandomPress:
    """One random press under a random light, and how far standard is from the finest quality."""

    depth_mm: float
    drag_mm: float
    point_mm: tuple[float, float]
    light: str
    finite: bool = True
    worst_difference: float = 0.0
    mean_difference: float = 0.0
    refused: str = ""


def memory(frames: int) -> dict[str, object]:
    """Render many frames through renderers that come and go; print the resident memory along the way."""
    import psutil

    sensor, rng = Sensor.preset("paper"), np.random.default_rng(1)
    lights = [Illumination.preset(name) for name in ("i0", "i1", "i2")]
    x, y, displacement = sphere_dent(0.8, (0.3, 0.1))
    renderers = [MembraneRenderer(sensor, light) for light in lights]
    trail = []
    for frame in range(frames + 1):
        if frame % (frames // 10) == 0:
            gc.collect()
            trail.append((frame, psutil.Process().memory_info().rss / 2**20))
        if frame % 500 == 499:
            size_px = (64 + 16 * (frame // 500 % 12), 48)
            renderers[frame // 500 % 3] = MembraneRenderer(sensor, lights[frame // 500 % 3], size_px)
        renderers[frame % 3].picture(x, y, displacement * rng.uniform(0.2, 1.0), rng=rng)
    growth = trail[-1][1] - trail[1][1]
    print_table(
        f"Memory over {frames} frames; a new renderer every 500",
        ["frame", "resident MiB"],
        trail,
        note=f"grew {growth:.1f} MiB after the first tenth; target: {FLAT_WITHIN_MIB:g} MiB",
    )
    return {"trail": trail, "growth_mib": growth, "flat": growth < FLAT_WITHIN_MIB}


def random_press(seed: int) -> RandomPress:
    """Render one random press at standard and at fine quality and compare."""
    rng = np.random.default_rng(seed)
    depth = float(rng.uniform(0.05, 1.2))
    angle, drag = rng.uniform(0, 2 * np.pi), float(rng.uniform(0, 0.7) * depth)
    point = (float(rng.uniform(-3.75, 3.75)), float(rng.uniform(-2.6, 2.6)))
    light = f"i{rng.integers(3)}"
    variation = Variation(led_position_mm=0.8, led_angle_deg=10)
    illumination = vary_illumination(Illumination.preset(light), variation, rng)
    membrane = sphere_dent(depth, (drag * np.cos(angle), drag * np.sin(angle)), point)
    try:
        standard, fine = (
            MembraneRenderer(Sensor.preset("paper"), illumination, (160, 120), quality).linear(
                *membrane, markers=False
            )
            for quality in ("standard", "fine")
        )
    except ValueError as error:
        return RandomPress(depth, drag, point, light, refused=str(error))
    difference = np.abs(standard - fine)
    finite = bool(np.isfinite([standard, fine]).all() and min(standard.min(), fine.min()) >= 0)
    return RandomPress(depth, drag, point, light, finite, float(difference.max()), float(difference.mean()))


def run(quick: bool, out_dir: Path) -> None:
    """Print memory over frames and the worst of the random presses; write JSON to `out_dir`."""
    used = memory(QUICK_FRAMES if quick else FRAMES)
    presses = [random_press(seed) for seed in range(QUICK_PRESSES if quick else PRESSES)]
    rendered = sorted((press for press in presses if not press.refused), key=lambda p: -p.worst_difference)
    patches = [press for press in rendered if press.worst_difference > PATCH or not press.finite]
    print_table(
        "Random presses, standard against fine, linear light",
        ["depth mm", "drag mm", "x mm", "y mm", "light", "worst pixel", "mean"],
        [
            [p.depth_mm, p.drag_mm, *p.point_mm, p.light, p.worst_difference, p.mean_difference]
            for p in rendered[:8]
        ],
        note=f"{len(rendered)} rendered, {len(presses) - len(rendered)} refused as folded, {len(patches)} with a "
        f"pixel off by more than {PATCH} or not finite",
    )
    results = {"memory": used, "presses": presses, "patches": len(patches)}
    write_json(out_dir / "stability-render.json", results)
