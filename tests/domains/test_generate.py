import dataclasses
import itertools
import json
import os
import platform
import shutil
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from gelgap.assets.locks import sole_use
from gelgap.data.formats.domain_folder import DomainFolder
from gelgap.data.frames.folders import open_domain
from gelgap.data.frames.splits import split_frames
from gelgap.domains.generation import tasks
from gelgap.domains.generation.generate import generate, generate_recipes, package_versions
from gelgap.domains.measured_gap import recipe_of
from gelgap.render import MembraneRenderer, Sensor
from gelgap.sim import Pose, PosePath
from gelgap.sim.plan import SolvePlan

pytestmark = pytest.mark.usefixtures("small_shards")


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, make) -> Path:
    out = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gelgap.domains.generation.plan.FRAMES_PER_SHARD", 8)
        make(out)
    return out


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished, tmp_path / "copy")
    return tmp_path / "copy"


def test_the_same_seed_gives_the_same_bytes_with_workers(make, finished: Path, tmp_path: Path):
    make(tmp_path, scheduler=None, workers=2)
    assert contents(tmp_path / "mb0i0") == contents(finished / "mb0i0")


def test_domains_made_together_have_the_bytes_of_domains_made_alone(make, finished: Path, tmp_path: Path):
    report = make(tmp_path, ("wmb0i0", "mb0i0", "mb0i1"))
    assert report.solves == 1
    assert contents(tmp_path / "mb0i0") == contents(finished / "mb0i0")


def test_each_light_is_made_once_a_batch_however_few_renderers_are_kept(
    make, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    made = []

    def renderer(*light: object) -> MembraneRenderer:
        made.append(light)
        return MembraneRenderer(*light)

    monkeypatch.setattr("gelgap.domains.generation.shard.KEPT_RENDERERS", 2)
    monkeypatch.setattr("gelgap.domains.renderers.kept_renderer", lru_cache(2)(renderer))
    make(tmp_path, ("mb0i0", "mb0i1", "mb0i2"))
    assert contents(tmp_path / "mb0i0") == contents(finished / "mb0i0")
    # For the reference pictures, and for each of four batches.
    assert len(made) <= 3 * (1 + 4)


def test_a_package_that_is_not_there_has_no_version(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("gelgap.domains.generation.generate.PACKAGES", ("numpy", "no-such-package"))
    assert package_versions.__wrapped__() == {"numpy": np.__version__, "no-such-package": "not installed"}


def test_another_seed_changes_the_noise_and_not_the_forces(make, finished: Path, tmp_path: Path):
    make(tmp_path, seed=1)
    one, other = open_domain(finished / "mb0i0"), open_domain(tmp_path / "mb0i0")
    assert np.array_equal(one.force_n, other.force_n)
    difference = one[5].image.astype(int) - other[5].image
    assert 0 < np.abs(difference).mean() < 5


@pytest.mark.parametrize("damage", ["missing", "bit flipped", "reference flipped", "leftover"])
def test_damage_is_found_and_repaired_to_the_same_bytes(make, copy: Path, finished: Path, damage: str):
    folder = copy / "mb0i0"
    shard = folder / "frames-00001.parquet"
    data = shard.read_bytes()
    match damage:
        case "missing":
            shard.unlink()
        case "bit flipped":
            shard.write_bytes(data[:1000] + bytes([data[1000] ^ 4]) + data[1001:])
        case "reference flipped":
            picture = (folder / "reference.png").read_bytes()
            (folder / "reference.png").write_bytes(picture[:500] + bytes([picture[500] ^ 1]) + picture[501:])
        case "leftover":
            (folder / "frames-00009.parquet").write_bytes(data)
    assert DomainFolder(folder).damages()
    report = make(copy)
    assert report.frames_written == {"reference flipped": 0, "leftover": 0}.get(damage, 8)
    assert contents(folder) == contents(finished / "mb0i0")
    assert not DomainFolder(folder).damages()


def test_a_path_without_contact_needs_no_solve(tmp_path: Path):
    path = PosePath("rest", (Pose(0.0, contact_class=0), Pose(0.0, point_x_mm=1.0, point_id=1)))
    quick = {"scheduler": "synchronous", "render_quality": "draft", "size_px": (80, 60)}
    report = generate(["mb0i0"], path, tmp_path, **quick)
    assert (report.solves, report.frames_written) == (0, 2)
    assert not open_domain(tmp_path / "mb0i0").force_n.any()


def test_a_finished_domain_is_skipped(make, copy: Path):
    report = make(copy)
    assert report.skipped == ("mb0i0",)
    assert report.frames_written == 0


def test_another_configuration_is_refused_and_overwritten_on_request(make, copy: Path, finished: Path):
    with pytest.raises(ValueError, match=r"holds another configuration \(seed: 0 there, 3.*--overwrite"):
        make(copy, ("mb0i1", "mb0i0"), seed=3)
    assert contents(copy / "mb0i0") == contents(finished / "mb0i0")
    assert not (copy / "mb0i1").exists()
    make(copy, seed=3, overwrite=True)
    assert open_domain(copy / "mb0i0").manifest["seed"] == 3


def test_a_damaged_manifest_is_an_error_that_says_what_to_do(make, copy: Path):
    path = copy / "mb0i0" / "manifest.json"
    path.write_text(path.read_text().replace('"frames": 26', '"frames": 27'))
    assert DomainFolder(copy / "mb0i0").damages()
    with pytest.raises(RuntimeError, match=r"damaged.*--overwrite"):
        make(copy)


def test_two_writers_on_one_folder_are_refused(make, tmp_path: Path):
    with sole_use(tmp_path), pytest.raises(RuntimeError, match=r"another process .pid.* is writing"):
        make(tmp_path)


def test_a_stopped_run_keeps_its_work(make, tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch):
    rendered = tasks.render_batch

    def fails_at_the_third(batch, *rest):
        if batch.shard == "frames-00002.parquet":
            raise KeyboardInterrupt
        return rendered(batch, *rest)

    monkeypatch.setattr(tasks, "render_batch", fails_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path)
    monkeypatch.undo()
    with pytest.raises(RuntimeError, match="not finished"):
        open_domain(tmp_path / "mb0i0")
    monkeypatch.setattr("gelgap.domains.generation.plan.FRAMES_PER_SHARD", 8)
    assert make(tmp_path).frames_written == 10
    assert contents(tmp_path / "mb0i0") == contents(finished / "mb0i0")


def test_a_full_disk_is_told_and_loses_none(
    make, tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch
):
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(RuntimeError, match=r"No space left on device.*run the same command again"):
            make(tmp_path)
    assert not list((tmp_path / "mb0i0").glob(".*.tmp"))
    make(tmp_path)
    assert contents(tmp_path / "mb0i0") == contents(finished / "mb0i0")


def test_too_small_a_disk_is_told_before_solving(make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("gelgap.domains.generation.generate.run", lambda *_: pytest.fail("solved"))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, 6000))
    with pytest.raises(RuntimeError, match=r"about \d+ MB are needed in .*make room"):
        make(tmp_path)


def test_a_pose_that_did_not_converge_has_no_picture(make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    solved, frames = SolvePlan.state, itertools.count()

    def state(self, *given):
        return dataclasses.replace(solved(self, *given), converged=next(frames) != 4)

    monkeypatch.setattr(SolvePlan, "state", state)
    report = make(tmp_path)
    rows = pq.read_table(sorted((tmp_path / "mb0i0").glob("*.parquet"))).to_pylist()
    assert [row["frame_id"] for row in rows if row["image"] is None] == [4]
    assert not rows[4]["converged"]
    data = open_domain(tmp_path / "mb0i0")
    assert (report.unconverged, data.unconverged, len(data)) == (1, 1, 25)
    assert 4 not in data.columns["frame_id"]
    given, random = (split_frames(data, by) for by in ("given", "random"))
    assert all(np.array_equal(stated, drawn) for stated, drawn in zip(given, random, strict=True))
    assert "1 of 26 frames did not converge" in data.notes[0]


def test_a_membrane_that_is_not_rendered_is_flagged(make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    solved, frames = SolvePlan.state, itertools.count()

    def state(self, *given):
        found = solved(self, *given)
        broken = np.full_like(found.displacement_mm, np.nan)
        return dataclasses.replace(found, displacement_mm=broken) if next(frames) == 7 else found

    monkeypatch.setattr(SolvePlan, "state", state)
    report = make(tmp_path)
    assert (report.unconverged, report.unrenderable) == (1, 1)
    events = [json.loads(line) for line in (tmp_path / "run.jsonl").read_text().splitlines()]
    assert events[1]["event"] == "not rendered"
    assert "not finite" in events[1]["frames"]["7"]


@pytest.mark.parametrize("per_shard", [8, 25])
def test_whatever_goes_wrong_in_one_frame_is_a_flagged_frame(
    make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, per_shard: int
):
    def picture(self, *membrane, frame_name="membrane", **options):
        if frame_name == "frame 25 of mb0i0":
            raise ZeroDivisionError("division by zero")
        return rendered(self, *membrane, frame_name=frame_name, **options)

    rendered = MembraneRenderer.picture
    monkeypatch.setattr(MembraneRenderer, "picture", picture)
    monkeypatch.setattr(
        "gelgap.domains.generation.plan.FRAMES_PER_SHARD", per_shard
    )  # 25: alone in its shard
    report = make(tmp_path)
    assert (report.unconverged, report.unrenderable) == (1, 1)
    events = [json.loads(line) for line in (tmp_path / "run.jsonl").read_text().splitlines()]
    assert events[1]["frames"] == {"25": "ZeroDivisionError: division by zero"}


def test_a_machine_without_memory_stops_the_run(make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def picture(self, *membrane, **options):
        raise MemoryError

    monkeypatch.setattr(MembraneRenderer, "picture", picture)
    with pytest.raises(MemoryError):
        make(tmp_path)


def test_membranes_that_are_not_rendered_stop_the_run(make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    solved = SolvePlan.state

    def state(self, index, solution, extent):
        found = solved(self, index, solution, extent)
        return dataclasses.replace(found, displacement_mm=np.full_like(found.displacement_mm, np.nan))

    monkeypatch.setattr(SolvePlan, "state", state)
    with pytest.raises(RuntimeError, match=r"8 of 8 frames cannot be rendered; frame 0: .*not finite"):
        make(tmp_path)


def test_the_manifest_holds_no_time_and_no_host(finished: Path):
    manifest = (finished / "mb0i0" / "manifest.json").read_text()
    assert platform.node() not in json.loads(manifest).values()
    assert not any(word in manifest for word in ('"time"', '"host"', str(finished)))
    found = json.loads(manifest)
    assert found["frames"] == 26
    assert found["configuration"]["elastomer"]["young_modulus_mpa"] > 0
    assert found["force_max_n"][2] <= 0


def test_membranes_reach_as_far_as_is_seen(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def picture(self, x_mm, y_mm, displacement_mm, **options):
        reach_mm[self.sensor.camera.horizontal_field_of_view_deg] = x_mm[-1], y_mm[-1]
        return rendered(self, x_mm, y_mm, displacement_mm, **options)

    rendered, reach_mm = MembraneRenderer.picture, {}
    monkeypatch.setattr(MembraneRenderer, "picture", picture)
    near = recipe_of(open_domain(finished / "mb0i0"))
    far = near.model_copy(update={"name": "far", "sensor": Sensor.preset("gelsight-2014-like")})
    generate_recipes([near, far], tmp_path, scheduler="synchronous")
    assert list(reach_mm.values()) == [(7.0, 5.5), (9.0, 7.0)]
    assert contents(tmp_path / "mb0i0") == contents(finished / "mb0i0")
