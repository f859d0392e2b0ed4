"""Stress for the renderer: memory over many frames, and random presses whose pictures must not hide trouble."""

import gc
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor, Variation, vary_illumination

FRAMES, QUICK_FRAMES = 20_000, 1_500
SCENES, QUICK_SCENES = 60, 12
SIZE_PX = (320, 240)
FLAT_WITHIN_MIB = 20.0
# Against the finest sampling no pixel may be this much darker or brighter, in linear light.
PATCH = 0.08


@dataclass(frozen=True)
class Press:
    """One random press under a random light: its size, and how far standard is from the finest quality."""

    depth_mm: float
    shear_mm: tuple[float, float]
    point_mm: tuple[float, float]
    light: str
    finite: bool
    worst_difference: float
    mean_difference: float
    refused: str = ""


def resident_mib() -> float:
    """Return this process's resident memory."""
    import psutil

    return psutil.Process().memory_info().rss / 2**20


def memory(frames: int) -> dict[str, object]:
    """Render many frames through renderers that come and go; print the resident memory along the way."""
    sensor = Sensor.preset("paper")
    rng = np.random.default_rng(1)
    lights = [Illumination.preset(name) for name in ("i0", "i1", "i2")]
    x, y, displacement = sphere_dent(0.8, (0.3, 0.1))
    renderers = [MembraneRenderer(sensor, light, SIZE_PX) for light in lights]
    rows, trail = [], []
    started = time.perf_counter()
    for frame in range(frames + 1):
        if frame % (frames // 10) == 0:
            gc.collect()
            trail.append((frame, resident_mib()))
            rows.append([frame, trail[-1][1], time.perf_counter() - started])
        if frame % 500 == 499:
            size_px = (64 + 16 * (frame // 500 % 12), 48)
            renderers[frame // 500 % 3] = MembraneRenderer(sensor, lights[frame // 500 % 3], size_px)
        renderer = renderers[frame % 3]
        renderer.picture(x, y, displacement * rng.uniform(0.2, 1.0), rng=rng)
    growth = trail[-1][1] - trail[1][1]
    print_table(
        f"Memory over {frames} frames; a new renderer every 500",
        ["frame", "resident MiB", "seconds"],
        rows,
        note=f"grew {growth:.1f} MiB after the first tenth; target: {FLAT_WITHIN_MIB:g} MiB",
    )
    return {"trail": trail, "growth_mib": growth, "flat": growth < FLAT_WITHIN_MIB}


def random_press(seed: int) -> Press:
    """Render one random press at standard and at fine quality and compare."""
    rng = np.random.default_rng(seed)
    depth = float(rng.uniform(0.05, 1.2))
    angle, drag = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.7) * depth
    shear = (float(drag * np.cos(angle)), float(drag * np.sin(angle)))
    point = (float(rng.uniform(-3.75, 3.75)), float(rng.uniform(-2.6, 2.6)))
    light = f"i{rng.integers(3)}"
    illumination = vary_illumination(
        Illumination.preset(light), Variation(led_position_mm=0.8, led_angle_deg=10), rng
    )
    sensor = Sensor.preset("paper")
    membrane = sphere_dent(depth, shear, point)
    try:
        pictures = [
            MembraneRenderer(sensor, illumination, (160, 120), quality).linear(*membrane, markers=False)
            for quality in ("standard", "fine")
        ]
    except ValueError as error:
        return Press(depth, shear, point, light, True, 0.0, 0.0, str(error))
    difference = np.abs(pictures[0] - pictures[1])
    finite = bool(np.isfinite(pictures).all() and np.min(pictures) >= 0)
    return Press(depth, shear, point, light, finite, float(difference.max()), float(difference.mean()))


def run(quick: bool, out_dir: Path) -> None:
    """Print memory over frames and the worst of the random presses; write JSON to `out_dir`."""
    out_dir.mkdir(parents=True, exist_ok=True)
    used = memory(QUICK_FRAMES if quick else FRAMES)
    presses = [random_press(seed) for seed in range(QUICK_SCENES if quick else SCENES)]
    rendered = [press for press in presses if not press.refused]
    patches = [press for press in rendered if press.worst_difference > PATCH or not press.finite]
    worst = sorted(rendered, key=lambda press: -press.worst_difference)[:8]
    print_table(
        "Random presses, standard against fine, linear light",
        ["depth mm", "drag mm", "x mm", "y mm", "light", "worst pixel", "mean"],
        [
            [
                p.depth_mm,
                float(np.hypot(*p.shear_mm)),
                *p.point_mm,
                p.light,
                p.worst_difference,
                p.mean_difference,
            ]
            for p in worst
        ],
        note=f"{len(rendered)} rendered, {len(presses) - len(rendered)} refused as folded, {len(patches)} with a "
        f"pixel off by more than {PATCH} or not finite",
    )
    results = {"memory": used, "presses": [asdict(press) for press in presses], "patches": len(patches)}
    write_json(out_dir / "stability-render.json", results)
