"""Marks found in pictures of a pressed ball: where it touches and how large its contact is, while no light is known.

Where a ball touches, the membrane's normal is the ball's, and around it that of a solve; so a contact's radius alone
says all normals around its centre. What a press changes is taken for a cubic in the normal, solved for exactly, and
its centre and radius are those that leave least. A shadow is darkness that no normal explains: it weighs little. In a
second step, of twelve presses or more, the cubic is that of all presses, quadratic in their place, so that one colour
is one slope in each: radii scatter half as much on a DIGIT. Where contact itself darkens gel, all centres are moved to
where it is level, which took marks of a real sensor from 0.37 to 0.26 mm of those by hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelgap.calibrate.poses import FEWEST_FOR_GAIN, LEAST_DOTS, found_dots, radii_away
from gelgap.calibrate.profiles import STEP_MM, PressProfiles
from gelgap.render.light.scattered import monomials
from gelgap.render.normal_table import cubic_of_normal

_WIDEST_PX = 640  # pictures are looked at no larger
_LEAST_CHANGE = 5.0  # code values
_BLUR_SHARE, _FINE_BLUR_PX = 1 / 80, 1.0  # of the width, to find a contact; to measure it
_STEP_BEYOND_CONTACT = 1.2  # where a dent's change falls most, in radii of its contact
_DIRECTIONS = 72
_SAMPLES = 800  # how many points of a press are compared
_REACH = 1.25  # how far from its centre, in contact radii
_RADII = 60
_ROUNDS, _SHARED_ROUNDS, _EVALUATIONS = 4, 4, 8
_MOST_MOVED, _SHRINKS, _GROWS = 0.6, 0.6, 1.5  # of the radius, in a round
_LEAST_RADIUS = 1 / 40  # of the width; smaller ones may lie on a dot
_RIDGE = 1e-4
# Centres are moved to where gel is level if contact darkens it by more than this share of its code values: on two
# sensors it does by 0.05 to 0.07; on five by 0.03 or less, or it is brighter there.
_LEAST_DARKENING = 0.04
_LEVEL_REACH = 0.9  # how far from its centre the level place is looked for, in contact radii
_LEVEL_ROUNDS, _MOST_LEVEL_STEP = 6, 0.3  # each step at most this share of the radius
_DIFFERENCE_PX = 0.3  # to either side, for derivatives by place
_BEYOND, _FAR = 2.0, 2.5  # radii
_DETAIL_PX = 3.0
# Of a phase correlation; noise alone has less than 11 over the square root of its pixels.
_LEAST_RESPONSE, _NOISE_RESPONSE = 0.03, 12.0


@dataclass(frozen=True)
class FoundMark:
    """The circle in which a ball touches, in pixels, and how well the picture says so.

    `unexplained` is the share of the change, rms, that the ball's normals do not explain as all presses together show
    them; `beyond` the largest change farther than two radii from the centre, in the largest one nearer; `shift_px` by
    how much the picture beyond the dent is shifted against the reference, 0 if nothing tells; `detail` how much of the
    reference's dust and seams it has there, 1 for all of them at their place; `is_largest` whether the ball leaves no
    larger contact.
    """

    center_px: tuple[float, float]
    radius_px: float
    unexplained: float
    beyond: float
    shift_px: float
    detail: float
    is_largest: bool


@dataclass(frozen=True)
class _Dents:
    """Slopes around a ball by its contact's radius: (radii,) in px, (radii, distances), every `step_px`."""

    radii_px: np.ndarray
    slopes: np.ndarray
    step_px: float

    @classmethod
    def of(cls, profiles: PressProfiles, mm_per_px: float) -> "_Dents":
        depths = np.linspace(0.02, 1, _RADII) * profiles.deepest_mm
        radii = np.array([profiles.contact_radius_mm(depth) for depth in depths]) / mm_per_px
        grows = np.r_[True, np.diff(radii) > 1e-6]
        slopes = np.array([profiles.at(depth)[1] for depth in depths[grows]])
        return cls(radii[grows], slopes, STEP_MM / mm_per_px)

    def columns(self, points_px: np.ndarray, pose_px: np.ndarray) -> np.ndarray:
        """Return (n, 9): the monomials, from degree 1 to 3, of the normal's x and y at points of the picture (n, 2)."""
        away = points_px - pose_px[:2]
        distance = np.hypot(*away.T) + 1e-9
        at = np.clip(np.interp(pose_px[2], self.radii_px, np.arange(len(self.radii_px))), 0, None)
        lower = min(int(at), len(self.radii_px) - 2)
        row = self.slopes[lower] + (at - lower) * (self.slopes[lower + 1] - self.slopes[lower])
        slope = np.interp(distance / self.step_px, np.arange(len(row)), row, right=0.0)
        x, y = slope / np.sqrt(1 + slope**2) / distance * away.T
        return cubic_of_normal(x, y)


@dataclass(frozen=True)
class _Change:
    """What a press changed: code values (h, w, 3), coarsely and finely smoothed; `clear` (h, w) of dots."""

    coarse: np.ndarray
    fine: np.ndarray
    clear: np.ndarray

    @classmethod
    def of(cls, picture: np.ndarray, reference: np.ndarray, dots: np.ndarray | None) -> "_Change":
        change = picture.astype(np.float32) - reference
        change -= np.median(change[::4, ::4].reshape(-1, 3), axis=0)  # a level that differs
        clear = np.ones(change.shape[:2], bool) if dots is None else ~(dots | found_dots(picture))
        coarse = _smoothed(change, clear, _BLUR_SHARE * change.shape[1])
        return cls(coarse, _smoothed(change, clear, _FINE_BLUR_PX), clear)

    def start(self) -> np.ndarray | None:
        """Return (3,) centre and radius, roughly; None without a contact.

        A dent is as much brighter on one side as it is darker on the other, so its centre is where the change is most
        odd: that is the least value of its convolution with itself. Its radius is where the change falls most.
        """
        import cv2

        if np.abs(self.coarse).max() < _LEAST_CHANGE:
            return None
        height, width, _ = self.coarse.shape
        spectrum = np.fft.rfft2(self.coarse, (2 * height, 2 * width), axes=(0, 1))
        oddness = -np.fft.irfft2((spectrum**2).sum(axis=2), (2 * height, 2 * width))
        row, column = np.array(np.unravel_index(oddness.argmax(), oddness.shape)) / 2
        angle = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
        radii = np.arange(_LEAST_RADIUS * width, min(height, width) // 2)[:, None]
        x, y = column + radii * np.cos(angle), row + radii * np.sin(angle)
        around = cv2.remap(self.coarse, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        seen = (x >= 0) & (x < width - 1) & (y >= 0) & (y < height - 1)
        much = np.linalg.norm(around, axis=2)
        mean = (much * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        step = np.gradient(np.where(seen.any(axis=1), mean, mean[seen.any(axis=1)][-1]))
        return np.array([column, row, radii[step.argmin(), 0] / _STEP_BEYOND_CONTACT])

    def samples(self, pose_px: np.ndarray, reach: float = _REACH) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, 2) around a contact, clear of dots, and the change there (n, 3); always the same ones."""
        share, turn = np.random.default_rng(0).uniform(size=(2, _SAMPLES))
        away, angle = reach * pose_px[2] * np.sqrt(share), 2 * np.pi * turn
        points = np.round(pose_px[:2] + np.column_stack([np.cos(angle), np.sin(angle)]) * away[:, None])
        height, width = self.clear.shape
        points = points[((points >= 0) & (points < (width, height))).all(axis=1)]
        columns, rows = points.T.astype(int)
        clear = self.clear[rows, columns]
        return points[clear], self.fine[rows, columns][clear].astype(float)


def _smoothed(change: np.ndarray, clear: np.ndarray, sigma_px: float) -> np.ndarray:
    import cv2

    weight = cv2.GaussianBlur(clear.astype(np.float32), (0, 0), sigma_px)[..., None]
    return cv2.GaussianBlur(change * clear[..., None], (0, 0), sigma_px) / np.maximum(weight, 1e-3)


def _coefficients(columns: np.ndarray, change: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (columns, 3): the weighted least-squares fit to a change (n, 3)."""
    weighted = columns.T * weight
    normal = weighted @ columns
    normal[np.diag_indices_from(normal)] += _RIDGE * np.trace(normal) / len(normal)
    return np.linalg.solve(normal, weighted @ change)


def _weights(error: np.ndarray) -> np.ndarray:
    """Return (n,): what errors (n, 3) weigh, the less the more they exceed the usual one."""
    size = np.linalg.norm(error, axis=1)
    return 1 / (1 + (size / (2 * (np.median(size) + 1))) ** 2)


def _placed(
    change: _Change, dents: _Dents, pose_px: np.ndarray, coefficients: np.ndarray | None = None
) -> np.ndarray:
    """Return (3,) centre and radius that explain a change best, by given coefficients or by those that fit it best."""
    from scipy.optimize import least_squares

    points, real = change.samples(pose_px)
    weight = np.ones(len(points))

    def error(pose: np.ndarray) -> np.ndarray:
        columns = dents.columns(points, pose)
        own = _coefficients(columns, real, weight) if coefficients is None else coefficients
        return real - columns @ own

    def weighted_error(pose: np.ndarray) -> np.ndarray:
        return (np.sqrt(weight)[:, None] * error(pose)).ravel()

    size_px = change.clear.shape[::-1]
    smallest = max(dents.radii_px[0], _LEAST_RADIUS * size_px[0])
    radius = np.clip(pose_px[2], smallest, max(smallest, dents.radii_px[-1]))
    center_px = np.clip(pose_px[:2], 0, size_px)
    low = np.array([*(center_px - _MOST_MOVED * radius), max(_SHRINKS * radius, smallest) - 1e-3])
    high = np.array([*(center_px + _MOST_MOVED * radius), min(_GROWS * radius, dents.radii_px[-1]) + 1e-3])
    for _ in range(2):
        start = np.clip(pose_px, low + 1e-4, high - 1e-4)
        options = {"bounds": (low, high), "diff_step": 2e-3, "max_nfev": _EVALUATIONS}
        pose_px = least_squares(weighted_error, start, **options).x
        weight = _weights(error(pose_px))  # in the second turn shadows weigh little
    return pose_px


def _level(change: _Change, dents: _Dents, pose_px: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return (3,): how far in x and y px from its centre a contact is level, and by what share gel in it is darker.

    By Gauss-Newton inside the contact alone, where the normal is the ball's: around it shadows lie, on one side.
    """
    off_px, darker = np.zeros(3), 0.0
    for _ in range(_LEVEL_ROUNDS):
        pose = pose_px + off_px
        points, real = change.samples(pose, _LEVEL_REACH)
        rest = reference[tuple(points.T[::-1].astype(int))].astype(float)
        columns, lit = dents.columns(points, pose), real + darker * rest
        weight = _weights(lit - columns @ _coefficients(columns, lit, np.ones(len(points))))
        own = _coefficients(columns, lit, weight)
        along = []
        for way in _DIFFERENCE_PX * np.eye(3)[:2]:
            change_of_columns = dents.columns(points, pose + way) - dents.columns(points, pose - way)
            along.append(change_of_columns @ own / (2 * _DIFFERENCE_PX))
        values = np.concatenate([*along, -rest, real], axis=1)
        left = np.sqrt(weight)[:, None] * (values - columns @ _coefficients(columns, values, weight))
        by_channel = left.reshape(-1, 4, 3).swapaxes(1, 2).reshape(-1, 4)
        step_x, step_y, darker = np.linalg.lstsq(by_channel[:, :3], by_channel[:, 3], rcond=None)[0]
        off_px[:2] += np.clip([step_x, step_y], -_MOST_LEVEL_STEP * pose[2], _MOST_LEVEL_STEP * pose[2])
    return np.array([*off_px[:2], darker])


def _shared(changes: Sequence[_Change], dents: _Dents, poses_px: np.ndarray) -> np.ndarray:
    """Return (n, 9, 3): one cubic of the normal at each press's place, of few presses linear in it."""
    height, width = changes[0].clear.shape
    degree = 2 if len(changes) >= FEWEST_FOR_GAIN else 1
    x, y = (2 * poses_px[:, :2] / (width, height) - 1).T
    places = monomials(x, y, degree)
    columns, real = [], []
    for change, pose, place in zip(changes, poses_px, places, strict=True):
        points, own = change.samples(pose)
        real.append(own)
        columns.append(np.einsum("nc,p->ncp", dents.columns(points, pose), place).reshape(len(points), -1))
    every, change_of_all = np.concatenate(columns), np.concatenate(real)
    weight = np.ones(len(every))
    for _ in range(3):
        coefficients = _coefficients(every, change_of_all, weight)
        weight = _weights(change_of_all - every @ coefficients)
    return np.einsum("cpk,np->nck", coefficients.reshape(-1, len(places[0]), 3), places)


def find_marks(
    reference: np.ndarray, pictures: Sequence[np.ndarray], profiles: PressProfiles, mm_per_px: float
) -> list[FoundMark | None]:
    """Return where a ball touches in each picture (h, w, 3) uint8 RGB; None where nothing differs from the reference.

    `profiles` are those of the membrane around that ball. Presses that the picture's edge cuts are found too.
    """
    import cv2

    scale = min(1.0, _WIDEST_PX / max(reference.shape))

    def seen(picture: np.ndarray) -> np.ndarray:
        return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)

    small = seen(reference)
    specks = found_dots(small)
    dots = specks if specks.mean() > LEAST_DOTS else None
    own = [seen(picture) for picture in pictures]
    changes = [_Change.of(picture, small, dots) for picture in own]
    starts = [change.start() for change in changes]
    pressed = [number for number, start in enumerate(starts) if start is not None]
    found: list[FoundMark | None] = [None] * len(pictures)
    if not pressed:
        return found
    dents = _Dents.of(profiles, mm_per_px / scale)
    dented = [changes[number] for number in pressed]
    poses = []
    for number in pressed:
        pose = starts[number]
        for _ in range(_ROUNDS):
            pose = _placed(changes[number], dents, pose)
        poses.append(pose)
    if len(pressed) >= FEWEST_FOR_GAIN:
        for _ in range(_SHARED_ROUNDS):
            cubics = _shared(dented, dents, np.array(poses))
            placed = zip(dented, poses, cubics, strict=True)
            poses = [_placed(change, dents, pose, cubic) for change, pose, cubic in placed]
        level = [_level(change, dents, pose, small) for change, pose in zip(dented, poses, strict=True)]
        x_px, y_px, darker = np.median(level, axis=0)
        if darker > _LEAST_DARKENING:
            poses = [pose + np.array([x_px, y_px, 0.0]) for pose in poses]
    cubics = _shared(dented, dents, np.array(poses))
    for number, pose, cubic in zip(pressed, poses, cubics, strict=True):
        found[number] = _mark(own[number], small, changes[number], dents, pose, cubic, scale)
    return found


def _moved(picture: np.ndarray, reference: np.ndarray, pose_px: np.ndarray) -> tuple[float, float]:
    """Return by how many pixels dust and seams beyond a dent are shifted, by phase correlation, and their share left.

    The share is the slope of the picture's detail over the reference's, which noise makes less than 1 in any picture.
    """
    import cv2

    far = radii_away(picture, pose_px[:2], pose_px[2]) > _FAR
    grey = [image.mean(axis=2).astype(np.float32) for image in (reference, picture)]
    detail = [(own - cv2.GaussianBlur(own, (0, 0), _DETAIL_PX)) * far for own in grey]
    (x, y), response = cv2.phaseCorrelate(*(own.astype(float) for own in detail))
    least = max(_LEAST_RESPONSE, _NOISE_RESPONSE / np.sqrt(far.sum() + 1))
    rest, own = detail
    share = float((rest * own).sum() / max((rest**2).sum(), 1e-9))
    return (float(np.hypot(x, y)) if response > least else 0.0), share


def _mark(
    picture: np.ndarray,
    reference: np.ndarray,
    change: _Change,
    dents: _Dents,
    pose_px: np.ndarray,
    cubic: np.ndarray,
    scale: float,
) -> FoundMark:
    points, real = change.samples(pose_px)
    error = real - dents.columns(points, pose_px) @ cubic
    size = np.linalg.norm(change.coarse, axis=2)
    far = radii_away(picture, pose_px[:2], pose_px[2]) > _BEYOND
    corner_px = np.array([0.5, 0.5, 0])
    x, y, radius = ((pose_px + corner_px) / scale - corner_px).tolist()
    shift_px, detail = _moved(picture, reference, pose_px)
    return FoundMark(
        center_px=(x, y),
        radius_px=radius,
        unexplained=float(np.sqrt((error**2).sum() / max((real**2).sum(), 1e-9))),
        beyond=float(size.max(where=far, initial=0) / size.max(where=~far, initial=1e-9)),
        shift_px=shift_px / scale,
        detail=detail,
        is_largest=bool(pose_px[2] > 0.995 * dents.radii_px[-1]),
    )
