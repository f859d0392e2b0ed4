"""Pictures: error against a path tracer, and run time a frame, for every quality level and for the baselines.

Errors are in linear light without a fitted gain (mean error) and in sRGB (PSNR, SSIM); stock pyrender alone has its
gain fitted, since its light has no unit. Times are medians of processor time in one
thread, from a displacement to the 8-bit picture; wall time stands beside them.
"""

import hashlib
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.assets import asset_path
from gelgap.benchmarks.common.tables import Point, plot_frontier, print_table, write_json
from gelgap.benchmarks.render.path_tracer import stored_reference, trace
from gelgap.benchmarks.render.scenes import (
    DRAWN_SCENES,
    GLOSSY_SCENES,
    MATT_SCENES,
    SENSOR_SCENES,
    STORED_SCENES,
    RenderScene,
    sphere_dent,
)
from gelgap.render import (
    Illumination,
    MembraneRenderer,
    Sensor,
    detect_markers,
    imaging,
    inpaint_biharmonic,
    inpaint_telea,
)
from gelgap.render.imaging import srgb_encode
from gelgap.render.rasterizer import rasterizer_for
from gelgap.render.renderer import QUALITIES
from gelgap.render.shading import direct_light
from gelgap.render.surface import deformed_surface, displacement_on

SIZES_PX = ((320, 240), (640, 480))
SAMPLES_PER_PIXEL = 256
PAPER_LIGHTS = ("i0", "i1", "i2")
OWN_LIT_SENSORS = ("gelsight-mini-like", "digit-like", "gelsight-2014-like")


@dataclass(frozen=True)
class PictureError:
    """Mean error in linear light relative to the mean, PSNR in dB and SSIM in sRGB."""

    mean: float
    psnr_db: float
    ssim: float


def picture_error(linear: np.ndarray, reference: np.ndarray) -> PictureError:
    """Compare two linear pictures."""
    from skimage.metrics import structural_similarity

    one, other = srgb_encode(linear), srgb_encode(reference)
    mse = max(float(np.mean((one - other) ** 2)), 1e-12)
    return PictureError(
        mean=float(np.abs(linear - reference).mean() / reference.mean()),
        psnr_db=-10 * np.log10(mse),
        ssim=float(structural_similarity(one, other, channel_axis=2, data_range=1)),
    )


def median_ms(
    work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.thread_time
) -> float:
    """Return the median time of some single-threaded work, after one run to warm up.

    Processor time by default: it equals wall time on an idle core, and other jobs on the machine disturb it least.
    """
    work()
    times = []
    for _ in range(repeats):
        started = clock()
        work()
        times.append(clock() - started)
    return 1e3 * statistics.median(times)


def without_shadows(renderer: MembraneRenderer, membrane) -> np.ndarray:
    """Render with the LEDs' area and cosines but as if nothing stood in their way."""
    surface = renderer._surface(*membrane, "membrane")
    level = replace(surface, height_mm=np.zeros_like(surface.height_mm))
    light = direct_light(level, renderer._samples, renderer._shadows, None).irradiance
    return renderer._gather(renderer._geometry(surface), light @ renderer._lambert_to_linear)


class StockPyrender:
    """pyrender as it comes: its own shader and 8-bit output, and a point light for each LED (it takes four)."""

    def __init__(self, scene: RenderScene, size_px: tuple[int, int]):
        from gelgap.render.compat import import_pyrender

        pyrender, _ = import_pyrender()
        import trimesh

        x, y, displacement = scene.membrane()
        points = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1) + displacement
        index = np.arange(len(y) * len(x)).reshape(len(y), len(x))
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        faces = np.concatenate(
            [np.stack([a, c, b], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)]
        )
        material = pyrender.MetallicRoughnessMaterial(
            baseColorFactor=(0.5, 0.5, 0.5, 1), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
        )
        mesh = trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)
        self._scene = pyrender.Scene(ambient_light=np.zeros(3))
        self._scene.add(pyrender.Mesh.from_trimesh(mesh, material=material))
        camera = scene.sensor().camera
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[:3, 3] = camera.position_mm
        focal_px = camera.focal_length_px(size_px[0])
        self._scene.add(
            pyrender.IntrinsicsCamera(focal_px, focal_px, size_px[0] / 2, size_px[1] / 2, znear=1, zfar=100),
            pose=pose,
        )
        for emitter in scene.light().emitters(camera):
            area_mm2 = 4 * np.linalg.norm(emitter.half_u_mm) * np.linalg.norm(emitter.half_v_mm)
            power = emitter.radiance_rgb * area_mm2
            light_pose = np.eye(4)
            light_pose[:3, 3] = emitter.center_mm
            light = pyrender.PointLight(color=power / power.max(), intensity=float(power.max()))
            self._scene.add(light, pose=light_pose)
        self._renderer = pyrender.OffscreenRenderer(*size_px)

    def code(self) -> np.ndarray:
        return self._renderer.render(self._scene)[0]

    def fitted_linear(self, reference: np.ndarray) -> np.ndarray:
        """Return its picture, pow(1/2.2) undone, with the gain of each channel fitted to a reference."""
        linear = (self.code() / 255.0) ** 2.2
        gain = (linear * reference).sum((0, 1)) / np.maximum((linear**2).sum((0, 1)), 1e-9)
        return linear * gain

    def close(self) -> None:
        self._renderer.delete()


def references(quick: bool, out_dir: Path) -> dict[RenderScene, np.ndarray]:
    """Return the path-traced pictures: stored small ones, or all scenes at 320×240, kept in `out_dir` for a rerun."""
    if quick:
        return {scene: stored_reference(scene) for scene in STORED_SCENES}
    scenes = MATT_SCENES + GLOSSY_SCENES + DRAWN_SCENES + SENSOR_SCENES
    return {scene: kept_trace(scene, SAMPLES_PER_PIXEL, 0, out_dir / "path-traced") for scene in scenes}


def kept_trace(scene: RenderScene, samples_per_pixel: int, seed: int, folder: Path) -> np.ndarray:
    """Return a scene's path-traced picture from a file named by all that it depends on, or trace it anew."""
    text = f"{scene.sensor()!r} {scene.light()!r} {SIZES_PX[0]} {samples_per_pixel} {seed}".encode()
    key = hashlib.sha256(text + b"".join(array.tobytes() for array in scene.membrane())).hexdigest()[:16]
    file = folder / f"{key}.npy"
    if not file.exists():
        started = time.perf_counter()
        picture = trace(scene, SIZES_PX[0], samples_per_pixel, seed)
        print(f"  path-traced {scene.name} in {time.perf_counter() - started:.0f} s", flush=True)
        folder.mkdir(parents=True, exist_ok=True)
        np.save(folder / "unfinished.npy", picture)
        (folder / "unfinished.npy").replace(file)
    return np.load(file)


def accuracy(truth: dict[RenderScene, np.ndarray], out_dir: Path) -> dict[str, dict[str, PictureError]]:
    """Print every quality's and baseline's error on every scene, and draw the contact sheet."""
    errors: dict[str, dict[str, PictureError]] = {}
    sheet = []
    for scene, reference in truth.items():
        size_px = reference.shape[1], reference.shape[0]
        membrane, found = scene.membrane(), {}
        for quality in QUALITIES:
            renderer = MembraneRenderer(scene.sensor(), scene.light(), size_px, quality)
            picture = renderer.linear(*membrane, markers=False)
            found[quality] = picture_error(picture, reference)
            if quality == "standard":
                sheet.append((scene, reference, picture))
        if scene.matt:
            renderer = MembraneRenderer(scene.sensor(), scene.light(), size_px)
            found["no shadows"] = picture_error(without_shadows(renderer, membrane), reference)
            stock = StockPyrender(scene, size_px)
            found["stock pyrender, gain fitted"] = picture_error(stock.fitted_linear(reference), reference)
            stock.close()
        errors[scene.name] = found
    rows = [
        [name, way, error.psnr_db, error.ssim, 100 * error.mean]
        for name, found in errors.items()
        for way, error in found.items()
    ]
    print_table(
        "Error against the path tracer, linear light without a fitted gain",
        ["scene", "way", "PSNR dB", "SSIM", "mean error %"],
        rows,
        note="targets at standard: matt 44 dB, 0.98, 2 %; glossy 38 dB",
    )
    draw_contact_sheet(out_dir / "render-contact-sheet.png", sheet)
    return errors


def draw_contact_sheet(path: Path, sheet) -> None:
    """Draw reference, ours and ten times the difference of each scene."""
    import cv2

    rows = []
    for scene, reference, picture in sheet:
        one, other = srgb_encode(reference), srgb_encode(picture)
        row = np.hstack([one, other, np.clip(0.5 + 10 * (other - one), 0, 1)])
        row = cv2.resize(np.ascontiguousarray(row, np.float32), (960, 240), interpolation=cv2.INTER_NEAREST)
        row = np.ascontiguousarray((255 * row[..., ::-1]).astype(np.uint8))
        label = f"{scene.name}: path tracer, standard, 10 x difference"
        cv2.putText(row, label, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
        rows.append(row)
    cv2.imwrite(str(path), np.vstack(rows))


def stages(renderer: MembraneRenderer, membrane, repeats: int) -> dict[str, float]:
    """Return the median ms of each stage of a frame."""
    on_lattice = displacement_on(renderer.lattice, *membrane, "membrane")
    surface = deformed_surface(renderer.lattice, on_lattice, "membrane")
    raster = rasterizer_for(renderer.sensor.camera, renderer.lattice.every(2), renderer.size_px)
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


START_UP = """
import time
from gelgap.render.compat import import_pyrender
import_pyrender()
started = time.process_time()
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render import Illumination, MembraneRenderer, Sensor
MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0")).picture(*sphere_dent(0.6))
print(time.process_time() - started)
"""


def start_up_s() -> float:
    """Return the processor time of a fresh process from having imported pyrender to its first picture."""
    child = subprocess.run([sys.executable, "-c", START_UP], capture_output=True, text=True, check=True)
    return float(child.stdout)


def frame_ms(renderer: MembraneRenderer, membrane, repeats: int, clock=time.thread_time, **options) -> float:
    """Return the median ms from a displacement never seen before to the 8-bit picture."""
    x, y, displacement = membrane
    count = iter(range(1, 10**9))

    def work() -> None:
        renderer.picture(x, y, displacement * (1 - 1e-6 * next(count)), **options)

    return median_ms(work, repeats, clock)


def speed(repeats: int) -> dict[str, object]:
    """Print run times: stages, whole frames, relighting, markers and start-up."""
    typical, worst = sphere_dent(0.6), sphere_dent(1.0, (0.5, 0.2), (1.0, -0.5))
    sensor, found = Sensor.preset("paper"), {}
    rows = []
    paper = [("standard", sensor, light, Illumination.preset(light)) for light in PAPER_LIGHTS]
    others = [(name, sensor, "i0", Illumination.preset("i0")) for name in QUALITIES if name != "standard"]
    owns = [("standard", own, own.name, own.illumination) for own in map(Sensor.preset, OWN_LIT_SENSORS)]
    for size_px in SIZES_PX:
        for quality, seen_through, lit, light in (*others, *paper, *owns):
            renderer = MembraneRenderer(seen_through, light, size_px, quality)
            rng = np.random.default_rng(0)
            times = {
                "typical": frame_ms(renderer, typical, repeats),
                "worst": frame_ms(renderer, worst, repeats),
                "typical, wall": frame_ms(renderer, typical, repeats, time.perf_counter),
                "with noise": frame_ms(renderer, typical, repeats, rng=rng),
                **stages(renderer, typical, repeats),
            }
            name = f"{size_px[0]}×{size_px[1]} {quality} {lit}"
            found[name] = times
            rows.append([name, *times.values()])
    columns = ["ms a frame", *times]
    print_table(
        "Processor time in one thread, medians, with markers",
        columns,
        rows,
        note="targets at standard: 10 typical and 20 worst at 320×240, 20 and 40 at 640×480; "
        "typical: 0.6 mm, worst: 1.0 mm, dragged 0.54 mm, off centre; stages of the typical frame",
    )
    renderers = [MembraneRenderer(sensor, Illumination.preset(light)) for light in PAPER_LIGHTS]

    def lit(count: int, markers: bool) -> float:
        x, y, displacement = typical
        number = iter(range(1, 10**9))

        def work() -> None:
            field = displacement * (1 - 1e-6 * next(number))
            for renderer in renderers[:count]:
                renderer.picture(x, y, field, markers=markers)

        return median_ms(work, repeats)

    found["start-up s"] = statistics.median(start_up_s() for _ in range(3))
    one, three, plain = lit(1, True), lit(3, True), lit(1, False)
    found["relighting ms"], found["markers ms"] = (three - one) / 2, one - plain
    print_table(
        "The same membrane again, 320×240, standard",
        ["what", "ms more", "target"],
        [
            ["under another illumination", found["relighting ms"], 4.0],
            ["markers on instead of off", found["markers ms"], 2.0],
        ],
        note=f"start-up beyond importing pyrender, to the first picture: {found['start-up s']:.2f} s of processor time "
        "(aim 0.5)",
    )
    return found


def inpainting(repeats: int) -> dict[str, dict[str, float]]:
    """Print the error of both inpainting methods against the truly unmarked rendering."""
    found, rows = {}, []
    for light in PAPER_LIGHTS:
        renderer = MembraneRenderer(Sensor.preset("paper"), Illumination.preset(light))
        membrane = sphere_dent(0.6, (0.3, 0.1))
        marked, plain = (renderer.picture(*membrane, markers=flag) for flag in (True, False))
        mask = detect_markers(marked)
        methods = {"Telea": inpaint_telea, "biharmonic": inpaint_biharmonic}
        found[light] = {"detect ms": median_ms(lambda marked=marked: detect_markers(marked), repeats)}
        for name, fill in methods.items():
            mse = np.mean((fill(marked, mask).astype(float) - plain) ** 2)
            ms = median_ms(lambda fill=fill, marked=marked, mask=mask: fill(marked, mask), repeats)
            found[light] |= {f"{name} dB": float(10 * np.log10(255**2 / mse)), f"{name} ms": ms}
        rows.append([light, *found[light].values()])
    print_table(
        "Inpainted 88 dots against the unmarked rendering, mask found in the picture, 320×240",
        ["light", *found["i0"]],
        rows,
    )
    return found


def baseline_times(repeats: int) -> dict[str, float]:
    """Return ms a frame at 320×240 of what others would do: stock pyrender, and ours without shadows."""
    scene = RenderScene("i0", 0.6)
    renderer = MembraneRenderer(scene.sensor(), scene.light())
    membrane = scene.membrane()
    stock = StockPyrender(scene, SIZES_PX[0])
    try:
        return {
            "stock pyrender, gain fitted": median_ms(stock.code, max(repeats // 4, 3)),
            "no shadows": median_ms(lambda: imaging.encode(without_shadows(renderer, membrane)), repeats),
        }
    finally:
        stock.close()


def path_tracer_at_equal_time(truth: dict[RenderScene, np.ndarray]) -> tuple[float, PictureError]:
    """Return ms and error of the path tracer with the fewest samples that it takes: 4 a pixel."""
    scene = next(iter(truth))
    started = time.perf_counter()
    picture = trace(scene, SIZES_PX[0], 4, seed=9)
    return 1e3 * (time.perf_counter() - started), picture_error(picture, truth[scene])


def run(quick: bool, out_dir: Path) -> None:
    """Measure errors and run times, print the tables and write JSON, a plot and a contact sheet to `out_dir`."""
    out_dir.mkdir(parents=True, exist_ok=True)
    repeats = 9 if quick else 31
    truth = references(quick, out_dir)
    errors = accuracy(truth, out_dir)
    results: dict[str, object] = {"errors": errors}
    times = speed(repeats)
    baselines = baseline_times(repeats)
    results |= {"times_ms": times, "baseline_times_ms": baselines, "inpainting": inpainting(repeats)}
    milliseconds = {quality: times[f"320×240 {quality} i0"]["typical"] for quality in QUALITIES} | baselines
    matt = [found for found in errors.values() if "no shadows" in found]
    summary = {
        way: (
            milliseconds[way],
            statistics.median(found[way].psnr_db for found in matt),
            min(found[way].psnr_db for found in matt),
            100 * statistics.median(found[way].mean for found in matt),
        )
        for way in milliseconds
    }
    if not quick:
        scene = next(iter(truth))
        again = kept_trace(scene, SAMPLES_PER_PIXEL, 5, out_dir / "path-traced")
        noise = picture_error(again, truth[scene])
        results["reference_noise"] = noise
        ms, error = path_tracer_at_equal_time(truth)
        summary["path tracer, 4 samples"] = (ms, error.psnr_db, error.psnr_db, 100 * error.mean)
        print(
            f"two path-traced pictures of {SAMPLES_PER_PIXEL} samples: {noise.psnr_db:.1f} dB, SSIM {noise.ssim:.4f}"
        )
    print_table(
        "Error against time, matt scenes, 320×240, i0's time",
        ["way", "ms a frame", "PSNR dB median", "PSNR dB worst", "mean error %"],
        [[way, *values] for way, values in summary.items()],
    )
    results["summary"] = summary
    plot_frontier(
        out_dir / "render.png",
        [
            Point("gelgap" if way in QUALITIES else way, way, values[0] / 1e3, values[3])
            for way, values in summary.items()
        ],
        title="Rendering a matt membrane at 320×240: error against time",
        error_label="mean error in linear light, %",
        time_label="run time a frame, s",
        targets=(2.0,),
    )
    write_json(out_dir / "render.json", results)
    print(
        f"wrote {out_dir}/render.json, render.png and render-contact-sheet.png; presets in {asset_path('sensors')}"
    )
