"""Pictures: error against a path tracer, and run time per frame, for every quality level and for the baselines.

Errors are in linear light without a fitted gain (mean error) and in sRGB (PSNR, SSIM); stock pyrender alone has its
gain fitted, since its light has no unit.
"""

import hashlib
import statistics
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.kept_results import kept_result
from gelgap.benchmarks.common.tables import Point, plot_frontier, print_table, write_json
from gelgap.benchmarks.render.baselines import StockPyrender, without_shadows
from gelgap.benchmarks.render.path_tracer import stored_reference, trace
from gelgap.benchmarks.render.scenes import ALL_SCENES, STORED_SCENES, RenderScene
from gelgap.benchmarks.render.speed import baseline_times, inpainting, speed
from gelgap.render import MembraneRenderer
from gelgap.render.imaging import srgb_encode
from gelgap.render.renderer import QUALITIES

SIZE_PX = (320, 240)
SAMPLES_PER_PIXEL = 256


@dataclass(frozen=True)
class PictureError:
    """Mean error in linear light relative to the mean, PSNR in dB and SSIM in sRGB."""

    mean: float
    psnr_db: float
    ssim: float


def picture_error(linear: np.ndarray, reference: np.ndarray) -> PictureError:
    """Compare two linear pictures."""
    from skimage.metrics import structural_similarity

    picture, truth = srgb_encode(linear), srgb_encode(reference)
    return PictureError(
        mean=float(np.abs(linear - reference).mean() / reference.mean()),
        psnr_db=-10 * np.log10(max(float(np.mean((picture - truth) ** 2)), 1e-12)),
        ssim=float(structural_similarity(picture, truth, channel_axis=2, data_range=1)),
    )


def path_traced(scene: RenderScene, seed: int, folder: Path) -> np.ndarray:
    """Return a scene's path-traced picture from a file named by all that it depends on, or trace it anew."""
    text = f"{scene.sensor()!r} {scene.light()!r} {SIZE_PX} {SAMPLES_PER_PIXEL} {seed}".encode()
    key = hashlib.sha256(text + b"".join(array.tobytes() for array in scene.membrane())).hexdigest()[:16]

    def make() -> np.ndarray:
        picture = trace(scene, SIZE_PX, SAMPLES_PER_PIXEL, seed)
        print(f"  path-traced {scene.name}", flush=True)
        return picture

    return kept_result(folder / f"{key}.result", make)


def scene_errors(scene: RenderScene, reference: np.ndarray) -> tuple[dict[str, PictureError], np.ndarray]:
    """Return the error of every quality and baseline on a scene, and the linear picture at standard quality."""
    size_px, membrane = (reference.shape[1], reference.shape[0]), scene.membrane()
    renderers = {
        quality: MembraneRenderer(scene.sensor(), scene.light(), size_px, quality) for quality in QUALITIES
    }
    pictures = {name: renderer.linear(*membrane, markers=False) for name, renderer in renderers.items()}
    if scene.matt:
        pictures["no shadows"] = without_shadows(renderers["standard"], membrane)
        stock = StockPyrender(scene, size_px)
        pictures["stock pyrender, gain fitted"] = stock.fitted_linear(reference)
        stock.close()
    errors = {way: picture_error(picture, reference) for way, picture in pictures.items()}
    return errors, pictures["standard"]


def accuracy(truth: dict[RenderScene, np.ndarray], out_dir: Path) -> dict[str, dict[str, PictureError]]:
    """Print every quality's and baseline's error on every scene, and draw the contact sheet."""
    errors, sheet = {}, []
    for scene, reference in truth.items():
        errors[scene.name], picture = scene_errors(scene, reference)
        sheet.append((scene.name, reference, picture))
    print_table(
        "Error against the path tracer, linear light without a fitted gain",
        ["scene", "way", "PSNR dB", "SSIM", "mean error %"],
        [
            [name, way, error.psnr_db, error.ssim, 100 * error.mean]
            for name, found in errors.items()
            for way, error in found.items()
        ],
        note="targets at standard: matt 44 dB, 0.98, 2 %; glossy 38 dB",
    )
    draw_contact_sheet(out_dir / "render-contact-sheet.png", sheet)
    return errors


def draw_contact_sheet(path: Path, sheet: list[tuple[str, np.ndarray, np.ndarray]]) -> None:
    """Draw reference, ours and ten times the difference of each scene."""
    import cv2

    rows = []
    for name, reference, picture in sheet:
        truth, ours = srgb_encode(reference), srgb_encode(picture)
        row = np.hstack([truth, ours, np.clip(0.5 + 10 * (ours - truth), 0, 1)])
        row = cv2.resize(np.ascontiguousarray(row, np.float32), (960, 240), interpolation=cv2.INTER_NEAREST)
        row = np.ascontiguousarray((255 * row[..., ::-1]).astype(np.uint8))
        label = f"{name}: path tracer, standard, 10 x difference"
        cv2.putText(row, label, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
        rows.append(row)
    cv2.imwrite(str(path), np.vstack(rows))


def path_tracer_at_fewest_samples(scene: RenderScene, truth: np.ndarray) -> tuple[float, PictureError]:
    """Return ms and error of the path tracer with the fewest samples that it takes: 4 per pixel."""
    started = time.perf_counter()
    picture = trace(scene, SIZE_PX, 4, seed=9)
    return 1e3 * (time.perf_counter() - started), picture_error(picture, truth)


def run(quick: bool, out_dir: Path) -> None:
    """Measure errors and run times, print the tables and write JSON, a plot and a contact sheet to `out_dir`.

    `quick` compares with the stored path-traced pictures; otherwise all scenes are traced, and kept for a rerun.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    traced = out_dir / "path-traced"
    if quick:
        truth = {scene: stored_reference(scene) for scene in STORED_SCENES}
    else:
        truth = {scene: path_traced(scene, 0, traced) for scene in ALL_SCENES}
    errors = accuracy(truth, out_dir)
    repeats = 3 if quick else 31
    times, baselines = speed(repeats), baseline_times(repeats)
    results = {
        "errors": errors,
        "times_ms": times,
        "baseline_times_ms": baselines,
        "inpainting": inpainting(repeats),
    }
    matt = [found for found in errors.values() if "no shadows" in found]
    summary = {}
    for way, ms in ({name: times[f"320×240 {name} i0"]["typical"] for name in QUALITIES} | baselines).items():
        psnr_db = [found[way].psnr_db for found in matt]
        mean_percent = 100 * statistics.median(found[way].mean for found in matt)
        summary[way] = (ms, statistics.median(psnr_db), min(psnr_db), mean_percent)
    if not quick:
        scene = ALL_SCENES[0]
        noise = results["reference_noise"] = picture_error(path_traced(scene, 5, traced), truth[scene])
        ms, error = path_tracer_at_fewest_samples(scene, truth[scene])
        summary["path tracer, 4 samples"] = (ms, error.psnr_db, error.psnr_db, 100 * error.mean)
        print(f"two path-traced pictures: {noise.psnr_db:.1f} dB, SSIM {noise.ssim:.4f}")
    print_table(
        "Error against time, matt scenes, 320×240, i0's time",
        ["way", "ms per frame", "PSNR dB median", "PSNR dB worst", "mean error %"],
        [[way, *values] for way, values in summary.items()],
    )
    plot_frontier(
        out_dir / "render.png",
        [
            Point("gelgap" if way in QUALITIES else way, way, ms / 1e3, percent)
            for way, (ms, _, _, percent) in summary.items()
        ],
        title="Rendering a matt membrane at 320×240: error against time",
        error_label="mean error in linear light, %",
        time_label="run time per frame, s",
        targets=(2.0,),
    )
    write_json(out_dir / "render.json", results | {"summary": summary})
    print(f"wrote {out_dir}/render.json, render.png and render-contact-sheet.png")
