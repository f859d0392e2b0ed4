"""Pictures of presses: what a calibration is given, where a contact is, and what a press changes far away from it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from gelgap.assets.image_file import read_image
from gelgap.assets.names import stays_inside
from gelgap.assets.settings import Settings, within
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.render.imaging import Camera
from gelgap.render.light.scattered import monomials

DARK, SATURATED = 4, 250  # codes at and beyond which a value is not used
LARGEST_MARKS_OFF_PX = 100.0
_ROUGH_PX = 10.0
_MOST_SATURATED, LEAST_USABLE = 0.95, 0.05  # shares of values
_LEAST_CHANGE = 5.0  # code values


@dataclass(frozen=True)
class PressPicture:
    """A picture of a pressed sphere. Depth is that of the sphere's lowest point below the undeformed membrane.

    `point_mm` is where the sphere was pressed, or `center_px` (column, row) where its imprint's centre is; without
    either it is found in the picture. Instead of the depth, `radius_px` may say how large the imprint is.
    `marks_off_px` says by how much these two marks may be wrong.
    """

    picture: np.ndarray = field(repr=False)  # uint8 (h, w, 3)
    sphere_diameter_mm: float | None
    depth_mm: float | None = None
    point_mm: tuple[float, float] | None = None
    radius_px: float | None = None
    center_px: tuple[float, float] | None = None
    name: str = ""
    marks_off_px: float = 3.0

    @property
    def has_rough_marks(self) -> bool:
        """Whether the marks only say where the imprint is, not its contact's centre and edge."""
        return self.marks_off_px > _ROUGH_PX

    @property
    def has_place(self) -> bool:
        """Whether it is known well where the contact is, so that it need not be found in the picture."""
        return self.point_mm is not None or (self.center_px is not None and not self.has_rough_marks)


def _beside(picture: str) -> str:
    if not stays_inside(picture):
        raise ValueError("must lie in the folder of the list")
    return picture


class ListedPress(Settings):
    """One press of a list in TOML: what a `PressPicture` says, with its picture's file, beside the list.

    To be predicted it may have another body than a ball, by the name or file of an indenter, and no picture.
    """

    picture: Annotated[str, AfterValidator(_beside)] | None = None
    sphere_diameter_mm: float | None = None
    depth_mm: float | None = None
    radius_px: float | None = None
    point_mm: tuple[float, float] | None = None
    center_px: tuple[float, float] | None = None
    marks_off_px: float = 3.0
    indenter: str | None = None
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shear_mm: tuple[float, float] = (0.0, 0.0)

    @property
    def label(self) -> str:
        return self.picture or self.indenter or "ball"

    def as_picture(self, picture: np.ndarray, name: str) -> PressPicture:
        """Return the press with its picture."""
        return PressPicture(
            picture, name=name, **self.model_dump(exclude={"picture", "indenter", "turn_deg", "shear_mm"})
        )


_NEEDED = (
    "a calibration needs a folder of pictures of a pressed ball, or a TOML file with a table [[presses]] for each "
    "image: picture, sphere_diameter_mm, and depth_mm or radius_px"
)


class PressList(Settings):
    """A list of presses, and perhaps the picture without contact, beside it, and how much of the gel a pixel shows."""

    presses: Annotated[tuple[ListedPress, ...], Field(min_length=1)]
    reference: Annotated[str, AfterValidator(_beside)] | None = None
    mm_per_px: Annotated[float, within(1e-3, 1.0, "mm")] | None = None

    def pictures(self, folder: Path) -> tuple[PressPicture, ...]:
        """Read the presses' pictures; raises ValueError for a press of another body than a ball, or without one."""
        for number, press in enumerate(self.presses, start=1):
            if press.picture is None or press.indenter is not None or any(press.turn_deg + press.shear_mm):
                raise ValueError(
                    f"press {number} ({press.label}): a calibration needs its picture, and balls alone; indenter, "
                    "turn_deg and shear_mm are for --predict"
                )
        return tuple(
            press.as_picture(read_image(folder / press.picture), f"press {number} ({press.picture})")
            for number, press in enumerate(self.presses, start=1)
        )


def read_presses(path: Path) -> tuple[PressPicture, ...]:
    """Read the presses of a list and their pictures; raises what `read_press_list` and `read_image` do."""
    return read_press_list(path).pictures(path.parent)


def read_press_list(path: Path) -> PressList:
    """Read a list of presses, a TOML file with one table [[presses]] per picture.

    Raises
    ------
    FileNotFoundError
        If the list does not exist.
    ValueError
        If the list is not valid TOML, or a field of a press is unknown, missing or not what it should be.
    """
    try:
        if path.is_file() and path.suffix.lower() != ".toml":
            raise ValueError(f"{path} is not a TOML file")
        if "presses" not in (table := read_toml(path)):
            raise ValueError(f"{path} has no table [[presses]]")
    except (ValueError, FileNotFoundError) as error:
        raise type(error)(f"{error}; {_NEEDED}") from None
    with named_in_errors(path):
        return PressList(**table)


def press_names(presses: Sequence[PressPicture]) -> tuple[str, ...]:
    """Return what messages call presses: their names, or numbers."""
    return tuple(press.name or f"press {number}" for number, press in enumerate(presses, start=1))


def check_presses(reference: np.ndarray, presses: Sequence[PressPicture]) -> None:
    """Raise ValueError for a reference or presses that no light can be fitted to.

    That is a picture of another size, a depth, radius or sphere that cannot be, a reference that is dark or saturated.
    """
    share, shape = (reference >= SATURATED).mean(axis=(0, 1)), reference.shape
    if share.max() > _MOST_SATURATED:
        channel = ("red", "green", "blue")[int(share.argmax())]
        raise ValueError(
            f"the reference is saturated in {100 * share.max():.0f} % of its {channel} channel; expose it less"
        )
    if (reference > DARK).mean() < LEAST_USABLE:
        raise ValueError("the reference is dark; expose it more")
    for name, press in zip(press_names(presses), presses, strict=True):
        check_press(shape, name, press)


def check_press(shape: tuple[int, ...], name: str, press: PressPicture) -> None:
    """Raise ValueError for a press whose picture has another shape, or whose depth, radius or ball cannot be."""
    height, width, _ = press.picture.shape
    depth_mm, diameter_mm, reach = press.depth_mm, press.sphere_diameter_mm, press.radius_px or 0.0
    x, y = press.center_px or (0.0, 0.0)
    if press.picture.shape != shape:
        wrong = (
            f" is a picture of {width}×{height} px, and the reference of {shape[1]}×{shape[0]} px; they must come "
            "from the same camera"
        )
    elif (depth_mm is None) == (press.radius_px is None):
        wrong = " must have either depth_mm or radius_px"
    elif diameter_mm is None:
        wrong = " must have sphere_diameter_mm, by --ball-mm for all: pictures do not hold it, so measure it"
    elif diameter_mm <= 0:
        wrong = f": sphere_diameter_mm is {diameter_mm}; it must be greater than 0"
    elif depth_mm is not None and not 0 < depth_mm < diameter_mm / 2:
        wrong = f": depth_mm is {depth_mm}; it must lie between 0 and the sphere's radius, {diameter_mm / 2}"
    elif press.radius_px is not None and not 2 <= press.radius_px <= max(shape):
        wrong = f": radius_px is {press.radius_px}; it must lie in 2…{max(shape)}"
    elif not (-reach <= x <= width + reach and -reach <= y <= height + reach):
        wrong = (
            f": center_px is {press.center_px}, column and row; no such circle is seen in {width}×{height} px"
        )
    elif not 0 < press.marks_off_px <= LARGEST_MARKS_OFF_PX:
        wrong = f": marks_off_px is {press.marks_off_px}; it must lie in 0…{LARGEST_MARKS_OFF_PX:g}"
    else:
        return
    raise ValueError(name + wrong)


def find_contact_mm(picture: np.ndarray, reference: np.ndarray, camera: Camera) -> tuple[float, float]:
    """Return where a press is: midway between what it made brighter and what it made darker, in each channel.

    A dent is brighter on the side that faces a light and darker on the other, and seldom as much.

    Raises
    ------
    ValueError
        If the picture hardly differs from the reference.
    """
    import cv2

    change = picture.astype(np.float32) - reference
    change = cv2.GaussianBlur(change, (0, 0), picture.shape[1] / 80)
    if np.abs(change).max() < _LEAST_CHANGE:
        raise ValueError("the picture hardly differs from the reference; no contact was found in it")
    height, width, _ = change.shape
    middles, weights = [], []
    for channel in np.moveaxis(change, 2, 0):
        lobes = [np.maximum(channel, 0), np.maximum(-channel, 0)]
        weakest = min(lobe.max() for lobe in lobes)
        if weakest >= _LEAST_CHANGE:
            middles.append(np.mean([_center_px(lobe) for lobe in lobes], axis=0))
            weights.append(weakest)
    if not weights:
        middles, weights = [_center_px(np.abs(change).max(axis=2))], [1.0]
    column, row = np.average(middles, axis=0, weights=weights)
    return tuple(camera.plane_points_mm(np.array([column]), np.array([row]), (width, height))[0].tolist())


def _center_px(change: np.ndarray) -> tuple[float, float]:
    """Return column and row of the centre of mass of what exceeds half of the largest change."""
    strong = np.where(change > 0.5 * change.max(), change, 0)
    rows, columns = np.indices(strong.shape)
    return (strong * columns).sum() / strong.sum(), (strong * rows).sum() / strong.sum()


@dataclass(frozen=True)
class FarField:
    """The picture of the untouched gel, and what multiplies it while something presses: loaded × a level."""

    reference: np.ndarray  # (h, w, 3) linear
    loaded: np.ndarray | None  # (h, w, 3) ratio
    gain: np.ndarray  # (6, 3): by how much the level grows, by the dent's place

    def at(self, rows: np.ndarray, columns: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (n, 3) linear light of pixels, and what multiplies it at a level (3,)."""
        factor = level if self.loaded is None else level * self.loaded[rows, columns]
        return self.reference[rows, columns], np.broadcast_to(factor, (len(rows), 3))


def median_of_presses(stack: np.ndarray) -> np.ndarray:
    """Return the median over presses, 1 where none is far enough."""
    stack.sort(axis=0)  # NaN last
    count = np.isfinite(stack).sum(axis=0)
    lower, upper = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, len(stack) - 1)
    middle = sum(np.take_along_axis(stack, at[None], axis=0)[0] for at in (lower, upper)) / 2
    return np.where(count > 0, middle, 1.0).astype(float)


def fit_gain(levels: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (6, 3): a quadratic of the place through the levels (n, 3), deaf to outliers."""
    terms = monomials(places[:, 0], places[:, 1], 2)
    penalty = np.diag([0, 1, 1, 1, 1, 1.0]) * 0.02 * len(levels)
    gain = np.zeros((6, 3))
    for _ in range(3):
        weights = 1 / np.sqrt(1 + ((levels - terms @ gain) / 0.02) ** 2)
        for channel in range(3):
            weighted = (terms * weights[:, channel, None]).T
            gain[:, channel] = np.linalg.solve(weighted @ terms + penalty, weighted @ levels[:, channel])
    return gain
