"""Hostile files for every reader: nothing in them runs, none leads out of its folder, all end in one sentence."""

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hostile_bytes import npz, npz_of_bait, pickled, png_that_claims, torch_bait

from gelgap.adapt import ForceModel, load_predictions, load_run
from gelgap.adapt.network import load_imagenet_weights
from gelgap.assets.checksums import with_checksum
from gelgap.benchmarks.adaptation.groups import ORACLES, load_oracles
from gelgap.benchmarks.data import file_kinds
from gelgap.benchmarks.data.sound_files import DOMAIN
from gelgap.cli.calibrate import read_presses
from gelgap.domains import Sweep, open_domain
from gelgap.domains.formats.domain_folder import DomainFolder
from gelgap.render import Illumination, Sensor
from gelgap.sim import MembraneState, load_path

SCRIPT = "<script>alert(1)</script>"
DEEP = "[" * 200_000


def npz_that_claims(shape: tuple[int, ...], *names: str) -> bytes:
    """Return an npz whose arrays state a shape that a few bytes cannot fill."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in names:
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(64))
    return buffer.getvalue()


def membrane(**changes: Any) -> bytes:
    arrays = {"x_mm": np.arange(4.0), "y_mm": np.arange(3.0), "displacement_mm": np.zeros((3, 4, 3))}
    return npz(**arrays | changes)


STATE = ("x_mm", "y_mm", "displacement_mm")


def manifest_with(**changes: Any) -> Callable[[Path], bytes]:
    """Return what makes the bytes of a manifest with a right checksum and hostile values."""

    def make(files: Path) -> bytes:
        manifest = DomainFolder(files / "data" / DOMAIN).read_manifest()
        return json.dumps(with_checksum(manifest | changes)).encode()

    return make


def run_with(**changes: Any) -> Callable[[Path], bytes]:
    """Return what makes the bytes of a run's record with hostile values."""

    def make(files: Path) -> bytes:
        content = json.loads((files / "runs" / "run" / "run.json").read_text())
        return json.dumps(content | changes).encode()

    return make


def predictions_with(**changes: Any) -> Callable[[Path], bytes]:
    def make(files: Path) -> bytes:
        with np.load(files / "runs" / "run" / "predictions.npz") as arrays:
            return npz(**dict(arrays) | changes)

    return make


def checkpoint_with(**changes: Any) -> Callable[[Path], bytes]:
    def make(files: Path) -> bytes:
        content = torch.load(files / "runs" / "stage1.pt", weights_only=True)
        buffer = io.BytesIO()
        torch.save(content | changes, buffer)
        return buffer.getvalue()

    return make


def table(*rows: str) -> bytes:
    return "\n".join(["image,fx_n,fy_n,fz_n", *rows]).encode()


def read_run(files: Path) -> None:
    load_predictions(load_run(files / "runs" / "run"))


def backbone() -> torch.nn.Module:
    from gelgap.adapt import make_network

    return make_network(file_kinds.small_profile(), 2, seed=0).backbone


# What reads the file, below the sound files; and each file with what is in it.
READERS: dict[str, tuple[str, Callable[[Path], Any], dict[str, bytes | Callable[[Path], bytes]]]] = {
    "membrane": (
        "membrane/state.npz",
        lambda files: MembraneState.load(files / "membrane" / "state.npz"),
        {
            "pickles": lambda files: npz_of_bait(files, *STATE),
            "bare pickle": pickled,
            "text": b"no npz",
            "huge shape": npz_that_claims((10**6, 10**6), *STATE),
            "negative shape": npz_that_claims((-1,), *STATE),
            "texts": membrane(x_mm=np.array(["a", "b", "c", "d"])),
            "complex": membrane(displacement_mm=np.zeros((3, 4, 3), complex)),
            "contact of another size": membrane(contact=np.zeros((9, 9), bool)),
            "a scalar": membrane(x_mm=np.array(1.0)),
        },
    ),
    "manifest": (
        f"data/{DOMAIN}/manifest.json",
        lambda files: open_domain(files / "data" / DOMAIN),
        {
            "deep": DEEP.encode(),
            "a list": b"[1, 2]",
            "null": b"null",
            "bytes": bytes(range(256)),
            "file outside": manifest_with(
                files={"../../pictures/frames-00000.parquet": {"sha256": "0" * 64, "bytes": 1}}
            ),
            "absolute file": manifest_with(files={"/etc/passwd": {"sha256": "0" * 64, "bytes": 1}}),
            "domain outside": manifest_with(domain="../../x"),
            "no files": manifest_with(files={}),
            "files as text": manifest_with(files="frames"),
            "entry without bytes": manifest_with(files={"frames-00000.parquet": {"sha256": "x"}}),
            "range not a number": manifest_with(force_range_n=[[float("nan"), 1], [0, 1], [0, 1]]),
            "range of texts": manifest_with(force_range_n="wide"),
            "configuration as list": manifest_with(configuration=[]),
            "complete as text": manifest_with(complete="yes"),
        },
    ),
    "run record": (
        "runs/run/run.json",
        read_run,
        {
            "deep": DEEP.encode(),
            "a list": b"[]",
            "a number": b"1",
            "name outside": run_with(source="../../x"),
            "absolute name": run_with(method="/tmp/x"),
            "texts for numbers": run_with(n_source="many"),
            "no evaluation": run_with(target_test=None),
            "evaluation as list": run_with(target_test=[1]),
            "no times": run_with(wall_s={}),
            "profile as text": run_with(profile="smoke"),
            "unfinished": b'{"key": "',
        },
    ),
    "predictions": (
        "runs/run/predictions.npz",
        read_run,
        {
            "pickles": lambda files: npz_of_bait(files, "target_true_n", "target_predicted_n"),
            "bare pickle": pickled,
            "huge shape": npz_that_claims((10**9, 3), "target_true_n"),
            "nothing": npz(),
            "not finite": predictions_with(target_features=np.full((3, 4), np.nan, np.float32)),
            "texts": predictions_with(target_true_n=np.array([["a", "b", "c"]])),
            "rows that do not fit": predictions_with(target_predicted_n=np.zeros((1, 3), np.float32)),
        },
    ),
    "model": (
        "runs/stage1.pt",
        lambda files: ForceModel.load(files / "runs" / "stage1.pt"),
        {
            "torch pickle": torch_bait,
            "bare pickle": pickled,
            "text": b"weights",
            "of another format": checkpoint_with(format=99),
            "huge classifier": checkpoint_with(n_classes=10**9),
            "no profile": checkpoint_with(profile="{}{"),
            "weights of other shapes": checkpoint_with(state={"classifier.weight": torch.zeros(361, 8)}),
            "range as text": checkpoint_with(force_range_n="wide"),
        },
    ),
    "weights": (
        "runs/weights.pt",
        lambda files: load_imagenet_weights(backbone(), files / "runs" / "weights.pt"),
        {
            "torch pickle": torch_bait,
            "bare pickle": pickled,
            "text": b"\x65weights",
            "an npz": membrane(),
            "numbers": checkpoint_with(),
        },
    ),
    "table": (
        "pictures/table.csv",
        lambda files: open_domain(files / "pictures"),
        {
            "outside": table("../published/ref.jpg,0,0,0"),
            "outside, for Windows": table("..\\published\\ref.jpg,0,0,0"),
            "absolute": table("/etc/passwd,0,0,0"),
            "inside and out again": table("x/../../published/ref.jpg,0,0,0"),
            "no name": table(",0,0,0"),
            "no text": bytes(range(256)),
            "no numbers": table("0.png,a,b,c"),
            "a cell without end": b'image,fx,fy,fz\n"' + b"a" * 200_000,
        },
    ),
    "picture": (
        "pictures/3.png",
        lambda files: open_domain(files / "pictures").picture(3),
        {
            "a bomb": png_that_claims(60_000, 60_000),
            "no pixels": png_that_claims(0, 5),
            "another size": png_that_claims(4, 4),
            "half a header": b"\x89PNG\r\n\x1a\n\0\0",
            "a script": SCRIPT.encode(),
            "half a JPEG": b"\xff\xd8\xff\xe0\0\x10",
            "a bitmap without end": b"BM" + struct.pack("<I", 10**9),
        },
    ),
    "force.csv": (
        "published/train/forcePosition/force.csv",
        lambda files: open_domain(files / "published"),
        {
            "no text": bytes(range(256)),
            "huge label": b"Fx(N),Fy(N),Fz(N),label\n" + b"0,0,0,1e300\n" * 12,
            "infinite label": b"Fx(N),Fy(N),Fz(N),label\n" + b"0,0,0,inf\n" * 12,
        },
    ),
    "sensor": (
        "settings/sensors.toml",
        lambda files: Sensor.load(files / "settings" / "sensors.toml"),
        {
            "deep": f"a = {DEEP}".encode(),
            "not a number": b"[camera]\nfield_of_view_mm = [nan, inf]",
            "unknown": b"run = 'rm -rf /'",
            "empty": b"",
            "no text": b"\xff\xfe",
        },
    ),
    "illumination": (
        "settings/illuminations.toml",
        lambda files: Illumination.load(files / "settings" / "illuminations.toml"),
        {"leds as text": b"leds = 'many'", "infinite": b"[[leds]]\ndrive = inf"},
    ),
    "path": (
        "settings/paths.toml",
        lambda files: load_path(str(files / "settings" / "paths.toml")),
        {
            "numbers": b"trajectories = 3",
            "list of numbers": b"trajectories = [3]",
            "waypoints as a number": b"[[trajectories]]\nwaypoints_mm = 3",
            "endless": b"[random]\nnumber = 1000000000000",
            "pulling": b"points_x_mm=[0]\npoints_y_mm=[0]\ndepths_mm=[-1]\nradii_mm=[0]\nangles_deg=[0]",
        },
    ),
    "sweep": (
        "settings/sweep.toml",
        lambda files: Sweep.load(files / "settings" / "sweep.toml"),
        {
            "path outside": b"base = 'mb0i0'\npath = '../../secret.toml'",
            "absolute path": b"base = 'mb0i0'\npath = '/etc/secret.toml'",
            "name outside": b"base = 'mb0i0'\nname = '../x'",
        },
    ),
    "presses": (
        "settings/presses.toml",
        lambda files: read_presses(files / "settings" / "presses.toml"),
        {
            "picture outside": b"[[presses]]\npicture='../x.png'\nsphere_diameter_mm=3\ndepth_mm=1",
            "absolute picture": b"[[presses]]\npicture='/x.png'\nsphere_diameter_mm=3\ndepth_mm=1",
            "numbers": b"presses = [1]",
            "texts": b"[[presses]]\npicture='0.png'\nsphere_diameter_mm='3'\ndepth_mm=nan",
        },
    ),
    "oracles": (
        f"records/{ORACLES}",
        lambda files: load_oracles(files / "records"),
        {"deep": DEEP.encode(), "texts": b'{"a": "b"}'},
    ),
}
CASES = [(reader, name) for reader, (_, _, contents) in READERS.items() for name in contents]


@pytest.mark.parametrize(("reader", "content"), CASES)
def test_a_hostile_file_ends_in_one_sentence_with_its_name(files: Path, reader: str, content: str) -> None:
    place, read, contents = READERS[reader]
    made = contents[content]
    (files / place).write_bytes(made(files) if callable(made) else made)
    # Whoever plants a file in a run plants its checksum too.
    (files / "runs" / "run" / "SHA256SUMS").unlink()
    with pytest.raises((ValueError, RuntimeError, FileNotFoundError)) as refused:
        read(files)
    sentence = str(refused.value)
    assert Path(place).name in sentence
    assert "\n" not in sentence
    assert "allow_pickle" not in sentence
    assert type(refused.value).__module__ == "builtins"
    assert not (files / "bait").exists()
