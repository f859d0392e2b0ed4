"""Malformed files of every kind that people exchange: one sentence that names the file, and nothing in them runs."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from hostile_bytes import npz, npz_of_bait, png_that_claims, torch_bait
from valid_files import DOMAIN, KINDS

from gelgap.adapt import write_report
from gelgap.assets.checksums import SUMS, sha256, with_checksum
from gelgap.data import export, open_domain, verify_domain
from gelgap.data.formats.domain_folder import DomainFolder
from gelgap.data.formats.shards import PICTURE, POINTS
from gelgap.data.inspection import inspect_domain

DEEP = b"[" * 200_000
Content = bytes | Callable[[Path], bytes]
"""The bytes of a file, or what makes them from the folder of the valid ones."""


def npz_that_claims(shape: tuple[int, ...], *names: str) -> bytes:
    """Return an npz whose arrays state a shape that a few bytes cannot fill."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in names:
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(64))
    return buffer.getvalue()


STATE = ("x_mm", "y_mm", "displacement_mm")


def membrane(**changes: Any) -> bytes:
    arrays = {"x_mm": np.arange(4.0), "y_mm": np.arange(3.0), "displacement_mm": np.zeros((3, 4, 3))}
    return npz(**arrays | changes)


def manifest(**changes: Any) -> Content:
    """Return a manifest with a right checksum and wrong values."""

    def make(files: Path) -> bytes:
        content = DomainFolder(files / "data" / DOMAIN).read_manifest()
        return json.dumps(with_checksum(content | changes)).encode()

    return make


def run_record(**changes: Any) -> Content:
    def make(files: Path) -> bytes:
        return json.dumps(json.loads((files / "runs/run/run.json").read_text()) | changes).encode()

    return make


def checkpoint(**changes: Any) -> Content:
    def make(files: Path) -> bytes:
        content = torch.load(files / "runs/run/model.pt", weights_only=True)
        buffer = io.BytesIO()
        torch.save(content | changes, buffer)
        return buffer.getvalue()

    return make


def table(*rows: str) -> bytes:
    return "\n".join(["image,fx_n,fy_n,fz_n", *rows]).encode()


MALFORMED: dict[str, dict[str, Content]] = {
    "membrane": {
        "pickles": lambda files: npz_of_bait(files, *STATE),
        "huge shape": npz_that_claims((10**6, 10**6), *STATE),
        "texts": membrane(x_mm=np.array(["a", "b", "c", "d"])),
        "contact of another size": membrane(contact=np.zeros((9, 9), bool)),
    },
    "manifest": {
        "nested deeply": DEEP,
        "a list": b"[1, 2]",
        "file outside": manifest(
            files={"../../pictures/frames-00000.parquet": {"sha256": "0" * 64, "bytes": 1}}
        ),
        "domain outside": manifest(domain="../../x"),
        "no files": manifest(files={}),
        "range not a number": manifest(force_range_n=[[float("nan"), 1], [0, 1], [0, 1]]),
        "configuration as list": manifest(configuration=[]),
    },
    "run record": {
        "a list": b"[]",
        "name outside": run_record(source="../../x"),
        "text for a number": run_record(n_source="many"),
        "no evaluation": run_record(target_test=None),
        "profile as text": run_record(profile="smoke"),
    },
    "predictions": {
        "pickles": lambda files: npz_of_bait(files, "target_true_n", "target_predicted_n"),
        "no arrays": npz(),
    },
    "model": {
        "pickle": torch_bait,
        "another format": checkpoint(format=99),
        "huge classifier": checkpoint(n_classes=10**9),
        "no profile": checkpoint(profile="{}{"),
        "weights of other shapes": checkpoint(state={"classifier.weight": torch.zeros(361, 8)}),
    },
    "weights": {"no zip": b"\x65weights", "not a backbone": checkpoint()},
    "table": {
        "outside": table("x/../../published/ref.jpg,0,0,0"),
        "no text": bytes(range(256)),
        "a cell without end": b'image,fx,fy,fz\n"' + b"a" * 200_000,
    },
    "picture": {"a bomb": png_that_claims(60_000, 60_000), "no pixels": png_that_claims(0, 5)},
    "force.csv": {"huge label": b"Fx(N),Fy(N),Fz(N),label\n0,0,0,1e300\n"},
    "sensor": {
        "nested deeply": b"a = " + DEEP,
        "not a number": b"[camera]\nfield_of_view_mm = [nan, inf]",
        "no text": b"\xff\xfe",
    },
    "path": {
        "a list of numbers": b"trajectories = [3]",
        "endless": b"[random]\nnumber = 1000000000000",
        "pulling": b"points_x_mm=[0]\npoints_y_mm=[0]\ndepths_mm=[-1]\nradii_mm=[0]\nangles_deg=[0]",
    },
    "sweep": {"path outside": b"base = 'mb0i0'\npath = '../../secret.toml'"},
    "presses": {
        "picture outside": b"[[presses]]\npicture='../x.png'\nsphere_diameter_mm=3\ndepth_mm=1",
        "texts": b"[[presses]]\npicture='0.png'\nsphere_diameter_mm='3'\ndepth_mm=nan",
    },
}


@pytest.mark.parametrize(
    ("name", "content"), [(name, content) for name, contents in MALFORMED.items() for content in contents]
)
def test_a_malformed_file_ends_in_one_sentence_with_its_name(files: Path, name: str, content: str) -> None:
    kind, made = KINDS[name], MALFORMED[name][content]
    file = kind.file(files)
    file.write_bytes(made(files) if callable(made) else made)
    # Whoever changes a file of a run can change its checksum too.
    (files / "runs/run" / SUMS).unlink()
    with pytest.raises((ValueError, RuntimeError, FileNotFoundError)) as refused:
        kind.read(file)
    sentence = str(refused.value)
    assert file.name in sentence
    assert "\n" not in sentence
    assert "allow_pickle" not in sentence
    assert type(refused.value).__module__ == "builtins"
    assert not (files / "bait").exists()


@pytest.mark.parametrize(
    "name", ["membrane", "manifest", "shard", "reference", "run record", "predictions", "model", "picture"]
)
def test_a_copy_that_went_wrong_is_named(files: Path, name: str) -> None:
    kind = KINDS[name]
    file = kind.file(files)
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    for damaged in (bytes(flipped), whole[:-1], whole[: len(whole) // 2], b""):
        file.write_bytes(damaged)
        with pytest.raises((ValueError, RuntimeError), match=file.name):
            kind.read(file)


def test_a_changed_label_is_named(files: Path) -> None:
    """Parquet has no checksum of its own: only the manifest's tells it."""
    folder = files / "data" / DOMAIN
    (shard,) = folder.glob("frames-*.parquet")
    content = pq.read_table(shard)
    pq.write_table(with_column(content, "fx_n", pa.array([9.0] * len(content))), shard, use_dictionary=False)
    with pytest.raises(RuntimeError, match=rf"{shard.name} is damaged \(has other bytes"):
        open_domain(folder)


def with_column(shard: pa.Table, name: str, cells: pa.Array) -> pa.Table:
    index = shard.schema.get_field_index(name)
    return shard.set_column(index, name, cells) if index >= 0 else shard.append_column(name, cells)


def with_images(shard: pa.Table, images: list[bytes]) -> pa.Table:
    parts = [pa.array(images), pa.nulls(len(images), pa.string())]
    return with_column(shard, "image", pa.StructArray.from_arrays(parts, fields=list(PICTURE)))


def with_bomb(shard: pa.Table) -> pa.Table:
    images = [cell and cell["bytes"] for cell in shard["image"].to_pylist()]
    return with_images(shard, [images[0], png_that_claims(60_000, 60_000), *images[2:]])


def long_texts(shard: pa.Table) -> pa.Table:
    """Return 4000 rows that repeat a word of a megabyte."""
    rows = shard.take(pa.array([0] * 4000))
    word = pa.DictionaryArray.from_arrays(pa.array([0] * len(rows), pa.int32()), ["x" * 2**20])
    return with_column(rows, "split", word)


def many_markers(shard: pa.Table) -> pa.Table:
    """Return a frame with ten million markers, none of which is anywhere."""
    number = 10**7
    offsets = pa.array([0] + [number] * len(shard), pa.int32())
    cells = pa.ListArray.from_arrays(offsets, pa.nulls(number, POINTS.value_type), type=POINTS)
    return with_column(shard, "marker_px", cells)


def many_rows(shard: pa.Table) -> pa.Table:
    return pa.table([pa.nulls(250_000, field.type) for field in shard.schema], schema=shard.schema)


SHARDS: dict[str, tuple[Callable[[pa.Table], pa.Table], str]] = {
    "long texts": (long_texts, "column split would take more memory"),
    "many markers": (many_markers, "column marker_px would take more memory"),
    "many rows": (many_rows, "it states 250000 rows"),
    "texts for forces": (
        lambda shard: with_column(shard, "fx_n", pa.array(["x"] * len(shard))),
        "its columns are not those of a domain",
    ),
}


def sign(folder: Path, shard: Path, **changes: Any) -> None:
    """Let the manifest of a domain state a shard as it is now."""
    domain = DomainFolder(folder)
    content = domain.read_manifest() | changes
    content["files"][shard.name] |= {"sha256": sha256(shard.read_bytes()), "bytes": shard.stat().st_size}
    domain.write_manifest(content)


def replace_shard(folder: Path, change: Callable[[pa.Table], pa.Table]) -> Path:
    """Change the shard of a domain, and its manifest to it; return the shard."""
    (shard,) = folder.glob("frames-*.parquet")
    changed = change(pq.read_table(shard))
    dictionaries = ["split"] if change is long_texts else False
    pq.write_table(
        changed, shard, compression="zstd", use_dictionary=dictionaries, store_schema=change is many_markers
    )
    configuration = DomainFolder(folder).read_manifest()["configuration"]
    if change is many_markers:
        configuration["columns"] = ["marker_px"]
    sign(folder, shard, configuration=configuration)
    return shard


@pytest.mark.parametrize("name", SHARDS)
def test_a_shard_as_generation_never_writes_is_refused_before_it_takes_memory(files: Path, name: str) -> None:
    change, reason = SHARDS[name]
    folder = files / "data" / DOMAIN
    shard = replace_shard(folder, change)
    assert shard.stat().st_size < 2**21
    with pytest.raises(RuntimeError, match=rf"{shard.name} is damaged \({reason}.*generate.*--verify"):
        open_domain(folder)
    with pytest.raises(RuntimeError, match=f"{shard.name} is damaged"):
        export(folder, "huggingface", files / "out")


def test_a_picture_bomb_in_a_manifest_is_found(files: Path, refused: Callable[..., str]) -> None:
    folder = files / "data" / DOMAIN
    assert verify_domain(folder) == ()
    shard = replace_shard(folder, with_bomb)
    with pytest.raises(ValueError, match="more than 67108864 pixels"):
        open_domain(folder).picture(1)
    (damage,) = verify_domain(folder)
    assert f"{shard.name}: frame 1: " in str(damage)
    assert "more than 67108864 pixels" in str(damage)
    assert "with --overwrite" in refused("inspect", folder, "--verify", code=1)


def test_scripts_in_names_are_shown_and_not_run(files: Path) -> None:
    folder = files / "runs" / "run"
    (folder / SUMS).unlink()
    names = {"method": "<b>bold|${x}", "profile": {"name": "<img src=x onerror=alert(1)>"}}
    (folder / "run.json").write_bytes(run_record(**names)(files))
    page = write_report(files / "runs", files / "report")
    html = page.read_text()
    assert "<b>" not in html
    assert "<img src=x" not in html
    assert "&lt;b&gt;" in html
    assert {path.parent for path in (files / "report").rglob("*")} == {files / "report"}


def test_real_data_is_inspected_picture_by_picture(files: Path) -> None:
    folder = files / "pictures"
    (folder / "2.png").write_bytes(b"no picture")
    (folder / "4.png").write_bytes((folder / "4.png").read_bytes()[:-30])
    assert cv2.imwrite(str(folder / "5.png"), np.zeros((9, 9, 3), np.uint8))
    rows = (folder / "table.csv").read_text().splitlines()
    rows[7] = "6.png,nan,0,0"
    (folder / "table.csv").write_text("\n".join(rows))
    assert [(damage.file, damage.problem.split(":")[0]) for damage in verify_domain(folder)] == [
        ("2.png", "frame 2"),
        ("4.png", "frame 4"),
        ("5.png", "frame 5"),
    ]
    facts = str(inspect_domain(folder))
    assert "3 pictures cannot be used" in facts
    assert "1 of 12 rows have no value of" in facts
    assert "nan…" not in facts
