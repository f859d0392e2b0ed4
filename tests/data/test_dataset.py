import dataclasses
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from torch import Generator, equal
from torch.utils.data import DataLoader

from gelgap.assets.image_file import decode_image
from gelgap.data.formats.pictures import decode_column, encode_png, resized
from gelgap.data.frames.dataset import ArrayFrames
from gelgap.data.frames.folders import open_domain
from gelgap.data.frames.stored import clear_picture_cache
from gelgap.render import Camera
from gelgap.sim.estimate import Diagnostics


def test_frames_have_the_labels_of_their_pose(data: Path):
    frames = open_domain(data / "mb0i0")
    assert len(frames) == 26
    assert frames.reference.shape == (60, 80, 3)
    columns = frames.columns
    pressed = columns["depth_mm"] > 0
    assert (frames.contact_class[~pressed] == 0).all()
    assert np.array_equal(frames.contact_class[pressed], 1 + np.tile(np.arange(12), 2))
    assert np.isnan(columns["angle_deg"][~pressed]).all()
    assert (frames.force_n[pressed, 2] < 0).all()
    assert (frames.force_n[~pressed] == 0).all()
    towards_x = columns["shear_x_mm"] > 0.05
    assert (frames.force_n[towards_x, 0] > 0).all()
    assert set(columns["split"]) == {"train", "validation", "test"}
    assert len({*zip(columns["trajectory_id"], columns["step"], strict=True)}) == 26


def test_a_contact_darkens_or_brightens_only_its_neighbourhood(data: Path):
    frames = open_domain(data / "wmb0i0")
    right_point = frames.picture(20).astype(int) - frames.reference
    change = np.abs(right_point).sum(axis=2)
    # The second point is at x = 0.75 mm: 5 px right of the centre of 80 px over 12 mm.
    weights = np.where(change > 30, change, 0)
    assert abs((weights.sum(axis=0) @ np.arange(80)) / weights.sum() - 45) < 6


def test_inpainting_keeps_forces_and_takes_the_markers_away(data: Path):
    marked, inpainted = open_domain(data / "mb0i0"), open_domain(data / "wmb0i0")
    assert np.array_equal(marked.force_n, inpainted.force_n)
    dark = [int((frames.picture(3).max(axis=2) < 60).sum()) for frames in (marked, inpainted)]
    assert dark[0] > 100
    assert dark[1] == 0
    assert inpainted.manifest["configuration"]["inpainted_from"] == "mb0i0"


def test_optional_columns_are_there_when_asked_for_and_refused_when_not(data: Path):
    frames = open_domain(data / "mb0i0")
    height = frames.height_map_mm(4)
    assert height.shape == (60, 80)
    assert height.max() == pytest.approx(0.2, abs=0.03)
    assert frames.optional("contact_mask", 4).any()
    assert not frames.optional("contact_mask", 0).any()
    moved = frames.optional("marker_px", 4) - frames.optional("marker_px", 0)
    assert frames.optional("marker_rest_mm", 4).shape == moved.shape == (88, 2)
    assert 0 < np.nanmax(np.abs(moved)) < 2
    solved = {field.name for field in dataclasses.fields(Diagnostics)}
    assert solved <= frames.columns.keys()
    assert frames.columns["elastic_energy_mj"][frames.columns["depth_mm"] > 0].min() > 0
    assert frames.columns["iterations"].dtype == np.int32
    assert not solved & open_domain(data / "mb0i1").columns.keys()
    with pytest.raises(ValueError, match="without the column 'height_map'"):
        open_domain(data / "mb0i1").height_map_mm(0)


def test_the_cache_holds_area_means_and_survives_a_change_of_the_array(data: Path):
    frames = open_domain(data / "mb0i1")
    images = frames.images(40)
    assert images.shape == (26, 30, 40, 3)
    blocks = frames.picture(7).reshape(30, 2, 40, 2, 3).astype(float).mean(axis=(1, 3))
    assert np.abs(images[7] - blocks).max() <= 0.5 + 1e-9
    images[:] = 0
    assert open_domain(data / "mb0i1").images((40, 30)).any()
    assert np.array_equal(frames.images(), np.stack([frames.picture(index) for index in range(26)]))
    assert not list((data / "mb0i1" / ".cache").glob("*.tmp"))
    with pytest.raises(ValueError, match=r"160×120 px is not possible.*80×60"):
        frames.images(160)


@pytest.mark.parametrize("size_px", [(160, 120), (50, 37)])
def test_smaller_pictures_are_area_means_bit_for_bit(size_px: tuple[int, int]):
    picture = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)
    assert np.array_equal(
        resized(picture, size_px), cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA)
    )


def test_what_is_made_once_is_kept(data: Path, monkeypatch: pytest.MonkeyPatch):
    frames = open_domain(data / "mb0i0")
    kept, pictures = frames.references_at(40, markers=False), frames.images(40)
    assert frames.take(np.arange(3)).references_at(40, markers=False) is kept
    # A complete cache is read without its lock.
    monkeypatch.delattr("gelgap.data.frames.stored.key_lock")
    assert np.array_equal(open_domain(data / "mb0i0").images(40), pictures)


def test_opening_a_data_set_imports_no_heavy_package(data: Path):
    code = (
        "import sys\n"
        "from gelgap.data import open_domain\n"
        "open_domain(sys.argv[1])\n"
        "heavy = {'torch', 'mujoco', 'colour', 'pyrender', 'cv2', 'numba', 'scipy', 'dask'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    command = [sys.executable, "-c", code, str(data / "mb0i0")]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "[]\n"


def test_no_size_has_more_pixels_than_the_picture():
    with pytest.raises(ValueError, match="no more pixels in all"):
        resized(np.zeros((240, 320, 3), np.uint8), (320, 241))
    with pytest.raises(ValueError, match="not possible"):
        resized(np.zeros((240, 320, 3), np.uint8), (0, 100))


def test_a_read_only_folder_is_cached_for_the_user(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    shutil.copytree(data / "mb0i1", tmp_path / "read-only", ignore=shutil.ignore_patterns(".cache"))
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "user"))
    open_domain(tmp_path / "read-only").images(16)
    assert not (tmp_path / "read-only" / ".cache").exists()
    assert len(list((tmp_path / "user").rglob("images-16x12-*.npy"))) == 1


def test_pictures_without_markers_are_made_once_and_only_when_asked_for(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("GELGAP_CACHE")
    shutil.copytree(data / "mb0i0", tmp_path / "mb0i0", ignore=shutil.ignore_patterns(".cache"))
    frames = open_domain(tmp_path / "mb0i0")
    shown = frames.images(80)
    assert [path.name.split("-")[0] for path in (tmp_path / "mb0i0" / ".cache").glob("*.npy")] == ["images"]
    hidden = frames.images(80, markers=False)
    # The generated domain with inpainted markers has been made in the same way.
    np.testing.assert_array_equal(hidden, open_domain(data / "wmb0i0").images(80))
    assert (shown.max(axis=3) < 60).sum() > 1000
    assert not (hidden.max(axis=3) < 60).any()
    some = frames.take(np.array([5, 2]))
    monkeypatch.setattr("gelgap.data.frames.stored.write_kept_pictures", pytest.fail)
    np.testing.assert_array_equal(some.images(80, markers=False), hidden[[5, 2]])
    held = ArrayFrames("held", frames.images(), frames.reference, frames.force_n)
    np.testing.assert_array_equal(held.images((40, 30), markers=False)[3], resized(hidden[3], (40, 30)))


def test_pictures_in_which_no_marker_is_found_stay(data: Path):
    frames = open_domain(data / "wmb0i0")
    np.testing.assert_array_equal(frames.images(40, markers=False), frames.images(40))


def arrays(n: int = 6, **changes) -> ArrayFrames:
    rng = np.random.default_rng(0)
    force = np.stack([np.zeros(n), np.zeros(n), -np.arange(n) / n], axis=1)
    values = {
        "images": rng.integers(0, 256, (n, 6, 8, 3), dtype=np.uint8),
        "reference": np.zeros((6, 8, 3), np.uint8),
        "force_n": force,
        "contact_class": np.arange(n),
    }
    return ArrayFrames("own", **(values | changes))


def test_arrays_are_a_data_set_like_any_other():
    frames = arrays(x_mm=np.arange(6.0))
    assert (len(frames), frames.size_px, frames.has_classes) == (6, (8, 6), True)
    assert np.array_equal(frames[2].image, frames.images()[2])
    assert frames.point_id.tolist() == [-1] * 6
    assert frames.images((4, 3)).shape == (6, 3, 4, 3)
    reference, steps = np.ones((6, 8, 3), np.uint8), np.arange(6)
    others = (
        arrays(),
        arrays(),
        arrays(reference=reference),
        arrays(step=steps),
        arrays(camera=Camera.showing(9.0)),
    )
    assert len({own.digest for own in (frames, *others)}) == 5
    frames.check_labels()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": np.zeros((6, 6, 8, 3))}, r"images must be uint8 \(n, h, w, 3\), not float64"),
        ({"reference": np.zeros((3, 4, 3), np.uint8)}, r"reference has shape \(3, 4, 3\); 6 images need"),
        ({"reference": np.zeros((6, 8, 3))}, r"and the reference uint8, not float64"),
        ({"force_n": np.zeros((5, 3)).tolist()}, r"force_n has shape \(5, 3\); 6 images need \(6, 3\)"),
        ({"point_id": np.zeros(7, int)}, r"point_id has shape \(7,\)"),
        ({"force_range_n": np.ones((3, 2))}, r"must be \(3, 2\) with lower < upper"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(changes: dict, message: str):
    with pytest.raises(ValueError, match=message):
        arrays(**changes)


def test_labels_outside_what_is_declared_are_named():
    with pytest.raises(ValueError, match=r"1 of 6 frames .* frame 5, Fz = -0.8333 N, allowed \[-0.7, 0\]"):
        arrays(force_range_n=np.array([[-1, 1], [-1, 1], [-0.7, 0]])).check_labels()
    with pytest.raises(ValueError, match=r"contact_class spans 0…5, allowed 0…4"):
        arrays(n_classes=5).check_labels()


def test_taken_frames_are_a_data_set_of_their_own(data: Path):
    frames = open_domain(data / "mb0i0")
    some = frames.take(np.array([20, 3, 7]))
    assert np.array_equal(some.force_n, frames.force_n[[20, 3, 7]])
    assert np.array_equal(some.images((40, 30)), frames.images((40, 30))[[20, 3, 7]])
    assert np.array_equal(some[1].image, frames.picture(3))
    assert some.columns["frame_id"].tolist() == [20, 3, 7]
    nested = some.take(np.array([2, 0]))
    assert np.array_equal(nested.picture(0), frames.picture(7))
    assert (some.name, some.size_px) == (frames.name, frames.size_px)
    assert len({frames.digest, some.digest, nested.digest, frames.take(np.arange(3)).digest}) == 4
    assert some.digest == frames.take(np.array([20, 3, 7])).digest
    assert len(frames.take(np.array([], int))) == 0


def test_random_access_iteration_and_pickling_agree(data: Path):
    frames = open_domain(data / "mb0i0")
    other = pickle.loads(pickle.dumps(frames))
    in_order = [frame.image for frame in frames]
    for index in (25, 0, 13, -1):
        assert np.array_equal(other[index].image, in_order[index])
    with pytest.raises(IndexError):
        frames[26]


def test_it_opens_as_it_is_in_pandas_pyarrow_and_hugging_face(data: Path, tmp_path: Path):
    import datasets
    import pandas
    import pyarrow.dataset

    frames = open_domain(data / "mb0i0")
    folder = str(data / "mb0i0")
    table = pandas.read_parquet(folder, ignore_prefixes=["manifest", "reference", "."])
    assert np.array_equal(table[["fx_n", "fy_n", "fz_n"]].to_numpy(), frames.force_n)
    assert pyarrow.dataset.dataset(folder, exclude_invalid_files=True).count_rows() == 26
    loaded = datasets.load_dataset(folder, split="train", cache_dir=str(tmp_path))
    assert isinstance(loaded.features["image"], datasets.Image)
    assert np.array_equal(np.asarray(loaded[5]["image"]), frames.picture(5))
    assert np.asarray(loaded[5]["height_map"]).dtype.itemsize >= 2
    assert np.allclose(loaded[5]["marker_px"], frames.optional("marker_px", 5))


@pytest.mark.parametrize("shape", [(7, 5, 3), (7, 5)])
def test_png_is_lossless(shape: tuple[int, ...]):
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, shape, dtype=np.uint8)
    if len(shape) == 2:
        assert np.array_equal(decode_column(encode_png(picture)), picture)
        deep = rng.integers(0, 65536, shape, dtype=np.uint16)
        assert np.array_equal(decode_column(encode_png(deep)), deep)
    else:
        assert np.array_equal(decode_image(encode_png(picture)), picture)


def test_a_missing_data_set_says_what_was_looked_for(data: Path, tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"does not exist; expected a folder with manifest.json"):
        open_domain(tmp_path / "none")
    with pytest.raises(FileNotFoundError, match=r"did you mean mb0i0, mb0i1, wmb0i0"):
        open_domain(data)
    (tmp_path / "clip/images").mkdir(parents=True)
    (tmp_path / "clip/images/0.png").touch()
    with pytest.raises(FileNotFoundError, match=r"did you mean clip/images in it"):
        open_domain(tmp_path)


@pytest.mark.parametrize("pairing", ["channels", "stack", "difference"])
def test_torch_batches_are_pairs_of_normalised_pictures(data: Path, pairing: str):
    torch = pytest.importorskip("torch")
    frames = open_domain(data / "mb0i1")
    pairs = frames.take(np.arange(4, 20)).torch((40, 30), pairing)
    assert len(pairs) == 16
    inputs, forces, classes = next(iter(pairs.loader(batch_size=8, shuffle=False)))
    mean, std = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    pictures = frames.images((40, 30))[4] / 255, frames.references_at((40, 30))[0] / 255
    contact, reference = (((picture - mean) / std).transpose(2, 0, 1) for picture in pictures)
    expected = {
        "channels": np.concatenate([contact, reference], axis=0),
        "stack": np.concatenate([contact, reference], axis=1),
        "difference": 4 * (pictures[0] - pictures[1]).transpose(2, 0, 1),
    }[pairing]
    assert inputs.shape == (8, *expected.shape)
    assert np.allclose(inputs[0].numpy(), expected, atol=1e-5)
    assert np.allclose(forces.numpy(), frames.force_n[4:12])
    assert classes.dtype == torch.int64
    one, _, _ = pairs[0]
    assert torch.equal(one, inputs[0])


def test_a_plain_data_loader_gives_the_same_batches(data: Path):
    pairs = open_domain(data / "mb0i1").torch((40, 30))
    plain = DataLoader(pairs, 8, shuffle=True, num_workers=2, generator=Generator().manual_seed(3))
    batches = list(zip(plain, pairs.loader(batch_size=8, seed=3, workers=2), strict=True))
    assert len(batches) == 4
    assert all(equal(one, other) for pair in batches for one, other in zip(*pair, strict=True))


def test_a_chosen_cache_folder_is_used_and_cleared(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    shutil.copytree(data / "mb0i1", tmp_path / "copy", ignore=shutil.ignore_patterns(".cache"))
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    open_domain(tmp_path / "copy").images(32)
    assert not (tmp_path / "copy" / ".cache").exists()
    assert len(list((tmp_path / "cache" / "images").glob("*.npy"))) == 1
    assert clear_picture_cache() > 0
    assert not list((tmp_path / "cache" / "images").glob("*.npy"))


def test_a_notebook_shows_large_pictures_smaller_in_their_aspect() -> None:
    reference = np.zeros((180, 240, 3), np.uint8)
    frames = ArrayFrames("own", np.stack([reference, reference]), reference, np.zeros((2, 3)))
    shown = decode_image(frames._repr_png_())
    assert shown.shape == (120, 2 * 160, 3)
