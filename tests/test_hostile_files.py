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
from valid_files import DOMAIN, KINDS

from gelgap.assets.checksums import with_checksum
from gelgap.domains.formats.domain_folder import DomainFolder

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


# By kind, each file with what is in it.
CONTENTS: dict[str, dict[str, bytes | Callable[[Path], bytes]]] = {
    "membrane": {
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
    "manifest": {
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
    "run record": {
        "deep": DEEP.encode(),
        "a list": b"[]",
        "a number": b"1",
        "name outside": run_with(source="../../x"),
        "absolute name": run_with(method="/x"),
        "texts for numbers": run_with(n_source="many"),
        "no evaluation": run_with(target_test=None),
        "evaluation as list": run_with(target_test=[1]),
        "no times": run_with(wall_s={}),
        "profile as text": run_with(profile="smoke"),
        "unfinished": b'{"key": "',
    },
    "predictions": {
        "pickles": lambda files: npz_of_bait(files, "target_true_n", "target_predicted_n"),
        "bare pickle": pickled,
        "huge shape": npz_that_claims((10**9, 3), "target_true_n"),
        "nothing": npz(),
        "not finite": predictions_with(target_features=np.full((3, 4), np.nan, np.float32)),
        "texts": predictions_with(target_true_n=np.array([["a", "b", "c"]])),
        "rows that do not fit": predictions_with(target_predicted_n=np.zeros((1, 3), np.float32)),
    },
    "stage 1": {
        "torch pickle": torch_bait,
        "bare pickle": pickled,
        "text": b"weights",
        "of another format": checkpoint_with(format=99),
        "huge classifier": checkpoint_with(n_classes=10**9),
        "no profile": checkpoint_with(profile="{}{"),
        "weights of other shapes": checkpoint_with(state={"classifier.weight": torch.zeros(361, 8)}),
        "range as text": checkpoint_with(force_range_n="wide"),
    },
    "weights": {
        "torch pickle": torch_bait,
        "bare pickle": pickled,
        "text": b"\x65weights",
        "an npz": membrane(),
        "numbers": checkpoint_with(),
    },
    "table": {
        "outside": table("../published/ref.jpg,0,0,0"),
        "outside, for Windows": table("..\\published\\ref.jpg,0,0,0"),
        "absolute": table("/etc/passwd,0,0,0"),
        "inside and out again": table("x/../../published/ref.jpg,0,0,0"),
        "no name": table(",0,0,0"),
        "no text": bytes(range(256)),
        "no numbers": table("0.png,a,b,c"),
        "a cell without end": b'image,fx,fy,fz\n"' + b"a" * 200_000,
    },
    "picture": {
        "a bomb": png_that_claims(60_000, 60_000),
        "no pixels": png_that_claims(0, 5),
        "another size": png_that_claims(4, 4),
        "half a header": b"\x89PNG\r\n\x1a\n\0\0",
        "a script": SCRIPT.encode(),
        "half a JPEG": b"\xff\xd8\xff\xe0\0\x10",
        "a bitmap without end": b"BM" + struct.pack("<I", 10**9),
    },
    "force.csv": {
        "no text": bytes(range(256)),
        "huge label": b"Fx(N),Fy(N),Fz(N),label\n" + b"0,0,0,1e300\n" * 12,
        "infinite label": b"Fx(N),Fy(N),Fz(N),label\n" + b"0,0,0,inf\n" * 12,
    },
    "sensor": {
        "deep": f"a = {DEEP}".encode(),
        "not a number": b"[camera]\nfield_of_view_mm = [nan, inf]",
        "unknown": b"run = 'rm -rf /'",
        "empty": b"",
        "no text": b"\xff\xfe",
    },
    "illumination": {"leds as text": b"leds = 'many'", "infinite": b"[[leds]]\ndrive = inf"},
    "path": {
        "numbers": b"trajectories = 3",
        "list of numbers": b"trajectories = [3]",
        "waypoints as a number": b"[[trajectories]]\nwaypoints_mm = 3",
        "endless": b"[random]\nnumber = 1000000000000",
        "pulling": b"points_x_mm=[0]\npoints_y_mm=[0]\ndepths_mm=[-1]\nradii_mm=[0]\nangles_deg=[0]",
    },
    "sweep": {
        "path outside": b"base = 'mb0i0'\npath = '../../secret.toml'",
        "absolute path": b"base = 'mb0i0'\npath = '/etc/secret.toml'",
        "name outside": b"base = 'mb0i0'\nname = '../x'",
    },
    "presses": {
        "picture outside": b"[[presses]]\npicture='../x.png'\nsphere_diameter_mm=3\ndepth_mm=1",
        "absolute picture": b"[[presses]]\npicture='/x.png'\nsphere_diameter_mm=3\ndepth_mm=1",
        "numbers": b"presses = [1]",
        "texts": b"[[presses]]\npicture='0.png'\nsphere_diameter_mm='3'\ndepth_mm=nan",
    },
}
CASES = [(kind, name) for kind, contents in CONTENTS.items() for name in contents]


@pytest.mark.parametrize(("name", "content"), CASES)
def test_a_hostile_file_ends_in_one_sentence_with_its_name(files: Path, name: str, content: str) -> None:
    kind, made = KINDS[name], CONTENTS[name][content]
    file = kind.file(files)
    file.write_bytes(made(files) if callable(made) else made)
    # Whoever plants a file in a run plants its checksum too.
    (files / "runs" / "run" / "SHA256SUMS").unlink()
    with pytest.raises((ValueError, RuntimeError, FileNotFoundError)) as refused:
        kind.read(file)
    sentence = str(refused.value)
    assert file.name in sentence
    assert "\n" not in sentence
    assert "allow_pickle" not in sentence
    assert type(refused.value).__module__ == "builtins"
    assert not (files / "bait").exists()
