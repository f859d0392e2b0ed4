"""Pictures: error against a path tracer, and run time per frame, for every quality level, and without shadows.

Errors are in linear light without a fitted gain (mean error) and in sRGB (PSNR, SSIM). Times are medians of processor
time in one thread, from a displacement to the 8-bit picture. Processor time equals wall time on an idle core, and other
jobs on the machine disturb it least. `python -m gelgap.benchmarks.render.accuracy --table FILE` prints the tables of a
file of records again.
"""

import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.result_table import ResultTable
from gelgap.assets.checksums import sha256
from gelgap.benchmarks.common import (
    Results,
    Setting,
    print_tables,
    processor_s,
    read_records,
    run_missing,
    write_records,
)
from gelgap.benchmarks.render.scenes import (
    ALL_SCENES,
    OWN_LIT_SENSORS,
    PAPER_LIGHTS,
    STORED_SCENES,
    Membrane,
    RenderScene,
    sphere_dent,
    stored_reference,
    trace,
)
from gelgap.render import Illumination, MembraneRenderer, Sensor, imaging
from gelgap.render.imaging import psnr_db, srgb_encode
from gelgap.render.light.irradiance import direct_light
from gelgap.render.renderer import QUALITIES
from gelgap.render.surface import Membrane as RestMembrane

SIZES_PX = ((320, 240), (640, 480))
SAMPLES_PER_PIXEL = 256
SHADOWLESS = "no shadows"


def run(quick: bool, out_dir: Path) -> None:
    """Measure errors and run times, print the tables and write `render.jsonl` to `out_dir`.

    `quick` compares with the stored path-traced pictures; otherwise all scenes are traced, and kept for a rerun.
    """
    stored = {scene: stored_reference(scene) for scene in STORED_SCENES}
    truth = stored if quick else path_traced(out_dir)
    errors = [
        {"of": "errors", "scene": scene.name, "matt": scene.matt, "way": way}
        | picture_error(linear, reference)
        for scene, reference in truth.items()
        for way, linear in rendered(scene, reference.shape[1::-1]).items()
    ]
    times = frame_times(3 if quick else 31)
    file = out_dir / "render.jsonl"
    write_records(file, pd.DataFrame([*errors, *times]), ("of", "scene", "way", "size", "light"))
    for table in tables(read_records(file)):
        table.show()
    print(f"wrote {file}")


def tables(records: pd.DataFrame) -> list[ResultTable]:
    """Return errors scene by scene, times, and both together for matt scenes."""
    errors = records[records["of"] == "errors"]
    times = records[records["of"] == "times"]
    matt = errors[errors["matt"] == True].groupby("way")  # noqa: E712 - NaN where a record is of times
    small = times[(times["size"] == "320×240") & (times["light"] == "i0")].set_index("way")
    summary = pd.DataFrame(
        {
            "ms per frame": small["typical"],
            "PSNR dB median": matt["PSNR dB"].median(),
            "PSNR dB worst": matt["PSNR dB"].min(),
            "mean error %": matt["mean error %"].median(),
        }
    ).reindex([*QUALITIES, SHADOWLESS])
    return [
        ResultTable.of(
            "Error against the path tracer, linear light without a fitted gain",
            errors[["scene", "way", "PSNR dB", "SSIM", "mean error %"]].reset_index(drop=True),
            "targets at standard: matt 44 dB, 0.98, 2 %; glossy 38 dB",
        ),
        ResultTable.of(
            "Processor time in one thread, medians, with markers: ms per frame",
            times[["size", "way", "light", "typical", "worst", "with noise"]].reset_index(drop=True),
            "targets at standard: 10 typical and 20 worst at 320×240, 20 and 40 at 640×480; typical: 0.6 mm, worst: "
            "1.0 mm, dragged 0.54 mm, off centre",
        ),
        ResultTable.of(
            f"Error against time, {errors['scene'].nunique()} scenes of which the matt ones count, 320×240, i0's time",
            summary.rename_axis("way"),
            "",
            {"": "{:.1f}", "mean error %": "{:.2f}"},
        ),
    ]


def path_traced(folder: Path) -> dict[RenderScene, np.ndarray]:
    """Return all scenes' path-traced pictures, read where all that they depend on is as it was, or traced anew."""
    by_name, settings = {scene.name: scene for scene in ALL_SCENES}, []
    for name, scene in by_name.items():
        content = [f"{scene.sensor()!r} {scene.light()!r}".encode()]
        content += [array.tobytes() for array in scene.membrane()]
        settings.append({"scene": name, "samples": SAMPLES_PER_PIXEL, "of": sha256(b"".join(content))[:16]})

    def traced(setting: Setting) -> Results:
        return {"linear": trace(by_name[setting["scene"]], SIZES_PX[0], setting["samples"])}

    found = run_missing(traced, settings, folder / "path-traced.jsonl", workers=1)
    return dict(zip(by_name.values(), found["linear"], strict=True))


def rendered(scene: RenderScene, size_px: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return the linear picture of a scene at every quality, and without shadows if it is matt."""
    membrane = scene.membrane()
    renderers = {name: MembraneRenderer(scene.sensor(), scene.light(), size_px, name) for name in QUALITIES}
    pictures = {name: renderer.linear(*membrane, markers=False) for name, renderer in renderers.items()}
    if scene.matt:
        pictures[SHADOWLESS] = without_shadows(renderers["standard"], membrane)
    return pictures


def without_shadows(renderer: MembraneRenderer, membrane: Membrane) -> np.ndarray:
    """Render with the LEDs' area and cosines but as if nothing stood in their way."""
    surface = renderer._surface(RestMembrane(*membrane))
    level = surface._replace(height_mm=np.zeros_like(surface.height_mm))
    light = direct_light(level, renderer._leds, renderer._shadows, None).irradiance
    return renderer._gather(renderer._geometry(surface), light @ renderer._lambert_to_linear)


def picture_error(linear: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Compare two linear pictures: PSNR in dB and SSIM in sRGB, and mean error in linear light relative to the mean."""
    from skimage.metrics import structural_similarity

    picture, truth = srgb_encode(linear), srgb_encode(reference)
    return {
        "PSNR dB": psnr_db(picture, truth, peak=1.0),
        "SSIM": float(structural_similarity(picture, truth, channel_axis=2, data_range=1)),
        "mean error %": 100 * float(np.abs(linear - reference).mean() / reference.mean()),
    }


def frame_times(repeats: int) -> list[Results]:
    """Return the run times of a frame for every quality, paper light and sensor, and without shadows."""
    typical, worst = sphere_dent(0.6), sphere_dent(1.0, (0.5, 0.2), (1.0, -0.5))
    sensor, lights = Sensor.preset("paper"), [Illumination.preset(name) for name in PAPER_LIGHTS]
    cases = [(quality, sensor, lights[0]) for quality in QUALITIES if quality != "standard"]
    cases += [("standard", sensor, light) for light in lights]
    cases += [("standard", own, own.illumination) for own in map(Sensor.preset, OWN_LIT_SENSORS)]
    rows: list[Results] = []
    for width, height in SIZES_PX:
        for quality, seen_through, light in cases:
            renderer = MembraneRenderer(seen_through, light, (width, height), quality)
            rows.append(
                {
                    "of": "times",
                    "size": f"{width}×{height}",
                    "way": quality,
                    "light": light.name,
                    "typical": frame_ms(renderer, typical, repeats),
                    "worst": frame_ms(renderer, worst, repeats),
                    "with noise": frame_ms(renderer, typical, repeats, rng=np.random.default_rng(0)),
                }
            )
    scene = RenderScene("i0", 0.6)
    renderer, dent = MembraneRenderer(scene.sensor(), scene.light()), scene.membrane()
    ms = median_ms(lambda: imaging.encode(without_shadows(renderer, dent)), repeats)
    rows.append({"of": "times", "size": "320×240", "way": SHADOWLESS, "light": "i0", "typical": ms})
    return rows


def frame_ms(renderer: MembraneRenderer, membrane: Membrane, repeats: int, **options) -> float:
    """Return the median ms from a displacement never seen before to its 8-bit picture."""
    x, y, displacement = membrane
    number = count(1)
    return median_ms(
        lambda: renderer.picture(x, y, displacement * (1 - 1e-6 * next(number)), **options), repeats
    )


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Return the median processor time of some work, after one run to warm up."""
    return 1e3 * processor_s(work, repeats, time.thread_time)


if __name__ == "__main__":
    print_tables(__doc__, tables)
