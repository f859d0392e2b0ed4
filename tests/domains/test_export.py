import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

from gelgap.assets.checksums import file_sha256
from gelgap.domains.formats.export import export
from gelgap.domains.frames.folders import open_domain


def test_the_papers_layout_is_read_back_with_the_same_labels(data: Path, tmp_path: Path):
    export(data / "wmb0i0", "paper", tmp_path / "out")
    original, back = open_domain(data / "wmb0i0"), open_domain(tmp_path / "out" / "wmb0i0")
    test = original.columns["split"] == "test"
    order = np.concatenate([np.flatnonzero(~test), np.flatnonzero(test)])
    assert np.array_equal(back.force_n, original.force_n[order])
    assert np.array_equal(back.contact_class, original.contact_class[order])
    assert np.abs(back.picture(3).astype(int) - original.picture(order[3])).mean() < 6
    unsplit = tmp_path / "out" / "wmb0i0" / "ori" / "images"
    assert len(list(unsplit.glob("*.jpg"))) == 26


def test_webdataset_tars_hold_pictures_and_labels_and_are_the_same_each_time(data: Path, tmp_path: Path):
    for name in ("one", "two"):
        export(data, "webdataset", tmp_path / name)
    files = sorted(path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*.*"))
    assert all(
        (tmp_path / "one" / path).read_bytes() == (tmp_path / "two" / path).read_bytes() for path in files
    )
    original = open_domain(data / "mb0i0")
    found = {}
    for path in (tmp_path / "one" / "mb0i0").glob("*.tar"):
        with tarfile.open(path) as tar:
            found |= {member.name: tar.extractfile(member).read() for member in tar}
    assert len(found) == 52
    index = int(np.flatnonzero(original.columns["frame_id"] == 7)[0])
    assert found["000007.png"] == original.encoded_picture(index)
    assert json.loads(found["000007.json"])["fz_n"] == original.force_n[index, 2]


def test_the_hugging_face_folder_loads_by_its_card(data: Path, tmp_path: Path):
    import datasets

    export(data, "huggingface", tmp_path / "out")
    loaded = datasets.load_dataset(str(tmp_path / "out"), "wmb0i0", cache_dir=str(tmp_path / "cache"))
    assert {name: len(part) for name, part in loaded.items()} == {"train": 16, "validation": 5, "test": 5}
    frame = loaded["test"][0]
    original = open_domain(data / "wmb0i0")
    index = int(np.flatnonzero(original.columns["frame_id"] == frame["frame_id"])[0])
    assert np.array_equal(np.asarray(frame["image"]), original.picture(index))
    card = (tmp_path / "out" / "README.md").read_text()
    assert "| wmb0i0 | 26 | 0 | " in card
    assert "-0.5 + 0.0001 × code" in card
    assert "`elastic_energy_mj`" in card


def test_the_croissant_metadata_names_every_file_and_column_and_is_valid(data: Path, tmp_path: Path):
    export(data, "huggingface", tmp_path / "out")
    metadata = json.loads((tmp_path / "out/croissant.json").read_text(encoding="utf-8"))
    files = {file["contentUrl"]: file["sha256"] for file in metadata["distribution"]}
    there = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").glob("*/*")}
    assert files.keys() == there
    assert files["mb0i0/reference.png"] == file_sha256(tmp_path / "out/mb0i0/reference.png")
    fields = {
        part["name"]: {field["name"]: field["description"] for field in part["field"]}
        for part in metadata["recordSet"]
    }
    assert fields["mb0i1/test"]["fz_n"] == "the same; ≤ 0 in compression, N"
    assert {"height_map", "marker_px", "residual"} <= fields["mb0i0/train"].keys()
    croissant = pytest.importorskip("mlcroissant")
    dataset = croissant.Dataset(jsonld=tmp_path / "out/croissant.json")
    assert not dataset.metadata.issues.errors
    (row, *others) = dataset.records("mb0i0/test")
    assert len(others) == 4
    original = open_domain(data / "mb0i0")
    index = int(np.flatnonzero(original.columns["frame_id"] == row["mb0i0/test/frame_id"])[0])
    assert row["mb0i0/test/fz_n"] == pytest.approx(original.force_n[index, 2])
    assert np.array_equal(np.asarray(row["mb0i0/test/image"]), original.picture(index))


def test_an_unknown_format_and_a_full_folder_are_refused(data: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="known formats: paper, webdataset, huggingface"):
        export(data, "lerobot", tmp_path / "out")
    (tmp_path / "something").touch()
    with pytest.raises(ValueError, match="is not empty"):
        export(data, "paper", tmp_path)
