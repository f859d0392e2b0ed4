"""Clones of the repositories with real data, in small: the same layout, pictures and numbers made here."""

import csv
import pickle
from pathlib import Path

import cv2
import numpy as np

from gelgap.data import open_domain

SIZE_PX = (160, 120)
REST_LEVEL = 100.0


def press_curve(frames: int, rest: int = 12) -> np.ndarray:
    """Return a force (frames,) in N that is 0 for some frames, rises to 10 N and falls."""
    rising = np.sin(np.linspace(0, np.pi, frames - rest)) ** 2
    return np.concatenate([np.zeros(rest), 10 * rising])


def pictures_of(force_n: np.ndarray, light: tuple[int, int, int] = (0, 0, 0)) -> list[np.ndarray]:
    """Return a picture (h, w, 3) RGB for each force: a spot that grows and brightens on a tinted ground."""
    width, height = SIZE_PX
    rows, columns = np.indices((height, width))
    distance = np.hypot(columns - width / 2, rows - height / 2)
    ground = np.full((height, width, 3), REST_LEVEL) + np.array(light)
    return [
        np.clip(
            ground + (8 * np.sqrt(max(force, 0)) * (distance < 12 + 2 * force))[..., None], 0, 255
        ).astype(np.uint8)
        for force in force_n
    ]


def write_video(path: Path, pictures: list[np.ndarray], codec: str = "MJPG") -> None:
    """Write a video of 30 pictures a second."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 30.0, (width, height))
    for picture in pictures:
        writer.write(picture[..., ::-1])
    writer.release()


def trailing(force_n: np.ndarray, lag: int) -> np.ndarray:
    """Return forces (n,) that come some frames late."""
    return np.concatenate([np.full(lag, force_n[0]), force_n[: len(force_n) - lag]])


def write_wedge_clip(folder: Path, name: str, lag: int = 0, glitches: int = 0, light=(0, 0, 0)) -> None:
    """Write one grasp: its video, and forces that trail by `lag` frames and end in glitches."""
    force_n = press_curve(40)
    write_video(folder / f"{name}.avi", pictures_of(force_n, light))
    measured = trailing(force_n, lag)
    if glitches:
        measured[-glitches:] = -20.0
    (folder / f"{name}_forces.pkl").write_bytes(pickle.dumps(measured))


def write_wedge_clone(clone: Path) -> Path:
    """Write a clone of GelSight-lab/EstimateModulus: two sessions of three clips of two objects each."""
    corners = {"topleft": (10, 10), "topright": (150, 12), "bottomleft": (12, 110), "bottomright": (148, 108)}
    write_table(
        clone / "wedge_config/config_100.csv",
        [{"Name": name, "x": x, "y": y} for name, (x, y) in corners.items()],
    )
    names = {"2023-12-06": "{}_{}", "2023-12-16": "{}__t={}"}
    for number, (session, name) in enumerate(names.items()):
        for object_name in ("golf_ball", "foam"):
            for clip in range(3):
                write_wedge_clip(
                    clone / "example_data" / session,
                    name.format(object_name, clip),
                    lag=clip * number,
                    glitches=clip,
                    light=(0, 0, 30 * number),
                )
    return clone


def write_ball_clone(clone: Path, presses: int = 6) -> Path:
    """Write a clone of yanglh14/gelsight: three series of presses; the last mark of the last series is wrong."""
    for name, prefix in {"calibration": "ball", "calibration2": "cal", "calibration3": "cal"}.items():
        folder = clone / "data" / name
        (folder / "ball_position").mkdir(parents=True)
        for press in range(presses):
            # A spot in the middle of the pad; the marks are of the rectified picture, 240×320 px.
            center = (100 + 12 * press, 150)
            picture = np.full((320, 240, 3), 90, np.uint8)
            cv2.circle(picture, center, 12, (160, 60, 120), -1)
            cv2.imwrite(str(folder / f"{prefix}-{press}.jpg"), picture)
            x, y = rectified(center)
            wrong = name == "calibration3" and press == presses - 1
            mark = f"{x:.0f} {(y + 100) if wrong else y:.0f} 19"
            (folder / "ball_position" / f"{prefix}-{press}.txt").write_text(mark)
    return clone


def rectified(point: tuple[float, float]) -> tuple[float, float]:
    """Return where the repository's warp takes a point, px."""
    corners = np.float32([[33, 58], [208, 61], [56, 250], [185, 250]])
    matrix = cv2.getPerspectiveTransform(corners, np.float32([[0, 0], [240, 0], [0, 320], [240, 320]]))
    x, y, scale = matrix @ np.array([*point, 1.0])
    return x / scale, y / scale


def write_recordings(folder: Path) -> Path:
    """Write a user's two clips: a video whose forces were measured faster and late, and a folder of pictures."""
    force_n = press_curve(40)
    write_video(folder / "press-1.avi", pictures_of(force_n))
    time_s = np.arange(0, 1.4, 0.01)
    late_n = np.interp(time_s - 3 / 30, np.arange(40) / 30, force_n)
    write_table(
        folder / "press-1.csv",
        [{"time_s": t, "fx_n": 0.1 * f, "fz_n": -f} for t, f in zip(time_s, late_n, strict=True)],
    )
    names = [f"{number}.png" for number in range(40)]
    write_table(
        folder / "press-2" / "times.csv",
        [{"picture": name, "time_s": 5 + k / 30} for k, name in enumerate(names)],
    )
    for name, picture in zip(names, pictures_of(force_n), strict=True):
        cv2.imwrite(str(folder / "press-2" / name), picture[..., ::-1])
    write_table(
        folder / "press-2.csv",
        [{"time_s": 5 + k / 30, "fx_n": 0.0, "fz_n": -f} for k, f in enumerate(force_n)],
    )
    return folder


def write_labelled_pictures(domain: Path, folder: Path) -> None:
    """Write a domain's frames as somebody's pictures with Fz, a clip for each contact point."""
    frames, rows = open_domain(domain), []
    for index in range(len(frames)):
        clip = f"{folder.name}-{frames.point_id[index]}"
        row = {"picture": f"{clip}/{index}.png", "fz_n": frames.columns["fz_n"][index], "clip": clip}
        for name, picture in (
            (row["picture"], frames.picture(index)),
            (f"references/{clip}.png", frames.reference),
        ):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / name), picture[..., ::-1])
        rows.append(row)
    write_table(folder / "labels.csv", rows)


def write_table(path: Path, rows: list[dict]) -> None:
    """Write rows as CSV, making the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def rows_of(domain: Path) -> list[dict[str, str]]:
    with (domain / "frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def force_of(domain: Path, clip: str) -> dict[int, float]:
    """Return Fz in N by the number of the picture in its clip."""
    own = [row for row in rows_of(domain) if row["clip"] == clip]
    return {int(Path(row["picture"]).stem): float(row["fz_n"]) for row in own}
