"""What goes wrong in a recording is found, said with its time, and gets the right label or none."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from real_clones import force_of, write_table

from gelgap.data import convert
from gelgap.data.formats.recording_faults import repeated_pictures, runs, stands_still
from gelgap.data.frames.tables import known_columns

FRAMES, RATE = 90, 30
Change = Callable[[int, np.ndarray, np.ndarray], np.ndarray]


def force_n(time_s: np.ndarray) -> np.ndarray:
    """Return Fz of a press with a hold, N: at rest for 0.7 s, then down and up, and at rest again."""
    return -np.interp(time_s, [0.7, 1.3, 1.6, 2.0, 2.5], [0, 0.7, 0.7, 1.3, 0])


def write_clip(
    folder: Path, seed: int, change: Change, zero_s: float = 0, limit_n: float = -9, noise_n: float = 0.002
) -> Path:
    """Write a dent on a noisy camera in three colours of light, its pictures changed, with a log of another zero."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:60, 0:80]
    rest = np.stack([120 + 0.4 * columns, 150 - 0.4 * rows, 160 - 0.3 * columns], -1) + random.normal(
        0, 2, (60, 80, 1)
    )
    table, last = [], rest
    for number in range(FRAMES):
        radius = 12 * max(-float(force_n(number / RATE)), 1e-9) ** (1 / 3)
        x, y = (columns - 35) / radius, (rows - 30) / radius
        dent = 40 * np.exp(-((x**2 + y**2) ** 2)) * (radius > 1)
        shading = np.stack(
            [dent * np.clip(x, -1, 1), dent * np.clip(-y, -1, 1), dent * np.clip(-x, -1, 1)], -1
        )
        seen = np.clip(np.round(rest + shading + random.normal(0, 1, rest.shape)), 0, 255)
        last = np.clip(change(number, seen, last), 0, 255)
        name = f"{number:03d}.png"
        (folder / "press").mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / "press" / name), last.astype(np.uint8)[..., ::-1])
        table.append({"picture": name, "time_s": f"{number / RATE:.4f}"})
    write_table(folder / "press/times.csv", table)
    time_s = np.arange(300) / 100
    measured_n = np.maximum(force_n(time_s) + random.normal(0, noise_n, len(time_s)), limit_n)
    log = [
        {"time_s": f"{t + zero_s:.4f}", "fz_n": f"{f:.5f}"} for t, f in zip(time_s, measured_n, strict=True)
    ]
    write_table(folder / "press.csv", log)
    return folder


def unchanged(number: int, seen: np.ndarray, last: np.ndarray) -> np.ndarray:
    return seen


FAULTS: dict[str, tuple[Change, set[int], str]] = {
    "stall": (
        lambda k, seen, last: last if 30 <= k < 45 else seen,
        {*range(30, 45)},
        "repeat the one before",
    ),
    "stall in a hold": (
        lambda k, seen, last: last if 40 <= k < 47 else seen,
        {*range(40, 47)},
        "40–46 (1.33–1.53 s)",
    ),
    "green": (lambda k, seen, last: seen * (0, 1, 0) if k < 4 else seen, {*range(4)}, "unlike the rest"),
    "dark": (lambda k, seen, last: seen * 0.3 if k == 50 else seen, {50}, "50 (1.67 s)"),
    "shifted": (
        lambda k, seen, last: np.roll(seen, 8, 1) if 40 <= k < 46 else seen,
        {*range(40, 46)},
        "unlike",
    ),
    "exposure settles": (
        lambda k, seen, last: seen * (1 - 0.4 * np.exp(-k / 3)),
        {*range(5)},
        "unlike the rest",
    ),
    "drift": (lambda k, seen, last: seen * (1 - 0.2 * k / FRAMES), set(), "the light drifts by -1"),
    "exposure steps": (lambda k, seen, last: seen * (1.03 if k > 45 else 1), set(), "steps by +"),
}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_of_the_pictures_is_said_and_none_of_them_written(tmp_path: Path, kind: str, seed: int):
    change, wrong, said = FAULTS[kind]
    (clip,) = convert(write_clip(tmp_path / "mine", seed, change), "recordings", tmp_path / "out")
    written = force_of(tmp_path / "out/mine", "press")
    assert not wrong & set(written)
    assert max(abs(own - force_n(number / RATE)) for number, own in written.items()) < 0.02
    assert clip.left_out >= len(wrong)
    assert said in " ".join(clip.notes)


@pytest.mark.parametrize("zero_s", [0, 1.7e9 + 0.377, 1.213, -1.5071])
def test_clocks_of_any_zero_are_aligned_over_the_whole_clip(tmp_path: Path, zero_s: float):
    (clip,) = convert(write_clip(tmp_path / "mine", 4, unchanged, zero_s), "recordings", tmp_path / "out")
    written = force_of(tmp_path / "out/mine", "press")
    assert max(abs(own - force_n(number / RATE)) for number, own in written.items()) < 0.02
    assert clip.left_out == 0
    assert ("aligned over the whole clip" in " ".join(clip.notes)) == (zero_s != 0)


def test_a_gauge_at_its_limit_gives_no_labels(tmp_path: Path):
    (clip,) = convert(
        write_clip(tmp_path / "mine", 5, unchanged, limit_n=-0.9), "recordings", tmp_path / "out"
    )
    written = force_of(tmp_path / "out/mine", "press")
    assert max(abs(own - force_n(number / RATE)) for number, own in written.items()) < 0.02
    assert "fz_n stands at -0.9 from" in " ".join(clip.notes)


def test_a_log_without_noise_may_stand():
    time_s = np.arange(300) / 100
    assert not stands_still(np.minimum(force_n(time_s), 0)).any()
    noisy = force_n(time_s) + np.random.default_rng(0).normal(0, 0.002, 300)
    assert not stands_still(noisy).any()
    slow = np.repeat(noisy[::10], 10)
    assert not stands_still(slow).any()
    noisy[140:190] = noisy[139]
    assert runs(stands_still(noisy)) == [(139, 189)]


def test_of_a_camera_without_noise_a_repeat_is_in_doubt():
    still = np.array([0, 0.95, 1, 0.97, 0.96])
    repeated, in_doubt = repeated_pictures(still)
    assert not repeated.any()
    assert in_doubt.tolist() == [False, False, True, False, False]
    assert repeated_pictures(np.array([0, 0.4, 1, 0.4]))[0].tolist() == [False, False, True, False]


@pytest.mark.parametrize(
    "stamp",
    ["sec,nanosec", "header.stamp.sec,header.stamp.nanosec", "/ft/header/stamp/secs,/ft/header/stamp/nsecs"],
)
def test_stamps_and_torques_of_ros_are_read(tmp_path: Path, stamp: str):
    rows = [f"170000000{k // 4},{k % 4 * 250_000_000},-{k},0.5" for k in range(8)]
    (tmp_path / "log.csv").write_text("\n".join([f"{stamp},wrench.force.z,wrench.torque.x", *rows]))
    columns, notes = known_columns(tmp_path / "log.csv")
    assert columns["time_s"] == pytest.approx(1.7e9 + np.arange(8) / 4, abs=1e-5)
    assert (columns["mx_nmm"] == 500).all()
    assert "'wrench.torque.x' is converted to N·mm: torques of ROS are in N·m" in notes
    (tmp_path / "log.csv").write_text("time_s,Mx\n0,0.5\n0.1,0.5\n")
    assert (known_columns(tmp_path / "log.csv")[0]["mx_nmm"] == 0.5).all()
