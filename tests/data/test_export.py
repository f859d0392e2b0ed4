"""Exports are read back with the loader of their own format, with the same labels and pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.cli.main import main
from gelgap.data.formats.export import export
from gelgap.data.frames.folders import open_domain
from gelgap.domains import generate
from gelgap.sim import ContactPath

SETTINGS = {"quality": "draft", "render_quality": "draft", "size_px": (80, 60)}


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
    assert "license: apache-2.0" in card
    assert "| wmb0i0 | 26 | 0 | " in card
    assert "-0.5 + 0.0001 × code" in card
    assert "`elastic_energy_mj`" in card


def test_an_unknown_format_and_a_full_folder_are_refused(data: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="known formats: paper, huggingface"):
        export(data, "lerobot", tmp_path / "out")
    with pytest.raises(ValueError, match=r"gelgap 0\.3\.0 was the last with format webdataset: huggingface"):
        export(data, "webdataset", tmp_path / "out")
    (tmp_path / "something").touch()
    with pytest.raises(ValueError, match="is not empty"):
        export(data, "paper", tmp_path)


def test_a_split_by_point_keeps_each_point_in_one_part_and_the_card_says_so(
    grid: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    import datasets

    arguments = ["--format", "huggingface", "--split-by", "point", "--license", "cc-by-4.0"]
    main(["export", str(grid), *arguments, "--out", str(tmp_path / "out")])
    loaded = datasets.load_dataset(str(tmp_path / "out"), "mb0i0", cache_dir=str(tmp_path / "cache"))
    points = {part: set(rows["point_id"]) for part, rows in loaded.items()}
    assert points.keys() == {"train", "validation", "test"}
    assert len(set.union(*points.values())) == sum(map(len, points.values()))
    assert all(set(rows["split"]) == {part} for part, rows in loaded.items())
    card = (tmp_path / "out" / "README.md").read_text()
    assert "No contact point is in two parts" in card
    assert "license: cc-by-4.0" in card


def test_the_layout_of_generated_frames_refuses_other_data_in_one_sentence(data: Path, tmp_path: Path):
    export(data / "wmb0i0", "paper", tmp_path / "published")
    with pytest.raises(ValueError, match="not in gelgap's format, which this export needs"):
        export(tmp_path / "published" / "wmb0i0", "huggingface", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_format_of_one_reference_refuses_several(tmp_path: Path):
    (tmp_path / "own").mkdir()
    for shade, name in enumerate(("a.png", "b.bmp", "rest-a.png", "rest-b.png")):
        cv2.imwrite(str(tmp_path / "own" / name), np.full((8, 8, 3), 10 * shade, np.uint8))
    rows = "image,reference,fx_n,fy_n,fz_n\na.png,rest-a.png,0,0,-1\nb.bmp,rest-b.png,0,0,-2\n"
    (tmp_path / "own" / "table.csv").write_text(rows)
    with pytest.raises(ValueError, match="own has several references, paper one"):
        export(tmp_path / "own", "paper", tmp_path / "paper")


@pytest.mark.parametrize(
    ("format_name", "license", "message"),
    [
        ("huggingface", "mine: all", "license 'mine: all' must be an identifier such as apache-2.0"),
        ("paper", "mit", "license 'mit' has no place in paper; huggingface has one"),
    ],
)
def test_a_licence_that_no_card_can_state_is_refused(data, tmp_path, format_name, license, message):
    with pytest.raises(ValueError, match=message):
        export(data, format_name, tmp_path / "out", license=license)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory, make) -> Path:
    """Six points of a press and drags in two directions, so that points can be told apart."""
    path = ContactPath("grid", (-2.25, -0.75, 0.75), (0.0, 1.3), (0.2,), (0.1,), (0.0, 90.0))
    out = tmp_path_factory.mktemp("grid")
    generate(("mb0i0",), path, out, scheduler="synchronous", **SETTINGS)
    return out / "mb0i0"
