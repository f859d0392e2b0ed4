"""Pictures: error against a path tracer, and run time per frame, for every quality level and for the baselines.

Errors are in linear light without a fitted gain (mean error) and in sRGB (PSNR, SSIM); stock pyrender alone has its
gain fitted, since its light has no unit. Times are medians of processor time in one thread, from a displacement to the
8-bit picture; wall time stands beside them. Processor time equals wall time on an idle core, and other jobs on the
machine disturb it least.
"""

import hashlib
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, Setting, processor_s, run_missing, show, write_json
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
    triangle_mesh,
)
from gelgap.render import (
    Illumination,
    MembraneRenderer,
    Sensor,
    imaging,
)
from gelgap.render.imaging import psnr_db, srgb_encode
from gelgap.render.light.irradiance import direct_light
from gelgap.render.renderer import QUALITIES
from gelgap.render.surface import Membrane as RestMembrane
from gelgap.render.surface import deformed_surface

SIZES_PX = ((320, 240), (640, 480))
SAMPLES_PER_PIXEL, FEWEST_SAMPLES = 256, 4
STOCK, SHADOWLESS = "stock pyrender, gain fitted", "no shadows"


def run(quick: bool, out_dir: Path) -> None:
    """Measure errors and run times, print the tables and write JSON to `out_dir`.

    `quick` compares with the stored path-traced pictures; otherwise all scenes are traced, and kept for a rerun.
    """
    stored = {scene: stored_reference(scene) for scene in STORED_SCENES}
    truth = stored if quick else path_traced(ALL_SCENES, out_dir)
    errors = pd.concat([scene_errors(scene, reference) for scene, reference in truth.items()])
    note = "targets at standard: matt 44 dB, 0.98, 2 %; glossy 38 dB"
    show("Error against the path tracer, linear light without a fitted gain", errors, note)
    repeats = 3 if quick else 31
    tables = {"errors": errors, "times": frame_times(repeats)}
    typical_ms = tables["times"].set_index("ms per frame")["typical"]
    ms = pd.Series({name: typical_ms[f"320×240 {name} i0"] for name in QUALITIES} | baseline_times(repeats))
    matt = errors[errors["scene"].isin([scene.name for scene in truth if scene.matt])].groupby("way")
    summary = pd.DataFrame(
        {
            "ms per frame": ms,
            "PSNR dB median": matt["PSNR dB"].median(),
            "PSNR dB worst": matt["PSNR dB"].min(),
            "mean error %": matt["mean error %"].median(),
        },
        index=ms.index.rename("way"),
    )
    if not quick:
        scene = ALL_SCENES[0]
        (again,) = path_traced([scene], out_dir, seed=5).values()
        noise = tables["reference noise"] = picture_error(again, truth[scene])
        started = time.perf_counter()
        few = picture_error(trace(scene, SIZES_PX[0], FEWEST_SAMPLES, seed=9), truth[scene])
        few_ms = 1e3 * (time.perf_counter() - started)
        row = [few_ms, few["PSNR dB"], few["PSNR dB"], few["mean error %"]]
        summary.loc[f"path tracer, {FEWEST_SAMPLES} samples"] = row
        print(f"two path-traced pictures: {noise['PSNR dB']:.1f} dB, SSIM {noise['SSIM']:.4f}")
    show("Error against time, matt scenes, 320×240, i0's time", summary)
    tables["summary"] = summary.reset_index()
    write_json(out_dir / "render.json", tables)
    print(f"wrote {out_dir}/render.json")


def path_traced(scenes: Iterable[RenderScene], folder: Path, seed: int = 0) -> dict[RenderScene, np.ndarray]:
    """Return scenes' path-traced pictures, read where all that they depend on is as it was, or traced anew."""
    by_name, settings = {scene.name: scene for scene in scenes}, []
    for name, scene in by_name.items():
        of = hashlib.sha256(f"{scene.sensor()!r} {scene.light()!r}".encode())
        of.update(b"".join(array.tobytes() for array in scene.membrane()))
        settings.append(
            {"scene": name, "samples": SAMPLES_PER_PIXEL, "seed": seed, "of": of.hexdigest()[:16]}
        )

    def traced(setting: Setting) -> Results:
        return {"linear": trace(by_name[setting["scene"]], SIZES_PX[0], setting["samples"], setting["seed"])}

    found = run_missing(traced, settings, folder / "path-traced.jsonl", workers=1)
    return dict(zip(by_name.values(), found["linear"], strict=True))


def picture_error(linear: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Compare two linear pictures: PSNR in dB and SSIM in sRGB, and mean error in linear light relative to the mean."""
    from skimage.metrics import structural_similarity

    picture, truth = srgb_encode(linear), srgb_encode(reference)
    return {
        "PSNR dB": psnr_db(picture, truth, peak=1.0),
        "SSIM": float(structural_similarity(picture, truth, channel_axis=2, data_range=1)),
        "mean error %": 100 * float(np.abs(linear - reference).mean() / reference.mean()),
    }


def scene_errors(scene: RenderScene, reference: np.ndarray) -> pd.DataFrame:
    """Return the error of every quality on a scene, and of every baseline if it is matt."""
    size_px, membrane = (reference.shape[1], reference.shape[0]), scene.membrane()
    renderers = {name: MembraneRenderer(scene.sensor(), scene.light(), size_px, name) for name in QUALITIES}
    pictures = {name: renderer.linear(*membrane, markers=False) for name, renderer in renderers.items()}
    if scene.matt:
        pictures[SHADOWLESS] = without_shadows(renderers["standard"], membrane)
        with stock_pyrender(scene, size_px) as draw:
            linear = (draw() / 255.0) ** 2.2
        gain = (linear * reference).sum((0, 1)) / np.maximum((linear**2).sum((0, 1)), 1e-9)
        pictures[STOCK] = linear * gain
    rows = [
        {"scene": scene.name, "way": way} | picture_error(own, reference) for way, own in pictures.items()
    ]
    return pd.DataFrame(rows)


def without_shadows(renderer: MembraneRenderer, membrane: Membrane) -> np.ndarray:
    """Render with the LEDs' area and cosines but as if nothing stood in their way."""
    surface = renderer._surface(RestMembrane(*membrane))
    level = surface._replace(height_mm=np.zeros_like(surface.height_mm))
    light = direct_light(level, renderer._leds, renderer._shadows, None).irradiance
    return renderer._gather(renderer._geometry(surface), light @ renderer._lambert_to_linear)


@contextmanager
def stock_pyrender(scene: RenderScene, size_px: tuple[int, int]) -> Iterator[Callable[[], np.ndarray]]:
    """Yield what draws the uint8 picture with pyrender as it comes: its shader, a point light for each of four LEDs."""
    from gelgap.render.rasterizer import import_pyrender

    pyrender, _ = import_pyrender()
    import trimesh

    points, faces = triangle_mesh(scene.membrane())
    material = pyrender.MetallicRoughnessMaterial(
        baseColorFactor=(0.5, 0.5, 0.5, 1), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    mesh = trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)
    stage = pyrender.Scene(ambient_light=np.zeros(3))
    stage.add(pyrender.Mesh.from_trimesh(mesh, material=material))
    camera, pose = scene.sensor().camera, np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = camera.position_mm
    focal_px, center_px = camera.focal_length_px(size_px[0]), np.divide(size_px, 2)
    lens = pyrender.IntrinsicsCamera(focal_px, focal_px, *center_px, znear=1, zfar=100)
    stage.add(lens, pose=pose)
    for emitter in scene.light().emitters(camera):
        area_mm2 = 4 * np.linalg.norm(emitter.half_u_mm) * np.linalg.norm(emitter.half_v_mm)
        power, pose = emitter.radiance_rgb * area_mm2, np.eye(4)
        pose[:3, 3] = emitter.center_mm
        light = pyrender.PointLight(color=power / power.max(), intensity=float(power.max()))
        stage.add(light, pose=pose)
    renderer = pyrender.OffscreenRenderer(*size_px)
    try:
        yield lambda: renderer.render(stage)[0]
    finally:
        renderer.delete()


def median_ms(
    work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.thread_time
) -> float:
    """Return the median time of some work, after one run to warm up."""
    return 1e3 * processor_s(work, repeats, clock)


def frame_ms(
    renderer: MembraneRenderer, membrane: Membrane, repeats: int, clock=time.thread_time, **options
) -> float:
    """Return the median ms from a displacement never seen before to its 8-bit picture."""
    x, y, displacement = membrane
    number = count(1)

    def work() -> None:
        renderer.picture(x, y, displacement * (1 - 1e-6 * next(number)), **options)

    return median_ms(work, repeats, clock)


def stages_ms(renderer: MembraneRenderer, membrane: Membrane, repeats: int) -> dict[str, float]:
    """Return the median ms of each stage of a frame."""
    on_lattice = RestMembrane(*membrane).displacement_on(renderer.lattice)
    surface = deformed_surface(renderer.lattice, on_lattice, "membrane")
    raster, rng = renderer._rasterizer(), np.random.default_rng(0)
    geometry, radiance = renderer._geometry(surface), renderer._radiance(surface)
    linear = renderer._gather(geometry, radiance)

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


def frame_times(repeats: int) -> pd.DataFrame:
    """Print the run times of a frame and of its stages, for every quality, paper light and sensor."""
    typical, worst = sphere_dent(0.6), sphere_dent(1.0, (0.5, 0.2), (1.0, -0.5))
    sensor, lights = Sensor.preset("paper"), [Illumination.preset(name) for name in PAPER_LIGHTS]
    cases = [(quality, sensor, lights[0]) for quality in QUALITIES if quality != "standard"]
    cases += [("standard", sensor, light) for light in lights]
    cases += [("standard", own, own.illumination) for own in map(Sensor.preset, OWN_LIT_SENSORS)]
    rows = []
    for width, height in SIZES_PX:
        for quality, seen_through, light in cases:
            renderer = MembraneRenderer(seen_through, light, (width, height), quality)
            times = {
                "typical": frame_ms(renderer, typical, repeats),
                "worst": frame_ms(renderer, worst, repeats),
                "typical, wall": frame_ms(renderer, typical, repeats, time.perf_counter),
                "with noise": frame_ms(renderer, typical, repeats, rng=np.random.default_rng(0)),
            }
            name = {"ms per frame": f"{width}×{height} {quality} {light.name}"}
            rows.append(name | times | stages_ms(renderer, typical, repeats))
    note = (
        "targets at standard: 10 typical and 20 worst at 320×240, 20 and 40 at 640×480; typical: 0.6 mm, worst: "
        "1.0 mm, dragged 0.54 mm, off centre; stages of the typical frame"
    )
    show("Processor time in one thread, medians, with markers", table := pd.DataFrame(rows), note)
    return table


def baseline_times(repeats: int) -> dict[str, float]:
    """Return ms per frame at 320×240 of what others would do: stock pyrender, and ours without shadows."""
    scene = RenderScene("i0", 0.6)
    renderer, membrane = MembraneRenderer(scene.sensor(), scene.light()), scene.membrane()
    with stock_pyrender(scene, SIZES_PX[0]) as draw:
        stock_ms = median_ms(draw, max(repeats // 4, 3))
    own_ms = median_ms(lambda: imaging.encode(without_shadows(renderer, membrane)), repeats)
    return {STOCK: stock_ms, SHADOWLESS: own_ms}
