"""Shards that someone planted with their checksums: refused in one sentence, without the memory they ask for."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hostile_bytes import png_that_claims
from valid_files import DOMAIN

from gelgap.domains import export, open_domain, verify_domain
from gelgap.domains.formats.domain_folder import DomainFolder, sha256
from gelgap.domains.formats.shards import PICTURE, POINTS

# Reads a valid domain, then the others with little more memory than that took, and prints what became of each.
READER = """
import json, resource, sys
from gelgap.domains import open_domain

def read(folder):
    frames = open_domain(folder)
    frames.picture(0)
    for column in frames.optional_columns:
        frames.optional(column, 0)

def peak_mib():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

read(sys.argv[1])
before = peak_mib()
with open("/proc/self/status") as status:
    data_kib = int(next(line for line in status if line.startswith("VmData")).split()[1])
resource.setrlimit(resource.RLIMIT_DATA, (1024 * data_kib + 2**28,) * 2)
found = []
for folder in sys.argv[2:]:
    try:
        read(folder)
        found.append(None)
    except RuntimeError as error:
        found.append(str(error))
print(json.dumps([found, peak_mib() - before]))
"""


def with_column(table: pa.Table, name: str, cells: pa.Array) -> pa.Table:
    index = table.schema.get_field_index(name)
    return table.set_column(index, name, cells) if index >= 0 else table.append_column(name, cells)


def strings(table: pa.Table) -> pa.Table:
    """Return 4000 rows that repeat a word of a megabyte."""
    rows = table.take(pa.array([0] * 4000))
    word = pa.DictionaryArray.from_arrays(pa.array([0] * len(rows), pa.int32()), ["x" * 2**20])
    return with_column(rows, "split", word)


def pictures(table: pa.Table) -> pa.Table:
    """Return pictures of 16 MiB each, all zeros."""
    cells = [pa.array([bytes(2**24)] * len(table)), pa.nulls(len(table), pa.string())]
    return with_column(table, "image", pa.StructArray.from_arrays(cells, fields=list(PICTURE)))


def points(table: pa.Table) -> pa.Table:
    """Return a frame with ten million markers, none of which is anywhere."""
    number = 10**7
    offsets = pa.array([0] + [number] * len(table), pa.int32())
    return with_column(
        table,
        "marker_px",
        pa.ListArray.from_arrays(offsets, pa.nulls(number, POINTS.value_type), type=POINTS),
    )


def rows(table: pa.Table) -> pa.Table:
    """Return a quarter of a million rows of nothing."""
    return pa.table([pa.nulls(250_000, field.type) for field in table.schema], schema=table.schema)


def nested(table: pa.Table) -> pa.Table:
    kind = pa.string()
    for _ in range(90):
        kind = pa.list_(kind)
    return with_column(table, "split", pa.nulls(len(table), kind))


def unknown(table: pa.Table) -> pa.Table:
    return with_column(table, "more", pa.array(["x" * 2**20] * len(table)))


PLANTED: dict[str, tuple[Callable[[pa.Table], pa.Table], str]] = {
    "strings": (strings, "column split would take more memory"),
    "pictures": (pictures, "column image would take more memory"),
    "points": (points, "column marker_px would take more memory"),
    "rows": (rows, "it states 250000 rows"),
    "nested": (nested, ""),
    "unknown": (unknown, "its columns are not those of a domain"),
    "texts": (lambda table: with_column(table, "fx_n", pa.array(["x"] * len(table))), ""),
    "no pictures": (lambda table: table.drop_columns("image"), ""),
    "no cells": (lambda table: with_column(table, "image", pa.nulls(len(table), PICTURE)), ""),
}


def plant(folder: Path, change: Callable[[pa.Table], pa.Table]) -> Path:
    """Change the shard of a domain, and its manifest to it; return the shard."""
    domain = DomainFolder(folder)
    (shard,) = folder.glob("frames-*.parquet")
    changed = change(pq.read_table(shard))
    named = [name for name in changed.column_names if name == "split"] if change is strings else False
    pq.write_table(
        changed,
        shard,
        compression="zstd",
        use_dictionary=named,
        store_schema=change is points,
        dictionary_pagesize_limit=2**30,
    )
    manifest = domain.read_manifest()
    manifest["files"][shard.name] |= {"sha256": sha256(shard.read_bytes()), "bytes": shard.stat().st_size}
    if change is points:
        manifest["configuration"]["columns"] = ["marker_px"]
    domain.write_manifest(manifest)
    return shard


def test_hostile_shards_are_refused_within_the_memory_of_valid_ones(files: Path, tmp_path: Path) -> None:
    valid = files / "data" / DOMAIN
    folders = [Path(shutil.copytree(valid, tmp_path / name)) for name in PLANTED]
    shards = [plant(folder, change) for folder, (change, _) in zip(folders, PLANTED.values(), strict=True)]
    assert all(shard.stat().st_size < 2**21 for shard in shards)
    command = [sys.executable, "-c", READER, str(valid), *map(str, folders)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    sentences, more_mib = json.loads(done.stdout)
    for shard, sentence, (_, reason) in zip(shards, sentences, PLANTED.values(), strict=True):
        assert f"{shard} is damaged (" in sentence
        assert reason in sentence
        assert "generate" in sentence
        assert "--verify" in sentence
        assert "\n" not in sentence

    assert more_mib < 64


@pytest.mark.parametrize("change", [pictures, unknown])
def test_no_hostile_shard_is_exported(files: Path, tmp_path: Path, change: Callable) -> None:
    shard = plant(files / "data" / DOMAIN, change)
    with pytest.raises(RuntimeError, match=f"{shard.name} is damaged"):
        export(files / "data" / DOMAIN, "huggingface", tmp_path / "out")


def test_a_picture_bomb_that_its_manifest_vouches_for_is_found(
    files: Path, refused: Callable[..., str]
) -> None:
    def with_bomb(table: pa.Table) -> pa.Table:
        cells = [cell and cell["bytes"] for cell in table["image"].to_pylist()]
        cells[1] = png_that_claims(60_000, 60_000)
        parts = [pa.array(cells), pa.nulls(len(cells), pa.string())]
        return with_column(table, "image", pa.StructArray.from_arrays(parts, fields=list(PICTURE)))

    folder = files / "data" / DOMAIN
    assert verify_domain(folder) == ()
    shard = plant(folder, with_bomb)
    with pytest.raises(ValueError, match="3600000000 pixels") as on_reading:
        open_domain(folder).picture(1)
    (damage,) = verify_domain(folder)
    reason = "3600000000 pixels"
    assert reason in str(on_reading.value)
    assert f"{shard.name}: frame 1: " in str(damage)
    assert reason in str(damage)
    assert "with --overwrite" in refused("inspect", folder, "--verify", code=1)
