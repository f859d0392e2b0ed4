"""Training and adaptation on folders of pictures where what generates domains is not installed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.data.formats.pictures import encode_png

NOT_INSTALLED = (
    "mujoco",
    "pyrender",
    "OpenGL",
    "trimesh",
    "dask",
    "distributed",
    "lxml",
    "matplotlib",
    "colour",
)
IN_THIS_ENVIRONMENT = """
import sys
from importlib.abc import MetaPathFinder

class NotInstalled(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, NotInstalled())
try:
    import mujoco
except ModuleNotFoundError:
    from gelgap.cli.main import main

    main(sys.argv[1:])
"""
FRAMES = 24
PROFILE = """base = "smoke"
width = 0.125
feature_dim = 8
image_size_px = [64, 48]
batch_size = 8
source_epochs = 1
adapt_epochs = 1
"""


def pressed(share: float, light: float) -> np.ndarray:
    """Return a picture (48, 64, 3) in whose middle a dent of some depth changes the light."""
    y, x = np.mgrid[0:48, 0:64]
    dent = 90 * share * np.exp(-((x - 32) ** 2 + (y - 24) ** 2) / 60)
    return np.stack([light + dent, light - dent, np.full_like(dent, light)], axis=-1).astype(np.uint8)


def written(folder: Path, light: float) -> Path:
    """Write a folder of pictures and a table, as somebody without gelgap does."""
    folder.mkdir()
    shares = np.linspace(0, 1, FRAMES)
    (folder / "reference.png").write_bytes(encode_png(pressed(0, light)))
    for number, share in enumerate(shares):
        (folder / f"{number}.png").write_bytes(encode_png(pressed(share, light)))
    names = [f"{number}.png" for number in range(FRAMES)]
    pd.DataFrame({"image": names, "fz_n": -4 * shares}).to_csv(folder / "table.csv", index=False)
    return folder


def test_a_folder_of_pictures_is_adapted_to_without_mujoco_pyrender_and_dask(tmp_path: Path) -> None:
    source, target = written(tmp_path / "source", 110), written(tmp_path / "target", 140)
    (tmp_path / "small.toml").write_text(PROFILE)
    words = ["--source", source, "--target", target, "--method", "source-only", "adabn", "dan"]
    words += ["--profile", tmp_path / "small.toml", "--labels", "fz_n", "--range", "fz_n=-5:0"]
    code = IN_THIS_ENVIRONMENT.format(names=set(NOT_INSTALLED))
    command = [sys.executable, "-c", code, "adapt", *words, "--out", tmp_path / "runs"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert {"source-only", "adabn", "dan"} <= set(done.stdout.split()), done.stdout
    assert len(list((tmp_path / "runs").rglob("run.json"))) >= 3
