import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.data import ArrayFrames, open_domain, verify_domain
from gelgap.data.formats.export import export
from gelgap.data.formats.pictures import mismatch
from gelgap.data.frames.folders import domain_folders
from gelgap.data.inspection import frame_notes, inspect_domain, write_overview
from gelgap.domains.measured_gap import gap_rows


def test_the_facts_are_those_of_the_data(data: Path):
    facts = inspect_domain(data / "mb0i0")
    assert (facts.frames, facts.unconverged, facts.points, facts.classes) == (26, 0, 2, 13)
    assert facts.labels["fz_n"][1] == 0
    assert facts.outside_range == 0
    assert "contact_mask" in str(facts)
    assert [path.name for path in domain_folders(data)] == ["mb0i0", "mb0i1", "wmb0i0"]
    assert domain_folders(data / "mb0i0") == (data / "mb0i0",)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda picture: picture, None),
        (lambda picture: picture[..., ::-1], "is nearer to the reference with red and blue exchanged"),
        (lambda picture: picture[:, ::-1], "is nearer to the reference with left and right exchanged"),
        (lambda picture: picture[::-1, ::-1], "is nearer to the reference with half a turn"),
        (lambda picture: picture // 255, "is black: no value is above 1"),
        (lambda picture: picture // 2, "half of the picture is more than 25 of 255 off"),
        (lambda picture: picture[..., [1, 1, 1]], "is grey, and the reference is not"),
    ],
)
def test_a_picture_that_is_not_of_its_reference_is_noted(data: Path, change: Callable, said: str | None):
    frames = open_domain(data / "mb0i0")
    pictures = np.stack([change(frames.picture(index)) for index in (0, 20)])
    notes = frame_notes(ArrayFrames("own", pictures, frames.reference, None))
    assert [said in note for note in notes] == [True] * bool(said)


def test_a_dent_that_turns_the_shading_round_is_not_taken_for_a_mirrored_picture():
    reference = np.tile(np.linspace(100, 140, 80, dtype=np.uint8)[:, None], (60, 1, 3))
    assert "left and right exchanged" in mismatch(reference[:, ::-1], reference)
    assert mismatch(reference[:, ::-1] + np.uint8(12), reference) == ""


@pytest.mark.parametrize("name", ["frames-00000.parquet", "reference.png", "manifest.json"])
def test_every_flipped_bit_is_found(data: Path, tmp_path: Path, name: str):
    folder = tmp_path / "copy"
    shutil.copytree(data / "mb0i1", folder, ignore=shutil.ignore_patterns(".cache"))
    assert verify_domain(folder) == ()
    whole = (folder / name).read_bytes()
    for place in (0, 1, len(whole) // 10, len(whole) // 2, len(whole) * 9 // 10, len(whole) - 1):
        content = bytearray(whole)
        content[place] ^= 1
        (folder / name).write_bytes(content)
        (damage,) = verify_domain(folder)
        assert damage.file == name


def test_missing_and_unknown_files_are_found(data: Path, tmp_path: Path):
    shutil.copytree(data / "mb0i1", tmp_path / "copy")
    shard = tmp_path / "copy" / "frames-00000.parquet"
    shard.rename(shard.with_name("frames-00007.parquet"))
    assert sorted(map(str, verify_domain(tmp_path / "copy"))) == [
        "frames-00000.parquet: is missing",
        "frames-00007.parquet: is not in the manifest",
    ]


def test_the_page_is_self_contained_and_holds_every_section(data: Path, tmp_path: Path):
    gap = {"base": "mb0i1", "rows": gap_rows(open_domain(data / "mb0i0"), open_domain(data / "mb0i1"))}
    page = write_overview(data / "mb0i0", tmp_path / "page.html", gap).read_text()
    titles = re.findall("<h2>(.*?)</h2>", page)
    assert titles == ["Counts", "Labels and contacts", "Samples", "Frames left out", "Gap", "Provenance"]
    assert not re.search(r"(src|href)=['\"](?!data:)", page)
    assert "26 paired contacts" in page
    assert page.count("<img") >= 15


def test_a_page_of_real_data_leaves_out_what_is_not_known(tmp_path: Path, data: Path):
    export(data / "mb0i1", "paper", tmp_path / "out")
    page = write_overview(tmp_path / "out" / "mb0i1", tmp_path / "page.html").read_text()
    assert "<h2>Gap</h2>" not in page
    assert "class 0" in page


def test_a_page_of_fz_alone_has_no_class(tmp_path: Path):
    for name in ("0.png", "1.png", "reference.png"):
        cv2.imwrite(str(tmp_path / name), np.full((24, 32, 3), 90, np.uint8))
    (tmp_path / "frames.csv").write_text("picture,fz_n\n0.png,0.1\n1.png,-44.5\n")
    page = write_overview(tmp_path, tmp_path / "page.html").read_text()
    assert "class -1" not in page
    assert "-44.50 N" in page
    assert "the declared range is fz_n=-44.5:0.1" in page


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        domain_folders(tmp_path / "nowhere")
