"""One sound file of every kind that gelgap reads, made in seconds."""

import os
import shutil
from pathlib import Path

import numpy as np

from gelgap.assets import asset_path
from gelgap.benchmarks.adaptation.study import ORACLES, grid, write_results
from gelgap.benchmarks.common import run_missing
from gelgap.benchmarks.common.kept_results import kept_result

DOMAIN = "mb0i0"
RUN_EPOCHS = 1
FRAMES = 12
SIZE_PX = (64, 48)
_SWEEP = """base = "mb0i0"
path = "smoke"

[[factors]]
field = "elastomer.young_modulus_mpa"
change = "scale"
values = [0.5, 2.0]
"""
_PRESSES = """[[presses]]
picture = "0.png"
sphere_diameter_mm = 3.0
depth_mm = 0.6
"""


def make_sound_files(folder: Path) -> None:
    """Write the files below a folder; solves go to its own cache, decoded pictures beside the data."""
    from gelgap.domains import open_domain

    os.environ["GELGAP_CACHE"] = str(folder / "cache")
    _generated(folder / "data")
    _membrane(folder)
    _pictures(folder / "pictures")
    _published(folder / "published")
    _runs(folder)
    _settings(folder / "settings")
    _records(folder / "records")
    del os.environ["GELGAP_CACHE"]
    open_domain(folder / "pictures").images()
    os.environ["GELGAP_CACHE"] = str(folder / "cache")


def picture(number: int) -> np.ndarray:
    """Return a picture in which a spot of light tells the number, (h, w, 3) uint8."""
    width, height = SIZE_PX
    y, x = np.mgrid[0:height, 0:width]
    spot = 80 * np.exp(-((x - 8 - 2 * number) ** 2 + (y - 16) ** 2) / 30)
    noise = np.random.default_rng(number).normal(0, 1, (height, width, 3))
    return (100 + spot[..., None] + noise).clip(0, 255).astype(np.uint8)


def _force_n(number: int) -> tuple[float, float, float]:
    return 0.01 * number, -0.02 * number, -0.1 * number


def _generated(folder: Path) -> None:
    from gelgap.domains import generate
    from gelgap.sim import ContactPath

    path = ContactPath("sound", (-0.75, 0.75), (0.0,), (0.2,), (0.1,), (0.0, 90.0, 180.0, 270.0))
    settings = {"quality": "draft", "render_quality": "draft", "size_px": (80, 60)}
    generate([DOMAIN], path, folder, scheduler="synchronous", **settings)


def _membrane(folder: Path) -> None:
    from gelgap.sim import MembraneState, grid_axes

    x_mm, y_mm = grid_axes()
    squared = x_mm**2 + y_mm[:, None] ** 2
    displacement_mm = np.zeros((len(y_mm), len(x_mm), 3), np.float32)
    displacement_mm[..., 2] = -0.5 * np.exp(-squared / 2)
    (folder / "membrane").mkdir(parents=True, exist_ok=True)
    force_n = np.array([0.0, 0.1, -0.7])
    state = MembraneState(x_mm, y_mm, displacement_mm, squared < 1, force_n, 1.0)
    state.save(folder / "membrane" / "state.npz")


def _pictures(folder: Path) -> None:
    from gelgap.domains.formats.pictures import encode_png

    folder.mkdir(parents=True)
    lines = ["image,fx_n,fy_n,fz_n"]
    for number in range(FRAMES):
        (folder / f"{number}.png").write_bytes(encode_png(picture(number)))
        lines.append(",".join(map(str, (f"{number}.png", *_force_n(number)))))
    (folder / "reference.png").write_bytes(encode_png(picture(0)))
    (folder / "table.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _published(folder: Path) -> None:
    from gelgap.domains.formats.pictures import encode_jpeg

    lines = ["Fx(N),Fy(N),Fz(N),label"]
    (folder / "train" / "images").mkdir(parents=True)
    (folder / "train" / "forcePosition").mkdir()
    for number in range(FRAMES):
        (folder / "train" / "images" / f"{number}.jpg").write_bytes(encode_jpeg(picture(number)))
        lines.append(",".join(map(str, (*_force_n(number), number))))
    (folder / "ref.jpg").write_bytes(encode_jpeg(picture(0)))
    table = folder / "train" / "forcePosition" / "force.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _runs(folder: Path) -> None:
    """Write a finished run with its stage 1, a checkpoint of training, and weights as torchvision saves them."""
    import torch

    from gelgap.adapt import Profile, adapt_frames, make_network, train_source
    from gelgap.domains import open_domain

    profile = small_profile()
    source, target = open_domain(folder / "pictures"), open_domain(folder / "published")
    (run,) = adapt_frames(source, target, ["source-only"], profile, out_dir=folder / "runs")
    run.folder.rename(folder / "runs" / "run")
    (stage1,) = (folder / "runs" / "stage1").glob("*.pt")
    shutil.move(stage1, folder / "runs" / "stage1.pt")
    shutil.rmtree(folder / "runs" / "stage1")
    train_source(source, Profile(**profile.model_dump()), resume_file=folder / "runs" / "resume.pt")
    network = make_network(profile, 2, seed=0)
    torch.save(network.backbone.state_dict(), folder / "runs" / "weights.pt")
    for kept in (folder / "pictures", folder / "published"):
        shutil.rmtree(kept / ".cache", ignore_errors=True)


def small_profile() -> "Profile":  # noqa: F821
    """Return the profile of the run: one epoch of a narrow network."""
    from gelgap.adapt import Profile

    return Profile(
        name="sound",
        width=0.125,
        feature_dim=8,
        image_size_px=SIZE_PX,
        pairing="difference",
        batch_size=4,
        source_epochs=RUN_EPOCHS,
        adapt_epochs=RUN_EPOCHS,
        source_holdout=0.3,
    )


def _settings(folder: Path) -> None:
    folder.mkdir(parents=True)
    for kind, name in (("sensors", "digit-like"), ("illuminations", "i1"), ("paths", "smoke")):
        shutil.copy(asset_path(kind, f"{name}.toml"), folder / f"{kind}.toml")
    (folder / "sweep.toml").write_text(_SWEEP, encoding="utf-8")
    (folder / "presses.toml").write_text(_PRESSES, encoding="utf-8")
    from gelgap.domains.formats.pictures import encode_png

    (folder / "0.png").write_bytes(encode_png(picture(0)))


def _records(folder: Path) -> None:
    folder.mkdir(parents=True)
    runs = grid([("paired", ("mb0i0", "wmb1i1"))], ["dsan"], range(8))
    run_missing(lambda run: {"mae_n": (0.1, 0.2, 0.3)}, runs, folder / "runs.jsonl", workers=1)
    oracles = {"pose_n": (0.1, 0.1, 0.2), "geometry_n": (0.2, 0.2, 0.3)}
    write_results(folder / ORACLES, {"mb0i0 → wmb1i1": oracles})
    kept_result(folder / "solved.result", kept_array)


def kept_array() -> np.ndarray:
    """Return what a benchmark keeps."""
    return np.linspace(0, 1, 500)
