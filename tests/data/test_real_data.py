"""The published layout and picture folders, from a fixture written here."""

import csv
import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from real_clones import write_table

from gelgap.data import open_domain, verify_domain
from gelgap.data.frames.labels import known_labels
from gelgap.data.inspection import inspect_domain, write_overview


def picture(path: Path, level: int, size: tuple[int, int] = (64, 48)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    gradient = np.linspace(0, 40, size[0])[None, :, None] + np.full((size[1], 1, 3), level)
    assert cv2.imwrite(str(path), np.clip(gradient, 0, 255).astype(np.uint8))


def published(folder: Path, labels: bool = True, parts: tuple[str, ...] = ("train", "test", "ori")) -> Path:
    picture(folder / "ref.jpg", 100)
    for part in parts:
        rows = []
        for number in range(12):
            picture(folder / part / "images" / f"{number}.jpg", 10 * number)
            # Column order differs from the order in which forces are used; there is more than is needed.
            row = {"time": number, "Fz(N)": -0.2 * number, "Fx(N)": 0.01 * number, "Fy(N)": -0.01 * number}
            rows.append(row | ({"label": number + 355} if labels else {}))
        write_table(folder / part / "forcePosition" / "force.csv", rows)
    return folder


def test_rows_belong_to_pictures_by_number_and_columns_to_their_names(tmp_path: Path):
    data = open_domain(published(tmp_path / "wmb1i1"))
    assert len(data) == 24
    assert data.force_n[11] == pytest.approx([0.11, -0.11, -2.2])
    assert data.picture(10).mean() == pytest.approx(120, abs=2)
    assert data.columns["split"].tolist() == ["train"] * 12 + ["test"] * 12
    assert data.contact_class.tolist()[5:8] == [360, 0, 1]
    assert "running numbers" in " ".join(data.notes)
    assert "ori/ repeats" in " ".join(data.notes)
    assert data.images(32).shape == (24, 24, 32, 3)


def test_only_the_published_label_is_a_class_and_only_where_every_row_has_one(tmp_path: Path):
    folder = published(tmp_path / "wmb1i1", parts=("ori",))
    force = folder / "ori" / "forcePosition" / "force.csv"
    rows = [{"class": "firm"} | row for row in csv.DictReader(force.open())]
    write_table(force, rows)
    assert open_domain(folder).contact_class.tolist()[5:8] == [360, 0, 1]
    write_table(force, [rows[0] | {"label": ""}, *rows[1:]])
    assert not open_domain(folder).has_classes


def test_quirks_are_told(tmp_path: Path):
    folder = published(tmp_path / "inpainting", labels=False, parts=("ori",))
    force = folder / "ori" / "forcePosition" / "force.csv"
    force.write_text(force.read_text().replace("-2.2", "-4.2"))
    data = open_domain(folder)
    assert data.name == "wmb0i0"
    assert not data.has_classes
    notes = " ".join(data.notes)
    assert "no contact labels" in notes
    assert inspect_domain(folder).outside_range == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "test/images/11.jpg").unlink(), "11 pictures and 12 rows"),
        (
            lambda folder: (folder / "test/images/11.jpg").rename(folder / "test/images/12.jpg"),
            "12 pictures and 12 rows .* must match",
        ),
        (
            lambda folder: (folder / "test/forcePosition/force.csv").write_text("Fx,Fy\n1,2\n"),
            r"lacks one of the columns Fx\(N\)",
        ),
        (lambda folder: picture(folder / "test/images/0.jpg", 9, (32, 24)), r"frame 12 is 32×24 px.*64×48"),
    ],
)
def test_what_does_not_match_is_an_error(tmp_path: Path, change, message: str):
    folder = published(tmp_path / "wmb1i1")
    change(folder)
    with pytest.raises(ValueError, match=message):
        open_domain(folder).images(16)


def gelsight(folder: Path, reference: bool = True, **changes) -> Path:
    rows = []
    for number in range(6):
        picture(folder / "images" / f"shot{number}.png", 20 * number + 10)
        rows.append(
            {"Image": f"shot{number}.png", "Fx (N)": 0.1, "Fy (N)": 0.0, "Fz (N)": -0.7 * (5 - number)}
            | changes
        )
    if reference:
        picture(folder / "background.png", 99)
    write_table(folder / "labels.csv", rows)
    return folder


def test_a_picture_folder_is_read_by_column_names(tmp_path: Path):
    data = open_domain(gelsight(tmp_path / "mini"))
    assert data.force_n[0] == pytest.approx([0.1, 0, -3.5])
    assert data.picture(2).mean() == pytest.approx(70, abs=1)
    assert data.reference.mean() > 99
    assert data.force_range_n[2].tolist() == [-3.5, 0.0]
    assert "beyond the paper's range" in data.notes[0]


def test_without_a_reference_the_lightest_touch_takes_its_place(tmp_path: Path):
    data = open_domain(gelsight(tmp_path / "mini", reference=False))
    assert data.reference.mean() == pytest.approx(data.picture(5).mean())
    assert "frame 5" in data.notes[-1]


def test_the_digest_tells_cameras_and_uncompressed_pictures_of_one_size_apart(tmp_path: Path):
    digests = []
    for name, shade in (("one", 50), ("two", 60)):
        (tmp_path / name).mkdir()
        for file in ("0.bmp", "reference.bmp"):
            picture(tmp_path / name / file, shade)
            os.utime(tmp_path / name / file, (1e9, 1e9))
        digests.append(open_domain(tmp_path / name).digest)
    for mm_per_px in (0.05, 0.1):
        (tmp_path / "two" / "sensor.toml").write_text(f"mm_per_px = {mm_per_px}\n")
        digests.append(open_domain(tmp_path / "two").digest)
    assert len(set(digests)) == 4


def test_a_table_without_labels_is_an_unlabelled_domain(tmp_path: Path):
    folder = picture_folder(tmp_path / "named", "image,torque\n1.png,1\n0.png,2\n")
    picture(folder / "reference.png", 99)
    data = open_domain(folder)
    assert known_labels(data.columns) == ()
    assert data.picture(0).mean() > data.picture(1).mean()
    assert data.notes == (
        "columns that are not read: torque",
        "1 pictures have no row in the table: not read",
    )


def test_a_folder_of_pictures_alone_is_an_unlabelled_domain(tmp_path: Path):
    for number in (10, 9, 2, 1):
        picture(tmp_path / f"frame_{number}.png", number)
    picture(tmp_path / "reference.png", 99)
    for name in (".DS_Store", "Thumbs.db", "._frame_1.png", "a.webp", "b.webp", "labels.xlsx", "more/c.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"no picture")
    data = open_domain(tmp_path)
    assert list(data.columns) == ["frame_id"]
    assert [path.name for path in data.picture_paths] == [f"frame_{number}.png" for number in (1, 2, 9, 10)]
    assert data.notes == ("not read, beside 4 pictures without a table: 2 .webp, 1 .xlsx, 1 folders",)
    assert "labels   none" in str(inspect_domain(tmp_path))
    assert verify_domain(tmp_path) == ()
    assert "No frame has a label" in write_overview(tmp_path, tmp_path / "page.html").read_text()
    for lost, said in (("reference.png", "save labels.xlsx as CSV"), ("labels.xlsx", "no reference picture")):
        (tmp_path / lost).unlink()
        with pytest.raises(FileNotFoundError, match=said):
            open_domain(tmp_path)


@pytest.mark.parametrize(
    ("name", "problem"),
    [("reference.png", "is not a data set"), ("old.CSV", "column picture is needed; there are a, b")],
)
def test_what_is_no_folder_of_pictures_is_not_taken_for_one(tmp_path: Path, name: str, problem: str):
    picture(tmp_path / "reference.png", 99)
    (tmp_path / name).write_text("a,b\n1,2\n")
    with pytest.raises((FileNotFoundError, ValueError), match=problem):
        open_domain(tmp_path)


def picture_folder(folder: Path, text: str) -> Path:
    for number in range(3):
        picture(folder / f"{number}.png", 60 * number)
    (folder / "labels.csv").write_text(text)
    return folder


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("picture,fz_n\n0.png,0\n1.png,-0.5\n2.png,soft\n", "row 3 below the header holds 'soft'"),
        ("picture;fx;fz\n0.png;.1;0\n1.png;.1;-0,5\n", "row 2 below the header holds '-0,5'; write"),
        ("picture fz_n\n0.png 0\n1.png -0.5\n", "tabs must separate columns; its header is 'picture fz_n'"),
        ("picture;fz_mN\n0.png;-500\n1.png;-1,000\n", "'-1,000' may be a thousand or not: write -1000"),
        ("picture;fz_mN\n0.png;-500\n1.png;-1.000\n", "'-1.000' may be a thousand or not: write -1000 or"),
        ("picture;Kraft z [N]\n0.png;-0,5\n", "does not say which axis"),
        ("picture,fz_n\n0.png,0\n1.png,-0,5\n", "row 2 below the header has 3 cells, and the header 2"),
        ("picture,fz_n,fx\n0.png,0,0\n1.png,-0.5\n", "row 2 below the header has 2 cells, and the header 3"),
        ("picture,fz_n\n0.png,0\n,-0.5\n", "column 'picture': row 2 below the header holds nothing"),
        ("picture,fz_n\n0.png,0\n7.png,-0.5\n", "the picture '7.png' in row 2 below the header"),
        ("picture,fz_n,label\n0.png,0,0.2\n1.png,-1,0.9\n", "number, and row 1 below the header holds '0.2'"),
        ("picture,Normal Force (N)\n0.png,1\n", "'Normal Force .*' does not say which axis"),
        ("picture,Fz (mN),Fz (N)\n0.png,-50,-0.05\n", r"'Fz \(mN\)' and 'Fz \(N\)' mean the same, fz_n"),
    ],
)
def test_a_table_that_cannot_be_read_names_the_row_or_the_separator(text: str, problem: str, tmp_path: Path):
    with pytest.raises(ValueError, match=problem):
        open_domain(picture_folder(tmp_path, text))


def test_millinewtons_and_repeated_pictures_are_noted(tmp_path: Path):
    text = "picture,fz_n\n0.png,0\n1.png,-2500\n1.png,-2500\n"
    notes = " ".join(open_domain(picture_folder(tmp_path, text)).notes)
    assert "1 rows name a picture that a row before them names" in notes
    assert "'fz_n' reaches 2500 N, beyond any sensor: is it mN, or no reading?" in notes
    assert "no unit" not in notes


@pytest.mark.parametrize(
    ("header", "column", "factor"),
    [
        ("Fz (mN)", "fz_n", 1e-3),
        ("Fz_mN", "fz_n", 1e-3),
        ("fz/mN", "fz_n", 1e-3),
        ("Force Z, mN", "fz_n", 1e-3),
        ("Force.Fz (mN)", "fz_n", 1e-3),
        ("Force_z", "fz_n", 1),
        ("FzN", "fz_n", 1),
        ("Z Force (Newton)", "fz_n", 1),
        ("/ft/wrench/force/z", "fz_n", 1),
        ("Fz (g)", "fz_n", 9.80665e-3),
        ("fz kgf", "fz_n", 9.80665),
        ("Fz_oz", "fz_n", 0.27801385),
        ("Fz [cN]", "fz_n", 1e-2),
        ("Fz (uN)", "fz_n", 1e-6),
        ("Tx (N-m)", "mx_nmm", 1e3),
        ("Mx (N·m)", "mx_nmm", 1e3),
        ("Tx (lbf-in)", "mx_nmm", 112.98483),
        ("Mx [N.mm]", "mx_nmm", 1),
        ("torque x (mNm)", "mx_nmm", 1),
        ("depth (um)", "depth_mm", 1e-3),
        ("depth_μm", "depth_mm", 1e-3),
        ("x/m", "x_mm", 1e3),
        ("x_in", "x_mm", 25.4),
        ("time (us)", "time_s", 1e-6),
        ("t_ns", "time_s", 1e-9),
        ("ts", "time_s", 1),
    ],
)
def test_the_unit_of_a_header_is_converted(tmp_path: Path, header: str, column: str, factor: float):
    text = f'picture,"{header}"\n0.png,-0.5\n1.png,-0.25\n'
    picture(picture_folder(tmp_path, text) / "reference.png", 9)
    data = open_domain(tmp_path)
    assert data.columns[column] == pytest.approx(np.array([-0.5, -0.25]) * factor)
    assert any("is converted to" in note for note in data.notes) == (factor != 1)


@pytest.mark.parametrize("header", ["Fz (V)", "Fz (%)", "Fz_mm"])
def test_an_unknown_unit_or_one_of_another_quantity_is_refused(tmp_path: Path, header: str):
    with pytest.raises(ValueError, match=rf"{re.escape(header)}' states the unit '.*': known are"):
        open_domain(picture_folder(tmp_path, f"picture,{header}\n0.png,-50\n"))


def test_a_column_that_nobody_needs_is_skipped_and_said(tmp_path: Path):
    data = open_domain(
        picture_folder(
            tmp_path,
            "frame,image,fz_n,depth,label,object,timestamp,pose\n"
            "0,0.png,0,d/0.npy,sphere,,1700000000000,a\n1,1.png,-1,d/1.npy,cube,b,1700000000033,b\n",
        )
    )
    assert list(data.columns) == ["frame_id", "fz_n"]
    notes = " ".join(data.notes)
    for told in (
        "'frame': row 1",
        "'depth'",
        "'label'",
        "'object'",
        "'timestamp' states no unit",
        "not read: pose",
    ):
        assert told in notes


@pytest.mark.parametrize(
    "text",
    [
        "# sensor 5\n# today\npicture,Fz (mN)\n0.png,0\n1.png,-500\n",
        "sep=;\npicture;Fz (mN)\n0.png;0\n1.png;-500\n",
        "picture,Fz\n,[mN]\n0.png,0\n1.png,-500\n",
        "picture,Fz\n.\\0.png,0\n1.png,−0.5\n",
        "# of today\n# picture,Fz\n0.png,0\n1.png,-0.5\n",
        "picture,Fz\n0.png,0\n# second series\n1.png,-0.5\n",
        "picture\tFz (mN)\n0.png\t0,000\n1.png\t-500,000\n",
        "picture;step;Fz\n0.png;1;0.000\n1.png;2;-0.500\n",
        "picture;Fz\n0.png;0\n# second series;\n1.png;-0,5\n;\n",
    ],
)
def test_what_programs_write_around_the_numbers_is_read(tmp_path: Path, text: str):
    picture_folder(tmp_path, text)
    assert open_domain(tmp_path).columns["fz_n"].tolist() == [0, -0.5]


def test_a_table_of_tabs_and_names_of_another_system_are_read(tmp_path: Path):
    for name in ("a\u0308.png", "b.png"):
        picture(tmp_path / name, 60)
    for name in ("~$labels.csv", "._labels.csv"):
        (tmp_path / name).write_bytes(b"no table")
    (tmp_path / "labels.tsv").write_text("picture\tFz\n\u00e4.png\t-1\nb.png\t0\n")
    assert open_domain(tmp_path).columns["fz_n"].tolist() == [-1, 0]


@pytest.mark.parametrize("name", ["/data/0.png", "C:\\data\\0.png", "../0.png"])
def test_a_picture_is_named_from_its_folder(tmp_path: Path, name: str):
    with pytest.raises(ValueError, match=r"must be a path from .* to a picture in it, as 0\.png"):
        open_domain(picture_folder(tmp_path, f"picture,fz_n\n{name},0\n"))


def test_pictures_saved_twice_are_counted(tmp_path: Path):
    for name in ("0.png", "0.jpg", "1.png", "blank.png"):
        picture(tmp_path / name, 60)
    data = open_domain(tmp_path)
    assert len(data) == 3
    assert "1 pictures have the name of another" in " ".join(data.notes)


@pytest.mark.parametrize(("encoding", "separator"), [("utf-16", "\t"), ("utf-8-sig", ";")])
def test_tables_of_excel_are_read(tmp_path: Path, encoding: str, separator: str):
    text = "picture,Fz (mN)\n0.png,0\n1.png,-500\n".replace(",", separator)
    (picture_folder(tmp_path, "") / "labels.csv").write_bytes(text.encode(encoding))
    assert open_domain(tmp_path).columns["fz_n"].tolist() == [0, -0.5]


def test_verify_names_every_picture_beside_an_unreadable_reference(tmp_path: Path):
    picture_folder(tmp_path, "picture,fz_n\n0.png,0\n1.png,-1\n2.png,-1\n")
    for name in ("reference.png", "1.png"):
        (tmp_path / name).write_bytes(b"no image")
    assert [damage.file for damage in verify_domain(tmp_path)] == ["1.png", "reference.png"]
