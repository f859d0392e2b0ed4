"""Labels as data have them: any of them, each with a range; a reference and groups of their own; several data sets."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from real_clones import write_table

from gelgap.data import ArrayFrames, Labels, join_domains, open_domain, verify_domain, with_labels
from gelgap.data.frames.first_touch import trajectory_of
from gelgap.data.frames.folders import open_domains
from gelgap.data.frames.labels import covering
from gelgap.data.frames.run_labels import force_classes, labels_of_run
from gelgap.data.inspection import frame_notes, inspect_domain, write_overview


def folder_of(folder: Path, rows: list[dict], references: dict[str, int] | None = None) -> Path:
    """Write pictures of one grey level each, the number of their row times ten, and their table."""
    for number, row in enumerate(rows):
        write(folder / row.setdefault("picture", f"clips/{number}.png"), 10 * number)
    for name, level in (references or {"reference.png": 200}).items():
        write(folder / name, level)
    write_table(folder / "table.csv", rows)
    return folder


def write(path: Path, level: int, size: tuple[int, int] = (40, 32)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((size[1], size[0], 3), level, np.uint8))


def test_a_table_may_have_one_axis_alone(tmp_path: Path):
    data = open_domain(folder_of(tmp_path / "wedge", [{"fz_n": -3.0 * k} for k in range(5)]))
    assert data.labels == Labels(("fz_n",), ((-12.0, 0.0),))
    assert data.label_values.tolist() == [[0.0], [-3.0], [-6.0], [-9.0], [-12.0]]
    assert data[2].force_n is None
    assert data[2].labels == {"fz_n": -6.0}
    inputs, labels, _ = data.torch(32, "difference").batch([4])
    assert labels.tolist() == [[-12.0]]
    assert inputs[0, 0, 0, 0] == pytest.approx(4 * (40 - 200) / 255)
    with pytest.raises(ValueError, match="wedge has no label fx_n, fy_n; its labels: fz_n"):
        _ = data.force_n
    assert "  labels   Fz -12.000…0.000 N; 0 frames outside" in str(inspect_domain(tmp_path / "wedge"))


def test_without_forces_every_label_counts_and_its_range_covers_the_frames(tmp_path: Path):
    rows = [{"x_mm": -1.23 + k, "y_mm": 0.5, "mz_nmm": 7.0, "time_s": 0.1 * k} for k in range(4)]
    data = open_domain(folder_of(tmp_path / "balls", rows))
    assert data.labels.names == ("mz_nmm", "x_mm", "y_mm")
    np.testing.assert_allclose(data.labels.ranges, [(6.9, 7.1), (-1.3, 1.8), (0.4, 0.6)])
    assert data.columns["time_s"].tolist() == pytest.approx([0, 0.1, 0.2, 0.3])
    assert "  labels   Mz 7.000…7.000 N·mm, x -1.230…1.770 mm" in str(inspect_domain(tmp_path / "balls"))


@pytest.mark.parametrize(
    ("values", "start", "found"),
    [
        ([-1.0, -0.5], (-3.0, 0.0), (-3.0, 0.0)),
        ([-3.31, 0.02], (-3.0, 0.0), (-3.4, 0.1)),
        ([np.nan, 1.0, 2.0], None, (1.0, 2.0)),
        ([], None, (-0.1, 0.1)),
    ],
)
def test_a_range_moves_only_where_it_must(values, start, found):
    assert covering(np.array(values, float), start) == pytest.approx(found)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"fz_n": "inf"}, "column 'fz_n': every row must hold a finite number or nothing, .* holds 'inf'"),
        ({"fz_n": -1.0, "reference": "../rest.png"}, r"must be a path from .* to a picture in it, as rest"),
    ],
)
def test_what_a_table_lacks_is_named(tmp_path: Path, columns: dict, message: str):
    folder = folder_of(tmp_path / "wrong", [dict(columns)])
    with pytest.raises(ValueError, match=message):
        open_domain(folder)


def test_points_of_no_row_are_left_out_and_a_missing_one_is_unknown(tmp_path: Path):
    unnumbered = folder_of(tmp_path / "none", [{"fz_n": -1.0, "point_id": ""}] * 2)
    assert "point_id" not in open_domain(unnumbered).columns
    in_part = folder_of(tmp_path / "some", [{"fz_n": -1.0, "point_id": 3}, {"fz_n": -1.0, "point_id": ""}])
    assert open_domain(in_part).point_id.tolist() == [3, -1]


def test_trajectories_of_a_table_are_read_and_known_of_every_row_or_refused(tmp_path):
    rows = [{"fz_n": -1.0, "trajectory": 4, "step": step} for step in (1, 0)]
    frames = open_domain(folder_of(tmp_path / "all", rows))
    assert trajectory_of(frames).tolist() == [0, 0]
    assert frames.columns["step"].tolist() == [1, 0]
    in_part = open_domain(folder_of(tmp_path / "some", [*rows, {"fz_n": -1.0, "trajectory": "", "step": 0}]))
    with pytest.raises(ValueError, match="some: 1 of 3 rows lack trajectory_id; give all"):
        trajectory_of(in_part)


@pytest.mark.parametrize("empty", ["", "n/a", "-"])
def test_a_row_may_lack_a_label(tmp_path: Path, empty: str):
    folder = folder_of(tmp_path / "gaps", [{"fz_n": -1.0, "fx_n": empty}, {"fz_n": empty, "fx_n": empty}])
    data = open_domain(folder)
    np.testing.assert_array_equal(data.columns["fz_n"], [-1.0, np.nan])
    assert "fx_n" not in data.columns
    assert data.notes == (
        "no row has a value of 'fx_n': the column is left out",
        "1 of 2 rows have no value of 'fz_n'",
    )
    assert verify_domain(folder) == ()
    assert write_overview(folder, tmp_path / "page.html").is_file()


def test_every_row_may_name_its_rest_picture(tmp_path: Path):
    rows = [{"fz_n": -1.0, "reference": f"rest/{k // 2}.png"} for k in range(4)]
    data = open_domain(folder_of(tmp_path / "rows", rows, {"rest/0.png": 100, "rest/1.png": 130}))
    inputs = data.torch(32, "difference").inputs(np.arange(4))[:, 0, 0, 0] * 255 / 4
    assert inputs.tolist() == pytest.approx([0 - 100, 10 - 100, 20 - 130, 30 - 130])
    swapped = data.take(np.array([3, 0])).torch(32, "difference").inputs([0, 1])[:, 0, 0, 0] * 255 / 4
    assert swapped.tolist() == pytest.approx([30 - 130, 0 - 100])
    both = data.torch(32, "channels").inputs(np.arange(4))
    alone = open_domain(folder_of(tmp_path / "one", [{"fz_n": -1.0}] * 1, {"ref.png": 130})).torch(
        32, "channels"
    )
    assert (both[3, 3:] == alone.inputs([0])[0, 3:]).all()
    assert data.reference.mean() == 100


def test_a_clip_has_the_rest_picture_of_its_name(tmp_path: Path):
    rows = [{"fz_n": -1.0, "clip": clip} for clip in ("golf 1", "foam", "golf 1")]
    references = {"references/golf 1.png": 50, "references/foam.png": 60, "reference.png": 99}
    folder = folder_of(tmp_path / "clips", rows, references)
    data = open_domain(folder)
    assert data.references_at(32)[data.reference_id][:, 0, 0, 0].tolist() == [50, 60, 50]
    assert data.columns["clip"].tolist() == ["golf 1", "foam", "golf 1"]
    write(folder / "references" / "foam.png", 60, (20, 32))
    with pytest.raises(ValueError, match=r"foam.png is 20×32 px, the reference 40×32 px"):
        open_domain(folder).torch(32)
    assert "foam.png" in str(verify_domain(folder)[0])
    (folder / "references" / "foam.png").unlink()
    with pytest.raises(ValueError, match=r"names clip 'foam', which is not there: expected references/foam"):
        open_domain(folder)


def test_an_edited_table_is_another_data_set(tmp_path: Path):
    folder = folder_of(tmp_path / "edited", [{"fz_n": -1.0}, {"fz_n": -2.0}])
    before = open_domain(folder).digest
    (folder / "table.csv").write_text((folder / "table.csv").read_text().replace("-2.0", "-2.25"))
    assert open_domain(folder).digest != before


def arrays(name: str, level: int = 0, **columns) -> ArrayFrames:
    columns = {label: np.asarray(values) for label, values in columns.items()}
    n = len(next(iter(columns.values())))
    images = np.full((n, 32, 40, 3), level, np.uint8) + np.arange(n, dtype=np.uint8)[:, None, None, None]
    return ArrayFrames(name, images, np.full((32, 40, 3), level, np.uint8), None, **columns)


def undeclared(frames: ArrayFrames) -> ArrayFrames:
    frames.declares_ranges = False
    return frames


def test_both_domains_of_a_run_get_one_range_that_target_labels_do_not_move():
    source = undeclared(arrays("s", fz_n=[-1.0, -7.33], depth_mm=[0.2, 0.4]))
    target = undeclared(arrays("t", fz_n=[-1.0, -20.0], depth_mm=[0.1, 0.9]))
    labels, notes = labels_of_run(source, target, ["fz_n"], None)
    assert labels == Labels(("fz_n",), ((-7.4, 0.0),))
    assert "widened to -7.4 to 0 by source s" in notes[0]
    assert "1 of 2 frames of t have a label beyond the range (fz_n=-7.4:0)" in notes[1]
    given, notes = labels_of_run(source, target, ["fz_n"], {"fz_n": (-30.0, 0.0)})
    assert given.ranges == ((-30.0, 0.0),)
    assert notes == ()
    both = [with_labels(frames, given) for frames in (source, target)]
    assert [frames.labels for frames in both] == [given, given]
    assert both[0].digest != source.digest
    assert with_labels(source, source.labels) is source
    assert with_labels(both[0].take(np.array([1])), given).digest == both[0].take(np.array([1])).digest


def test_what_data_declare_is_kept():
    declared, wide = arrays("d", fz_n=[-1.0]), arrays("w", fz_n=[-1.0])
    wide.force_range_n = np.array([[-1, 1], [-1, 1], [-9, 0]])
    assert labels_of_run(declared, wide, ["fz_n"], None)[0].ranges == ((-9.0, 0.0),)
    deep = arrays("deep", fz_n=[-4.0])
    labels, notes = labels_of_run(deep, declared, ["fz_n"], None)
    assert labels.ranges == ((-3.0, 0.0),)
    assert "deep have a label beyond" in notes[0]
    with pytest.raises(ValueError, match="outside the declared range"):
        with_labels(deep, labels).check_labels()


@pytest.mark.parametrize(
    ("names", "ranges", "message"),
    [
        (["x_mm"], None, "data set t has no label x_mm; its labels: fz_n"),
        (["fz"], None, "label 'fz' is unknown; known labels: fx_n"),
        (["fz_n", "fz_n"], None, "one stands twice"),
        (["fz_n"], {"x_mm": (0, 1)}, "a range is given for x_mm, but the labels are fz_n"),
        (["fz_n"], {"fz_n": (0, -1)}, "the lower bound must be below the upper"),
    ],
)
def test_wrong_labels_are_refused(names, ranges, message):
    with pytest.raises(ValueError, match=message):
        labels_of_run(arrays("s", fz_n=[-1.0], x_mm=[1.0]), arrays("t", fz_n=[-1.0]), names, ranges)


def test_inspect_and_adapt_say_the_same_of_forces_that_pull(tmp_path: Path):
    folder = folder_of(tmp_path / "pulled", [{"fz_n": 0.5}, {"fz_n": -2.0}])
    note, *_ = frame_notes(open_domain(folder))
    assert note.startswith("1 frames have Fz > 0")
    assert note in inspect_domain(folder).notes


def test_classes_from_force_are_of_equal_size():
    force_n = np.random.default_rng(0).normal(size=120)
    frames = force_classes(arrays("s", fz_n=force_n), 12)
    assert np.bincount(frames.contact_class).tolist() == [10] * 12
    assert frames.n_classes == 12
    assert frames.has_classes
    assert (np.diff(frames.contact_class[np.argsort(force_n)]) >= 0).all()
    with pytest.raises(ValueError, match=r"classes from force = 1: must lie in \[2, 120\]"):
        force_classes(frames, 1)


def test_joined_data_sets_keep_their_references_and_pictures(tmp_path: Path):
    one, other = arrays("a", 40, fz_n=[-1.0, -2.0], x_mm=[0.0, 1.0]), arrays("b", 90, fz_n=[-5.0] * 3)
    other.force_range_n = np.array([[-1, 1], [-1, 1], [-9, 0]])
    joined = join_domains([one, other])
    assert (joined.name, len(joined)) == ("a+b", 5)
    assert set(joined.columns) == {"fz_n", "reference_id", "frame_id"}
    assert joined.labels.ranges == ((-9.0, 0.0),)
    assert joined.images((40, 32))[:, 0, 0, 0].tolist() == [40, 41, 90, 91, 92]
    assert [int(joined.picture(k)[0, 0, 0]) for k in range(5)] == [40, 41, 90, 91, 92]
    inputs = joined.torch((40, 32), "difference").inputs(np.arange(5))[:, 0, 0, 0] * 255 / 4
    assert inputs.tolist() == pytest.approx([0, 1, 0, 1, 2])
    assert join_domains([one]) is one
    assert join_domains([one] * 5).name == "a+4-more"
    with pytest.raises(ValueError, match="a, c share no label"):
        join_domains([one, arrays("c", depth_mm=[1.0])])
    folders = [folder_of(tmp_path / name, [{"fz_n": -1.0}] * 2) for name in ("p", "q")]
    assert open_domains(folders).name == "p+q"
    assert open_domains(folders[0]).name == "p"
