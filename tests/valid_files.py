"""One valid file of every kind that people exchange, made in seconds, and how each is read."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from quick_solves import coarsen

from gelgap.adapt import ForceModel, Profile, adapt_folders, load_predictions, load_runs
from gelgap.adapt.network import load_imagenet_weights, make_network
from gelgap.assets import asset_path
from gelgap.calibrate.pictures import read_presses
from gelgap.data import open_domain
from gelgap.data.formats.pictures import encode_jpeg, encode_png
from gelgap.domains import Sweep, generate
from gelgap.render import Illumination, Sensor
from gelgap.sim import ContactPath, MembraneState, load_path
from gelgap.sim.membrane import grid_axes

DOMAIN = "mb0i0"
FRAMES = 12
SIZE_PX = (64, 48)
PROFILE = Profile(
    name="valid",
    width=0.125,
    feature_dim=8,
    image_size_px=SIZE_PX,
    pairing="difference",
    batch_size=4,
    source_epochs=1,
    adapt_epochs=1,
    source_holdout=0.3,
)
SWEEP = """base = "mb0i0"
path = "smoke"

[[factors]]
field = "elastomer.young_modulus_mpa"
change = "scale"
values = [0.5, 2.0]
"""
PRESSES = """[[presses]]
picture = "0.png"
sphere_diameter_mm = 3.0
depth_mm = 0.6
"""


def make_valid_files(folder: Path) -> None:
    """Write the files below a folder."""
    with pytest.MonkeyPatch.context() as patch:
        coarsen(patch)
        path = ContactPath("valid", (-0.75, 0.75), (0.0,), (0.2,), (0.1,), (0.0, 90.0, 180.0, 270.0))
        generate(
            [DOMAIN],
            path,
            folder / "data",
            quality="draft",
            render_quality="draft",
            size_px=(80, 60),
            scheduler="synchronous",
        )
    _membrane(folder / "membrane")
    _pictures(folder)
    _runs(folder)
    _settings(folder / "settings")


def picture(number: int) -> np.ndarray:
    """Return a picture in which a spot of light tells the number, (h, w, 3) uint8."""
    width, height = SIZE_PX
    y, x = np.mgrid[0:height, 0:width]
    spot = 80 * np.exp(-((x - 8 - 2 * number) ** 2 + (y - 16) ** 2) / 30)
    noise = np.random.default_rng(number).normal(0, 1, (height, width, 3))
    return (100 + spot[..., None] + noise).clip(0, 255).astype(np.uint8)


def _membrane(folder: Path) -> None:
    x_mm, y_mm = grid_axes()
    squared = x_mm**2 + y_mm[:, None] ** 2
    displacement_mm = np.zeros((len(y_mm), len(x_mm), 3), np.float32)
    displacement_mm[..., 2] = -0.5 * np.exp(-squared / 2)
    folder.mkdir()
    force_n = np.array([0.0, 0.1, -0.7])
    MembraneState(x_mm, y_mm, displacement_mm, squared < 1, force_n, 1.0).save(folder / "state.npz")


def _pictures(folder: Path) -> None:
    """Write the same pictures with forces as a folder with a table and in a published layout."""
    forces = [(0.01 * number, -0.02 * number, -0.1 * number) for number in range(FRAMES)]
    pictures, train = folder / "pictures", folder / "published" / "train"
    for place in (pictures, train / "images", train / "forcePosition"):
        place.mkdir(parents=True)
    for number in range(FRAMES):
        (pictures / f"{number}.png").write_bytes(encode_png(picture(number)))
        (train / "images" / f"{number}.jpg").write_bytes(encode_jpeg(picture(number)))
    (pictures / "reference.png").write_bytes(encode_png(picture(0)))
    (folder / "published" / "ref.jpg").write_bytes(encode_jpeg(picture(0)))
    listed = "".join(f"{number}.png,{x},{y},{z}\n" for number, (x, y, z) in enumerate(forces))
    (pictures / "table.csv").write_text(f"image,fx_n,fy_n,fz_n\n{listed}", encoding="utf-8")
    labelled = "".join(f"{x},{y},{z},{number}\n" for number, (x, y, z) in enumerate(forces))
    table = train / "forcePosition" / "force.csv"
    table.write_text(f"Fx(N),Fy(N),Fz(N),label\n{labelled}", encoding="utf-8")


def _runs(folder: Path) -> None:
    """Write a finished run, and weights as torchvision saves them."""
    runs = folder / "runs"
    source, target = open_domain(folder / "pictures"), open_domain(folder / "published")
    (run,) = adapt_folders(source, target, ["source-only"], PROFILE, out_dir=runs)
    run.folder.rename(runs / "run")
    torch.save(make_network(PROFILE, 2, seed=0).backbone.state_dict(), runs / "weights.pt")


def _settings(folder: Path) -> None:
    folder.mkdir()
    for kind, name in (("sensors", "digit-like"), ("illuminations", "i1"), ("paths", "smoke")):
        shutil.copy(asset_path(kind, f"{name}.toml"), folder / f"{kind}.toml")
    (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    (folder / "presses.toml").write_text(PRESSES, encoding="utf-8")
    (folder / "0.png").write_bytes(encode_png(picture(0)))


@dataclass(frozen=True)
class FileKind:
    """A kind of file: a pattern below the folder of the valid ones, and what gelgap reads such a file with."""

    pattern: str
    read: Callable[[Path], Any]

    def file(self, files: Path) -> Path:
        """Return the file of this kind."""
        return next(files.glob(self.pattern))


def read_frames(folder: Path) -> Any:
    """Return all that a data set holds."""
    frames = open_domain(folder)
    return frames.columns, frames.reference, [frames.picture(index) for index in range(len(frames))]


def read_runs(file: Path) -> Any:
    """Return all runs of the folder in which a file of one of them lies."""
    return [(repr(run), load_predictions(run)) for run in load_runs(file.parents[1])]


def read_weights(file: Path) -> Any:
    """Return a backbone with the weights of a file."""
    backbone = make_network(PROFILE, 2, seed=1).backbone
    load_imagenet_weights(backbone, file)
    return [value.numpy() for value in backbone.state_dict().values()]


KINDS: dict[str, FileKind] = {
    "membrane": FileKind("membrane/state.npz", MembraneState.load),
    "manifest": FileKind(f"data/{DOMAIN}/manifest.json", lambda file: read_frames(file.parent)),
    "shard": FileKind(f"data/{DOMAIN}/frames-*.parquet", lambda file: read_frames(file.parent)),
    "reference": FileKind(f"data/{DOMAIN}/reference.png", lambda file: read_frames(file.parent)),
    "run record": FileKind("runs/run/run.json", read_runs),
    "predictions": FileKind("runs/run/predictions.npz", read_runs),
    "model": FileKind("runs/run/model.pt", ForceModel.load),
    "weights": FileKind("runs/weights.pt", read_weights),
    "picture": FileKind("pictures/3.png", lambda file: read_frames(file.parent)),
    "table": FileKind("pictures/table.csv", lambda file: read_frames(file.parent)),
    "force.csv": FileKind(
        "published/train/forcePosition/force.csv", lambda file: read_frames(file.parents[2])
    ),
    "sensor": FileKind("settings/sensors.toml", Sensor.load),
    "illumination": FileKind("settings/illuminations.toml", Illumination.load),
    "path": FileKind("settings/paths.toml", lambda file: load_path(str(file))),
    "sweep": FileKind("settings/sweep.toml", Sweep.load),
    "presses": FileKind("settings/presses.toml", read_presses),
}
