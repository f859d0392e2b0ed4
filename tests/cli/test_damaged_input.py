"""What the commands say of files that are not what they should be: one sentence, the file, and what to do."""

from pathlib import Path

import pytest

from gelgap.cli.main import main
from gelgap.data import open_domain


def test_a_method_that_needs_classes_is_refused_before_work_on_data_without(files: Path, refused) -> None:
    places = ["--source", files / "pictures", "--target", files / "data" / "mb0i0", "--out", files / "out"]
    line = refused("adapt", *places, "--method", "source-only", "dsan")
    assert "method dsan needs contact classes, and source pictures has frames without one: choose" in line
    assert not list(files.glob("out/**/*.pt"))


@pytest.mark.parametrize("name", ["run.json", "predictions.npz"])
@pytest.mark.parametrize("content", [b"{", None])
def test_a_report_of_a_broken_run_says_which_and_what_to_do(files: Path, refused, name: str, content) -> None:
    path = files / "runs" / "run" / name
    if content is not None:
        path.write_bytes(content)
    elif name == "run.json":
        changed = path.read_bytes().replace(b'"seed": 0', b'"seed": 1')
        assert changed != path.read_bytes()
        path.write_bytes(changed)
    else:
        path.unlink()
    line = refused("report", files / "runs", code=1)
    assert str(path) in line
    assert f"delete the folder {path.parent} and run the same `gelgap adapt` again" in line


def test_unusable_real_data_are_told_without_advice_to_generate(files: Path, capsys, refused) -> None:
    folder = files / "pictures"
    (folder / "3.png").write_bytes(b"no picture")
    main(["inspect", str(folder)])
    assert "3.png" in capsys.readouterr().out
    line = refused("inspect", folder, "--verify", code=1)
    assert "pictures/3.png" in line
    assert "generate" not in line


def test_whole_real_data_is_verified(files: Path, capsys) -> None:
    main(["inspect", str(files / "pictures"), "--verify"])
    assert "every picture and force is readable" in capsys.readouterr().out


def test_a_damaged_manifest_gets_one_advice(files: Path, refused) -> None:
    manifest = files / "data" / "mb0i0" / "manifest.json"
    manifest.write_bytes(manifest.read_bytes().replace(b"mb0i0", b"mb0i1"))
    line = refused("inspect", files / "data" / "mb0i0", "--verify", code=1)
    assert line.count("generate") == 1
    assert "--overwrite" in line


def test_two_tables_are_named(files: Path, refused) -> None:
    (files / "pictures" / "old.csv").write_text("image,fx,fy,fz\n")
    assert "old.csv, table.csv" in refused("inspect", files / "pictures")


def test_an_undecodable_picture_is_named_with_its_place_and_how_to_find_others(files: Path, refused) -> None:
    picture = files / "pictures" / "3.png"
    picture.write_bytes(picture.read_bytes()[:-30])
    line = refused("export", files / "pictures", "--out", files / "out")
    assert "data set pictures: 3.png: frame 3 is not readable" in line
    assert "--verify" in line


def test_small_forces_leave_the_papers_range_as_it_is(files: Path) -> None:
    frames = open_domain(files / "pictures")
    assert frames.force_range_n.tolist() == [[-0.75, 0.75], [-0.75, 0.75], [-3.0, 0.0]]
    assert not [note for note in frames.notes if "range" in note]


def test_a_force_beyond_the_papers_range_widens_its_axis_alone(files: Path) -> None:
    table = files / "pictures" / "table.csv"
    rows = table.read_text().splitlines()
    table.write_text("\n".join([*rows[:-1], "11.png,0.81,0.7,-0.2"]))
    frames = open_domain(files / "pictures")
    assert frames.force_range_n.tolist() == [[-0.75, 0.9], [-0.75, 0.75], [-3.0, 0.0]]
