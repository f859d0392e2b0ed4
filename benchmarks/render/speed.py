"""Run times of rendering: stages, whole frames, relighting, markers, start-up and inpainting.

Times are medians of processor time in one thread, from a displacement to the 8-bit picture; wall time stands beside
them. Processor time equals wall time on an idle core, and other jobs on the machine disturb it least.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import count

import numpy as np

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.render.baselines import StockPyrender, without_shadows
from gelgap.benchmarks.render.scenes import OWN_LIT_SENSORS, Membrane, RenderScene, sphere_dent
from gelgap.render import (
    Illumination,
    MembraneRenderer,
    Sensor,
    detect_markers,
    imaging,
    inpaint_biharmonic,
    inpaint_telea,
)
from gelgap.render.renderer import QUALITIES
from gelgap.render.surface import Membrane as RestMembrane
from gelgap.render.surface import deformed_surface

SIZES_PX = ((320, 240), (640, 480))
PAPER_LIGHTS = ("i0", "i1", "i2")
START_UP = """
import time
from gelgap.render.rasterizer import import_pyrender
import_pyrender()
started = time.process_time()
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor
MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0")).picture(*sphere_dent(0.6))
print(time.process_time() - started)
"""


def median_ms(
    work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.thread_time
) -> float:
    """Return the median time of some work, after one run to warm up."""
    work()
    times = []
    for _ in range(repeats):
        started = clock()
        work()
        times.append(clock() - started)
    return 1e3 * statistics.median(times)


def frames_ms(
    renderers: list[MembraneRenderer], membrane: Membrane, repeats: int, clock=time.thread_time, **options
) -> float:
    """Return the median ms from a displacement never seen before to its 8-bit pictures through all renderers."""
    x, y, displacement = membrane
    number = count(1)

    def work() -> None:
        unseen = displacement * (1 - 1e-6 * next(number))
        for renderer in renderers:
            renderer.picture(x, y, unseen, **options)

    return median_ms(work, repeats, clock)


def stages_ms(renderer: MembraneRenderer, membrane: Membrane, repeats: int) -> dict[str, float]:
    """Return the median ms of each stage of a frame."""
    on_lattice = RestMembrane(*membrane).displacement_on(renderer.lattice)
    surface = deformed_surface(renderer.lattice, on_lattice, "membrane")
    raster = renderer._rasterizer()
    geometry, radiance = renderer._geometry(surface), renderer._radiance(surface)
    linear = renderer._gather(geometry, radiance)
    rng = np.random.default_rng(0)

    def draw() -> None:
        raster.forget()
        renderer._geometry(surface)

    work = {
        "surface": lambda: deformed_surface(renderer.lattice, on_lattice, "membrane"),
        "raster": draw,
        "light": lambda: renderer._radiance(surface),
        "gather": lambda: renderer._gather(geometry, radiance),
        "markers": lambda: renderer._paint_markers(geometry, linear),
        "noise": lambda: imaging.sensor_noise(linear, renderer.sensor.camera, rng),
        "encode": lambda: imaging.encode(linear),
    }
    return {name: median_ms(job, repeats) for name, job in work.items()}


def speed(repeats: int) -> dict[str, object]:
    """Print the run times of every quality, paper light and sensor, and what else a frame or a start costs."""
    typical, worst = sphere_dent(0.6), sphere_dent(1.0, (0.5, 0.2), (1.0, -0.5))
    sensor, lights = Sensor.preset("paper"), [Illumination.preset(name) for name in PAPER_LIGHTS]
    cases = [(quality, sensor, lights[0]) for quality in QUALITIES if quality != "standard"]
    cases += [("standard", sensor, light) for light in lights]
    cases += [("standard", own, own.illumination) for own in map(Sensor.preset, OWN_LIT_SENSORS)]
    found = {}
    for size_px in SIZES_PX:
        for quality, seen_through, light in cases:
            renderer = MembraneRenderer(seen_through, light, size_px, quality)
            noise = {"rng": np.random.default_rng(0)}
            found[f"{size_px[0]}×{size_px[1]} {quality} {light.name}"] = {
                "typical": frames_ms([renderer], typical, repeats),
                "worst": frames_ms([renderer], worst, repeats),
                "typical, wall": frames_ms([renderer], typical, repeats, time.perf_counter),
                "with noise": frames_ms([renderer], typical, repeats, **noise),
                **stages_ms(renderer, typical, repeats),
            }
    print_table(
        "Processor time in one thread, medians, with markers",
        ["ms per frame", *next(iter(found.values()))],
        [[name, *times.values()] for name, times in found.items()],
        note="targets at standard: 10 typical and 20 worst at 320×240, 20 and 40 at 640×480; "
        "typical: 0.6 mm, worst: 1.0 mm, dragged 0.54 mm, off centre; stages of the typical frame",
    )
    renderers = [MembraneRenderer(sensor, light) for light in lights]
    one, three = (frames_ms(renderers[:lit], typical, repeats) for lit in (1, 3))
    relighting, markers = (three - one) / 2, one - frames_ms(renderers[:1], typical, repeats, markers=False)
    start_up_s = statistics.median(
        float(subprocess.run([sys.executable, "-c", START_UP], capture_output=True, check=True).stdout)
        for _ in range(3)
    )
    print_table(
        "The same membrane again, 320×240, standard",
        ["what", "ms more", "target"],
        [["under another illumination", relighting, 4.0], ["markers on instead of off", markers, 2.0]],
        note=f"start-up from pyrender's import to the first picture: {start_up_s:.2f} s of processor time (aim 0.5)",
    )
    return found | {"start-up s": start_up_s, "relighting ms": relighting, "markers ms": markers}


def inpainting(repeats: int) -> dict[str, dict[str, float]]:
    """Print the error of both inpainting methods against the truly unmarked rendering."""
    found, methods = {}, {"Telea": inpaint_telea, "biharmonic": inpaint_biharmonic}
    for light in PAPER_LIGHTS:
        renderer = MembraneRenderer(Sensor.preset("paper"), Illumination.preset(light))
        membrane = sphere_dent(0.6, (0.3, 0.1))
        marked, plain = (renderer.picture(*membrane, markers=markers) for markers in (True, False))
        mask = detect_markers(marked)
        found[light] = {"detect ms": median_ms(lambda marked=marked: detect_markers(marked), repeats)}
        for name, fill in methods.items():
            mse = np.mean((fill(marked, mask).astype(float) - plain) ** 2)
            ms = median_ms(lambda fill=fill, marked=marked, mask=mask: fill(marked, mask), repeats)
            found[light] |= {f"{name} dB": float(10 * np.log10(255**2 / mse)), f"{name} ms": ms}
    print_table(
        "Inpainted 88 dots against the unmarked rendering, mask found in the picture, 320×240",
        ["light", *found["i0"]],
        [[light, *values.values()] for light, values in found.items()],
    )
    return found


def baseline_times(repeats: int) -> dict[str, float]:
    """Return ms per frame at 320×240 of what others would do: stock pyrender, and ours without shadows."""
    scene = RenderScene("i0", 0.6)
    renderer, membrane = MembraneRenderer(scene.sensor(), scene.light()), scene.membrane()
    stock = StockPyrender(scene, SIZES_PX[0])
    try:
        return {
            "stock pyrender, gain fitted": median_ms(stock.code, max(repeats // 4, 3)),
            "no shadows": median_ms(lambda: imaging.encode(without_shadows(renderer, membrane)), repeats),
        }
    finally:
        stock.close()
