"""Caches, checkpoints and checksums that someone planted: named, set aside and made again, and nothing in them runs."""

import hashlib
import io
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hostile_bytes import Bait, npz, npz_of_bait, pickled, torch_bait
from valid_files import DOMAIN, read_colours, read_resumed

from gelgap.adapt import write_report
from gelgap.assets.checksums import with_checksum, without_checksum
from gelgap.benchmarks.common import read_records, run_missing
from gelgap.domains import export, inspect_domain, open_domain, verify_domain
from gelgap.domains.formats.domain_folder import DomainFolder, sha256
from gelgap.sim.solution import solution_from_bytes


def signed(content: bytes) -> bytes:
    return b"gelgap solution 1\n" + hashlib.sha256(content).digest() + content


@pytest.mark.parametrize("content", ["pickles", "nothing", "another problem", "bare pickle"])
def test_a_planted_solution_is_no_solution(files: Path, content: str) -> None:
    planted = {
        "pickles": npz_of_bait(files, "problem", "rest_mm"),
        "nothing": npz(),
        "another problem": npz(problem=np.frombuffer(b"{}", np.uint8), rest_mm=np.zeros((1, 2))),
        "bare pickle": pickled(files),
    }[content]
    assert solution_from_bytes(signed(planted)) is None
    assert not (files / "bait").exists()


def test_a_planted_array_of_a_record_is_set_aside(files: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = files / "planted.jsonl"
    run_missing(lambda run: {"curve": np.zeros(3)}, [{"seed": 0}], file, workers=1)
    (array,) = (files / "planted").glob("*.npz")
    array.write_bytes(npz_of_bait(files, "curve"))
    record = without_checksum(json.loads(file.read_text()))
    record["arrays"] = hashlib.sha256(array.read_bytes()).hexdigest()
    file.write_text(json.dumps(with_checksum(record)))
    assert read_records(file).empty
    assert array.name in caplog.text
    assert not array.exists()
    assert not (files / "bait").exists()


@pytest.mark.parametrize(
    "planted",
    [b"[" * 100_000, b"[[1, 2, 3]]", b'{"rgb": 3}', b"null", b"\xff", b'{"rgb": [["a", "b", "c"]]}'],
)
def test_planted_colours_are_named_and_made_again(files: Path, planted: bytes, monkeypatch, caplog) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(files / "cache"))
    expected = read_colours(files)
    for file in (files / "cache").glob("*.led"):
        file.write_bytes(planted)
        assert np.array_equal(read_colours(files), expected)
        assert file.name in caplog.text
        assert file.with_name(f"{file.name}.damaged").read_bytes() == planted


def test_a_planted_picture_cache_is_named_and_made_again(files: Path, caplog, monkeypatch) -> None:
    monkeypatch.delenv("GELGAP_CACHE", raising=False)
    frames = open_domain(files / "pictures")
    expected = np.array(frames.images())
    (cache,) = (files / "pictures" / ".cache").glob("*.npy")
    buffer = io.BytesIO()
    np.save(buffer, np.array([Bait(files / "bait")] * 3000, dtype=object))
    for planted in (buffer.getvalue(), cache.read_bytes()[:-5], b"", cache.read_bytes()[:-1] + b"\0"):
        cache.write_bytes(planted)
        caplog.clear()
        assert np.array_equal(open_domain(files / "pictures").images(), expected)
        assert cache.name in caplog.text
    assert not (files / "bait").exists()


def test_a_picture_cache_of_an_older_version_is_made_again_and_older_versions_read_the_new_one(
    files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GELGAP_CACHE", raising=False)
    frames = open_domain(files / "pictures")
    expected = np.array(frames.images())
    (cache,) = (files / "pictures" / ".cache").glob("*.npy")
    assert np.array_equal(np.load(cache, mmap_mode="c"), expected)
    changed = expected.copy()
    changed[0] = 0
    np.save(cache, changed)
    assert np.array_equal(open_domain(files / "pictures").images(), expected)


def test_a_pickle_in_place_of_a_shard_whose_checksum_was_planted_too_is_refused(files: Path) -> None:
    folder = DomainFolder(files / "data" / DOMAIN)
    (shard,) = folder.path.glob("frames-*.parquet")
    shard.write_bytes(pickled(files))
    manifest = folder.read_manifest()
    manifest["files"][shard.name] |= {"sha256": sha256(shard.read_bytes()), "bytes": shard.stat().st_size}
    folder.write_manifest(manifest)
    with pytest.raises(RuntimeError, match=f"{shard.name} is damaged.*--verify"):
        open_domain(folder.path).picture(0)
    assert not (files / "bait").exists()


def test_a_planted_checkpoint_of_training_is_set_aside_and_training_begins_anew(files: Path, caplog) -> None:
    expected = read_resumed(files / "runs" / "resume.pt")
    for planted in (torch_bait(files), b"", (files / "runs" / "stage1.pt").read_bytes()):
        (files / "runs" / "resume.pt").write_bytes(planted)
        caplog.clear()
        found = read_resumed(files / "runs" / "resume.pt")
        assert np.array_equal(found, expected)
        assert "resume.pt" in caplog.text
    assert not (files / "bait").exists()


def test_a_planted_line_among_records_is_left_out(files: Path, caplog) -> None:
    path = files / "records" / "runs.jsonl"
    written = read_records(path)
    lines = path.read_bytes().splitlines()
    planted = [b"[" * 200_000, b'{"job": 3}', b"null", b"\xff", lines[0].replace(b"0.1", b"0.0")]
    path.write_bytes(b"\n".join([*planted, *lines]) + b"\n")
    assert read_records(path).equals(written)
    assert caplog.text.count("runs.jsonl, line") == len(planted)


def test_scripts_in_names_are_shown_and_not_run(files: Path) -> None:
    folder = files / "runs" / "run"
    (folder / "SHA256SUMS").unlink()
    names = {"method": "<b>bold|${x}", "profile": {"name": "<img src=x onerror=alert(1)>"}}
    record = json.loads((folder / "run.json").read_text()) | names
    (folder / "run.json").write_text(json.dumps(record))
    page = write_report(files / "runs", files / "report")
    html, markdown, latex = (page.with_suffix(end).read_text() for end in (".html", ".md", ".tex"))
    for text in (html, markdown):
        assert "<b>" not in text
        assert "<img src=x" not in text
        assert "&lt;b>" in text or "&lt;b&gt;" in text
    assert r"bold|\$\{x\}" in latex
    assert {path.parent for path in (files / "report").rglob("*")} == {files / "report"}


def test_no_export_leaves_its_folder(files: Path) -> None:
    folder = DomainFolder(files / "data" / DOMAIN)
    folder.write_manifest(folder.read_manifest() | {"domain": "../../stolen"})
    with pytest.raises(RuntimeError, match=r"manifest\.json is damaged"):
        export(files / "data", "webdataset", files / "out")
    assert not list(files.parent.rglob("stolen*"))


def test_real_data_is_inspected_picture_by_picture(files: Path) -> None:
    folder = files / "pictures"
    (folder / "2.png").write_bytes(b"no picture")
    shutil.copy(files / "settings" / "0.png", folder / "5.png")
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
    assert "1 of 12 rows have no value of '" in facts
    assert "nan…" not in facts
