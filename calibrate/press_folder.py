"""A folder of pictures of a pressed ball, or of videos, made a list of presses: `presses.toml` and a sheet to check it.

The reference is the picture whose name says so, else the one without an imprint on what most pictures have in common.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import tomli_w

from gelgap.assets.image_file import SHEET, SUFFIXES, picture_files, read_image, visible_files
from gelgap.assets.names import comma_list
from gelgap.assets.whole_file import write_whole
from gelgap.calibrate.marks import FoundMark, find_marks
from gelgap.calibrate.membranes import sphere_profiles
from gelgap.calibrate.pictures import ListedPress, PressList
from gelgap.data.formats.pictures import REFERENCE_STEMS, encode_png
from gelgap.data.formats.video import VIDEOS, video_pictures
from gelgap.render.imaging import difference_picture

LIST = "presses.toml"
_NAMED_REFERENCE = re.compile(rf"(^|[^a-z])({'|'.join(REFERENCE_STEMS)}|no[-_ ]contact)($|[^a-z])", re.I)
_SMALL_PX = (80, 60)
# An imprint on what pictures have in common, as a share of the usual one: of a reference, of one where presses overlap,
# and what that has at most of the next smallest.
_NO_IMPRINT, _MOST_IMPRINT, _CLEARLY_LESS = 0.3, 0.7, 0.85
# Dents of balls leave 0.1 to 0.3 unexplained on real sensors, at most 1.9 times the usual; other bodies, mirrored and
# darker pictures more than 0.35, or 2.4 times.
_MOST_UNEXPLAINED, _MOST_OF_USUAL, _MOST_SHIFT = 0.33, 2.2, 0.01  # the last of the width
# What changes beyond a dent, by the share of its own change: shadows at most 1.3 times the usual, another imprint 1.5.
_BEYOND_OF_USUAL, _BEYOND_AT_LEAST = 1.2, 0.1
# Dust and seams, by the usual share: sharp pictures of seven real sensors have 0.79 or more, at a blur of 4 px of 320
# 0.38 or less, stretched by a tenth 0.45. Where the usual one is less than the least, the gel has none.
_DETAIL_OF_USUAL, _LEAST_DETAIL = 0.6, 0.05
# Of the largest change in a video: more is a press, less is rest; at a press's end all is nearly as deep.
_PRESSED, _AT_REST, _DEEPEST = 0.3, 0.1, 0.9
_FEWEST_FRAMES = 3
_TILE_PX, _TILES, _DIFFERENCE_GAIN = 320, 3, 2
_HEAD = """\
# Presses that gelgap found: look at {sheet}, and correct here what is wrong. Then: gelgap calibrate {list}
# mm_per_px: how much of the gel a pixel shows. sphere_diameter_mm: the ball's diameter, twice its radius.
# center_px, radius_px: the circle (column, row) in which gel touches the ball, which is less than the dent.

"""


@dataclass(frozen=True)
class FoundPresses:
    """The list that was written, names of pictures without contact, and sentences on what looks wrong."""

    path: Path
    count: int
    without_contact: tuple[str, ...]
    doubts: tuple[str, ...]


def mark_presses(
    folder: Path, ball_mm: float, mm_per_px: float, reference: Path | None = None
) -> FoundPresses:
    """Find reference, presses, centres and radii in a folder, and write its `presses.toml` and `presses-sheet.png`.

    `ball_mm` is the ball's diameter. Of each video the stillest picture at rest and of each press are taken, and
    written beside it.

    Raises
    ------
    ValueError
        If it has a list already, no pictures, or of several sizes, none is without contact, or contacts are larger than
        such a ball leaves.
    """
    if (path := folder / LIST).exists():
        raise ValueError(
            f"{path} exists, and may have been corrected: calibrate it, or take it away to have presses marked anew"
        )
    pictures = _pictures(folder)
    rest = _reference(folder, pictures, reference)
    flat, pressed = pictures[rest], {name: own for name, own in pictures.items() if name != rest}
    profiles = sphere_profiles({ball_mm})[ball_mm]
    marks = dict(zip(pressed, find_marks(flat, list(pressed.values()), profiles, mm_per_px), strict=True))
    found = {name: mark for name, mark in marks.items() if mark is not None}
    if not found:
        raise ValueError(f"{folder}: no picture differs from {rest}, the one without contact")
    largest = [name for name, mark in found.items() if mark.is_largest]
    if 2 * len(largest) > len(found):
        most_px = found[largest[0]].radius_px
        raise ValueError(
            f"{folder}: in {len(largest)} of {len(found)} pictures the contact is as large as a ball of {ball_mm:g} mm "
            f"diameter leaves at most ({most_px:.0f} px at {mm_per_px:g} mm per px), or larger: check --ball-mm and "
            "--mm-per-px"
        )
    presses = tuple(
        ListedPress(
            picture=name, sphere_diameter_mm=ball_mm, center_px=mark.center_px, radius_px=mark.radius_px
        )
        for name, mark in found.items()
    )
    save_marks(PressList(presses=presses, reference=rest, mm_per_px=mm_per_px), path, pictures)
    without = tuple(name for name, mark in marks.items() if mark is None)
    return FoundPresses(path, len(found), without, tuple(_doubts(found, flat.shape[1])))


def save_marks(listed: PressList, path: Path, pictures: Mapping[str, np.ndarray]) -> None:
    """Write presses marked by centre and radius, rounded to 0.1 px, and beside the list the sheet to check it.

    `pictures` are the list's, uint8 (h, w, 3) by name, its reference among them.
    """
    text = _HEAD.format(sheet=SHEET, list=LIST) + tomli_w.dumps(
        listed.model_dump(exclude={"presses"}, exclude_none=True)
    )
    for press in listed.presses:
        text += "\n[[presses]]\n" + tomli_w.dumps(
            press.model_dump(exclude={"center_px", "radius_px"}, exclude_defaults=True)
        )
        x, y = press.center_px
        text += f"center_px = [{x:.1f}, {y:.1f}]\nradius_px = {press.radius_px:.1f}\n"
    write_whole(path.with_name(SHEET), encode_png(_sheet(listed, pictures)))
    write_whole(path, text.encode())


def _doubts(found: dict[str, FoundMark], width_px: int) -> list[str]:
    unexplained, beyond, detail = (
        float(np.median([getattr(mark, field) for mark in found.values()]))
        for field in ("unexplained", "beyond", "detail")
    )
    bad_from = min(_MOST_UNEXPLAINED, _MOST_OF_USUAL * unexplained)
    bad = [name for name, mark in found.items() if mark.unexplained > bad_from]
    second_from = _BEYOND_OF_USUAL * beyond + _BEYOND_AT_LEAST
    second = [name for name, mark in found.items() if mark.beyond > second_from]
    moved = [name for name, mark in found.items() if mark.shift_px > _MOST_SHIFT * width_px]
    least = _DETAIL_OF_USUAL * detail if detail > _LEAST_DETAIL else -np.inf
    unlike = [name for name, mark in found.items() if mark.detail < least and name not in moved]
    doubts = []
    if unlike:
        named = comma_list(unlike)
        doubts.append(f"without the reference's dust and seams, as if out of focus or stretched: {named}")
    if bad:
        doubts.append(f"not like the other dents of a ball, so look at mark and picture: {comma_list(bad)}")
    if second:
        doubts.append(f"something else than the marked dent, as a second imprint: {comma_list(second)}")
    if moved:
        most_px = max(mark.shift_px for mark in found.values())
        doubts.append(
            f"shifted against the reference, by up to {most_px:.0f} px, as if the camera had moved: {comma_list(moved)}"
        )
    return doubts


def _pictures(folder: Path) -> dict[str, np.ndarray]:
    """Return the pictures of a folder, all of one size, by their names."""
    files = [path for path in visible_files(folder) if path.is_file()]
    of_videos: dict[str, np.ndarray] = {}
    for path in files:
        if path.suffix.lower() in VIDEOS:
            of_videos |= stills_of(path)
    pictures = {path.name: read_image(path) for path in picture_files(files)} | of_videos
    if len(pictures) < 2:
        raise ValueError(
            f"{folder} holds {len(pictures)} pictures: a picture without contact and six or more of a pressed ball are "
            f"needed ({', '.join(SUFFIXES)}), or videos of that ({', '.join(VIDEOS)})"
        )
    sizes = [picture.shape for picture in pictures.values()]
    usual = max(set(sizes), key=sizes.count)
    for name, picture in pictures.items():
        if picture.shape != usual:
            raise ValueError(
                f"{folder / name} is a picture of {picture.shape[1]}×{picture.shape[0]} px, and most are "
                f"{usual[1]}×{usual[0]} px: all must come from the same camera"
            )
    for name, picture in of_videos.items():
        write_whole(folder / name, encode_png(picture))
    return pictures


def stills_of(video: Path) -> dict[str, np.ndarray]:
    """Return by name the stillest picture of a video at rest, and of each press; it begins at rest.

    Raises
    ------
    ValueError
        If it cannot be read, or nothing in it changes for longer than a moment.
    """
    small = np.array([_small(picture) for picture in video_pictures(video)])
    if len(small) < _FEWEST_FRAMES:
        raise ValueError(f"{video} has {len(small)} pictures; a press and a moment before it are needed")
    change = np.abs(small - small[0]).mean(axis=(1, 2, 3))
    motion = np.abs(np.diff(small, axis=0)).mean(axis=(1, 2, 3))
    motion = np.maximum(np.r_[motion[0], motion], np.r_[motion, motion[-1]])
    chosen = {int(min(np.flatnonzero(change <= _AT_REST * change.max()), key=motion.__getitem__)): "rest"}
    for pressed, run in groupby(range(len(change)), key=lambda at: change[at] > _PRESSED * change.max()):
        frames = list(run)
        if pressed and len(frames) >= _FEWEST_FRAMES:
            deep = [at for at in frames if change[at] >= _DEEPEST * change[frames].max()]
            chosen[min(deep, key=motion.__getitem__)] = f"press-{len(chosen)}"
    if len(chosen) == 1:
        raise ValueError(f"{video}: no press lasts for {_FEWEST_FRAMES} pictures")
    return {
        f"{video.stem}-{chosen[at]}.png": picture
        for at, picture in enumerate(video_pictures(video))
        if at in chosen
    }


def _small(picture: np.ndarray) -> np.ndarray:
    """Return (60, 80, 3) float32, at one level: a whole picture that is brighter is none that is pressed."""
    import cv2

    small = cv2.resize(picture, _SMALL_PX, interpolation=cv2.INTER_AREA).astype(np.float32)
    return small - np.median(small, axis=(0, 1))


def _reference(folder: Path, pictures: dict[str, np.ndarray], given: Path | None) -> str:
    """Return the name of the picture without contact."""
    if given is not None:
        if given.resolve().parent != folder.resolve() or given.name not in pictures:
            raise ValueError(f"--reference {given}: must be a picture in {folder}, beside the presses")
        return given.name
    named = [name for name in pictures if _NAMED_REFERENCE.search(Path(name).stem)]
    if named:
        return named[0]
    small = np.array([_small(picture) for picture in pictures.values()])
    imprints = np.abs(small - np.median(small, axis=0)).max(axis=(1, 2, 3))
    name = list(pictures)[imprints.argmin()]
    least, second = np.sort(imprints)[:2] / np.median(imprints)
    if least > _MOST_IMPRINT or least > max(_NO_IMPRINT, _CLEARLY_LESS * second):
        raise ValueError(
            f"{folder}: no picture seems to be without contact ({name} is the nearest to it); add a picture of the "
            "untouched gel, named reference.png or by --reference"
        )
    return name


def _sheet(listed: PressList, pictures: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return a picture of all presses: each with its circle, beside 128 plus twice its difference to the reference."""
    import cv2

    tiles, flat = [], pictures[listed.reference]
    for press in listed.presses:
        picture = pictures[press.picture]
        scale, halves = _TILE_PX / picture.shape[1], []
        (x, y), radius = np.array(press.center_px) * scale, press.radius_px * scale
        for image in (picture, difference_picture(picture, flat, _DIFFERENCE_GAIN)):
            half = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            halves.append(
                cv2.circle(half, (round(x), round(y)), round(radius), (255, 255, 0), 1, cv2.LINE_AA)
            )
        tile, label = np.hstack(halves), f"{press.picture}  r {press.radius_px:.0f} px"
        for colour, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(tile, label, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, thickness, cv2.LINE_AA)
        tiles.append(tile)
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % _TILES)
    return np.vstack([np.hstack(tiles[first : first + _TILES]) for first in range(0, len(tiles), _TILES)])
