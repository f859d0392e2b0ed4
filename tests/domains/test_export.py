import itertools
import json
import tarfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.assets.checksums import file_sha256
from gelgap.cli.main import main
from gelgap.domains import generate
from gelgap.domains.formats.export import MINI_SCHEMA, export
from gelgap.domains.frames.folders import open_domain
from gelgap.sim import ContactPath

SETTINGS = {"quality": "draft", "render_quality": "draft", "size_px": (80, 60)}
POSE = ("x_mm", "y_mm", "depth_mm", "shear_x_mm", "shear_y_mm")


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
    for name, split_by in {"one": None, "two": "given"}.items():
        export(data, "webdataset", tmp_path / name, split_by=split_by)
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
    assert {"height_map", "marker_px", "residual", "traction_n", "tz_n_mm"} <= fields["mb0i0/train"].keys()
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


def test_a_split_by_point_keeps_each_point_in_one_part_and_the_card_says_so(
    grid: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    import datasets

    main(
        [
            "export",
            str(grid),
            "--format",
            "huggingface",
            "--split-by",
            "point",
            "--out",
            str(tmp_path / "out"),
        ]
    )
    loaded = datasets.load_dataset(str(tmp_path / "out"), "mb0i0", cache_dir=str(tmp_path / "cache"))
    points = {part: set(rows["point_id"]) for part, rows in loaded.items()}
    assert points.keys() == {"train", "validation", "test"}
    assert len(set.union(*points.values())) == sum(map(len, points.values()))
    assert all(set(rows["split"]) == {part} for part, rows in loaded.items())
    assert "No contact point is in two parts" in (tmp_path / "out" / "README.md").read_text()


def test_feats_dictionaries_hold_pictures_and_forces_by_its_axes(data: Path, tmp_path: Path):
    """Read as FEATS reads them: every file of a part's folder, and the bounds of the training part beside them."""
    export(data / "mb0i0", "feats", tmp_path / "out")
    original = open_domain(data / "mb0i0")
    folder = tmp_path / "out" / "mb0i0"
    assert {part.name: len(list(part.iterdir())) for part in folder.glob("*/")} == {
        "train": 16,
        "val": 5,
        "test": 5,
    }
    bounds = np.load(folder / "normalization.npy", allow_pickle=True).item()
    for path in folder.glob("*/*.npy"):
        label = np.load(path, allow_pickle=True).item()
        (index,) = np.flatnonzero(original.columns["frame_id"] == int(path.stem))
        assert np.array_equal(label["gs_img"], original.picture(index))
        assert label["gs_img"].shape == (60, 80, 3)
        assert (label["f_x"], label["f_y"], label["f_z"]) == tuple(original.force_n[index] * (-1, -1, 1))
        if path.parent.name == "train":
            assert all(bounds[name]["min"] <= label[name] <= bounds[name]["max"] for name in ("f_x", "f_z"))
    assert bounds["gs_img"]["max"] <= 255


def test_feats_force_maps_are_the_forces_where_the_picture_shows_the_contact(data: Path, tmp_path: Path):
    export(data / "mb0i0", "feats", tmp_path / "out")
    original = open_domain(data / "mb0i0")
    for path in (tmp_path / "out" / "mb0i0").glob("*/*.npy"):
        label = np.load(path, allow_pickle=True).item()
        maps_n = np.stack([label[f"grid_{axis}"] for axis in "xyz"])
        assert maps_n.shape == (3, 24, 32)
        assert maps_n.sum(axis=(1, 2)) == pytest.approx([label[f"f_{axis}"] for axis in "xyz"], abs=1e-4)
        (index,) = np.flatnonzero(original.columns["frame_id"] == int(path.stem))
        if label["f_z"] < 0:
            row, column = np.unravel_index(maps_n[2].argmin(), (24, 32))
            change = np.abs(original.picture(index).astype(int) - original.reference).sum(axis=2)
            rows, columns = np.nonzero(change > 60)
            assert (row / 24, column / 32) == pytest.approx((rows.mean() / 60, columns.mean() / 80), abs=0.1)


def test_the_mini_pretrain_columns_load_beside_those_of_the_set(data: Path, tmp_path: Path):
    import datasets

    export(data / "mb0i0", "mini-pretrain", tmp_path / "out")
    files = {path.stem.partition("-")[0]: str(path) for path in (tmp_path / "out/mb0i0").glob("*.parquet")}
    loaded = datasets.load_dataset("parquet", data_files=files, cache_dir=str(tmp_path / "cache"))
    assert {part: len(rows) for part, rows in loaded.items()} == {"train": 16, "val": 5, "test": 5}
    assert loaded["train"].column_names == MINI_SCHEMA.names
    assert len(MINI_SCHEMA) == 30
    original, row = open_domain(data / "mb0i0"), loaded["test"][0]
    (index,) = np.flatnonzero(original.columns["frame_id"] == int(row["capture"].rpartition("_")[2]))
    assert [row[name] for name in ("f_x", "f_y", "f_z")] == pytest.approx(
        (original.force_n[index] * (-1, -1, 1)).tolist()
    )
    assert (row["indenter"], row["indenter_param"], row["domain"], row["markered"]) == (
        "sphere",
        "3",
        "sim",
        True,
    )
    assert row["quat_w"] is None
    picture = cv2.imdecode(np.frombuffer(row["image"], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(picture.astype(int) - original.picture(index)).mean() < 8


def test_lerobot_episodes_are_trajectories_and_its_metadata_agree_with_the_data(
    grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Read as LeRobot v3.0 reads: features of info.json over the data files, episodes by their first and last index."""
    import datasets
    import pandas as pd

    monkeypatch.setattr("gelgap.domains.formats.export._MOST_BYTES", 50_000)
    export(grid, "lerobot-v3", tmp_path / "out", split_by="point")
    root, original = tmp_path / "out" / "mb0i0", open_domain(grid)
    info = json.loads((root / "meta/info.json").read_text())
    assert (info["codebase_version"], info["total_frames"]) == ("v3.0", len(original))
    kinds = {
        name: datasets.Image()
        if feature["dtype"] == "image"
        else datasets.Value(feature["dtype"])
        if feature["shape"] == [1]
        else datasets.Sequence(datasets.Value(feature["dtype"]), length=feature["shape"][0])
        for name, feature in info["features"].items()
    }
    files = [str(path) for path in sorted(root.glob("data/*/*.parquet"))]
    rows = datasets.Dataset.from_parquet(files, features=datasets.Features(kinds), cache_dir=str(tmp_path))
    assert rows["index"][:] == list(range(len(original)))
    tasks = pd.read_parquet(root / "meta/tasks.parquet")
    assert tasks.iloc[0].name.startswith("press and drag: sphere 3 mm")
    episodes = pd.read_parquet(root / "meta/episodes/chunk-000/file-000.parquet")
    assert len(episodes) == info["total_episodes"] == len(np.unique(original.columns["trajectory_id"]))
    assert len(files) > 1
    for number, path in enumerate(files):
        inside = set(pd.read_parquet(path)["episode_index"])
        assert inside == set(episodes["episode_index"][episodes["data/file_index"] == number])
    seen_points = []
    for part, bounds in info["splits"].items():
        first, last = map(int, bounds.split(":"))
        assert last > first, part
        own = [
            rows[k]
            for e in range(first, last)
            for k in range(*episodes.iloc[e][["dataset_from_index", "dataset_to_index"]])
        ]
        seen_points.append({tuple(row["observation.state"][:2]) for row in own})
    assert len(set.union(*seen_points)) == sum(map(len, seen_points))
    for episode in episodes.itertuples():
        own = [rows[k] for k in range(episode.dataset_from_index, episode.dataset_to_index)]
        assert [row["frame_index"] for row in own] == list(range(episode.length))
        assert all(row["timestamp"] == pytest.approx(k / info["fps"]) for k, row in enumerate(own))
        assert all(a["action"] == b["observation.state"] for a, b in itertools.pairwise(own))
    place = {
        tuple(np.float32(pose)): k for k, pose in enumerate(np.stack([original.columns[n] for n in POSE], 1))
    }
    for row in (rows[5], rows[len(rows) - 1]):
        index = place[tuple(np.float32(row["observation.state"]))]
        assert row["observation.force"] == pytest.approx(original.force_n[index].tolist(), abs=1e-6)
        assert np.array_equal(np.asarray(row["observation.images.tactile"]), original.picture(index))
    stats = json.loads((root / "meta/stats.json").read_text())
    assert stats["observation.force"]["min"][2] == pytest.approx(original.force_n[:, 2].min())
    assert np.shape(stats["observation.images.tactile"]["mean"]) == (3, 1, 1)


def test_layouts_of_generated_frames_refuse_other_data_in_one_sentence(data: Path, tmp_path: Path):
    export(data / "wmb0i0", "paper", tmp_path / "published")
    with pytest.raises(ValueError, match="only generated domains are exported so"):
        export(tmp_path / "published" / "wmb0i0", "feats", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory, make) -> Path:
    """Six points of a press and drags in two directions, so that points can be told apart."""
    path = ContactPath("grid", (-2.25, -0.75, 0.75), (0.0, 1.3), (0.2,), (0.1,), (0.0, 90.0))
    out = tmp_path_factory.mktemp("grid")
    generate(("mb0i0",), path, out, scheduler="synchronous", **SETTINGS)
    return out / "mb0i0"
