"""What a fit is worth: presses that it has not seen, predicted by fits without them.

That decides how much the table of normals counts and whether what is left around the ball is kept, and refuses a fit
that predicts worse than the unchanged reference.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gelgap.calibrate.fit import LightFit
from gelgap.calibrate.poses import MODELLED_MM, SCORED_RADII
from gelgap.calibrate.residual import residual_around
from gelgap.render.normal_table import NormalTable
from gelgap.render.sensor import BallResidual

# Presses nearer to each other than this share of their imprints' radius are at one place.
_SAME_PLACE = 0.1
_FEWEST_FITTED = 3
# Shares of the table of normals that are tried, from the fitted light alone to the table alone.
TABLE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# A residual around balls that gains in one region may cost a held-out press this much in the other.
_MOST_LOST_DB = 0.2


@dataclass(frozen=True)
class HeldOut:
    """How a press that the fit had not seen was predicted, PSNR in dB: inside its contact, and from one to two radii.

    `marked` takes the press as far off its mark as the fitted ones say (`LightFit.expected_mm`), and uses nothing of
    its picture but its level far from the contact; `refined` moves its centre and depth in its own picture. Both are
    drawn by the fitted light and the share of the table of normals that predicts best, with what both leave around the
    ball if that is kept. `unchanged` is the reference, `table` the table alone, of the presses that were fitted;
    `picture` is the one as marked.
    """

    name: str
    unchanged: tuple[float, float]
    table: tuple[float, float]
    marked: tuple[float, float]
    refined: tuple[float, float]
    picture: np.ndarray = field(repr=False)  # uint8 (h, w, 3)


@dataclass(frozen=True)
class Checked:
    """Presses as predicted by fits without them, and what they decide: share of the table, residual if it helps."""

    presses: tuple[HeldOut, ...]
    share: float
    residual: BallResidual | None


def hold_out(fit_to: Callable[[np.ndarray], LightFit], fit: LightFit, folds: int) -> Checked:
    """Predict each press of a fit by another, which `fit_to` makes of the presses at other places (their indices).

    Raises
    ------
    ValueError
        If presses lie at too few places, or are predicted worse than by the unchanged reference.
    """
    used, placed = fit.which, fit.placed
    parts = [used[part] for part in held_out_parts(placed.centers_px[used], placed.radii_px[used], folds)]
    if not parts:
        return Checked((), 0.0, None)
    blind = [fit_to(np.setdiff1d(used, part)) for part in parts]
    drawn = [press for other, part in zip(blind, parts, strict=True) for press in _drawn(other, part)]
    share = table_share([press.levels(TABLE_SHARES) for press in drawn])
    residual = fit.ball_residual(share)
    if residual is not None:
        residuals = {other: other.ball_residual(share) for other in blind}
        whole = [replace(press, residual=residuals[press.fit]) for press in drawn]
        if _predicts_better(whole, drawn, share):
            drawn = whole
        else:
            residual = None
    presses = tuple(press.held_out(share) for press in drawn)
    _check_prediction(presses)
    return Checked(presses, share, residual)


def held_out_parts(centers_px: np.ndarray, radii_px: np.ndarray, folds: int) -> list[np.ndarray]:
    """Return the indices of presses at `centers_px` (n, 2) that are held out together, at most `folds` times.

    Presses at one place are alike: one that is fitted would tell what the others look like.

    Raises
    ------
    ValueError
        If they lie at so few places that too few are left to fit.
    """
    firsts: list[int] = []  # of each place
    place = np.empty(len(centers_px), int)
    for press, (center, radius) in enumerate(zip(centers_px, radii_px, strict=True)):
        near = np.hypot(*(centers_px[firsts] - center).T) < _SAME_PLACE * radius
        if not near.any():
            firsts.append(press)
        place[press] = near.argmax() if near.any() else len(firsts) - 1
    parts = [np.flatnonzero(place % folds == fold) for fold in range(min(folds, len(firsts)))]
    if any(len(place) - len(part) < _FEWEST_FITTED for part in parts):
        raise ValueError(
            f"{len(place)} presses lie at {len(firsts)} places, and those of one place are held out together: fewer "
            f"than {_FEWEST_FITTED} would be left to fit; press at more places"
        )
    return parts


def _check_prediction(held_out: Sequence[HeldOut]) -> None:
    """Refuse a fit that is worse than the unchanged reference in a region; the table of normals says what is wrong."""
    marked = np.median([press.marked for press in held_out], axis=0)
    unchanged = np.median([press.unchanged for press in held_out], axis=0)
    table = np.median([press.table for press in held_out], axis=0)
    for where, fitted, least, plain in zip(("inside", "around"), marked, unchanged, table, strict=True):
        if fitted > least:
            continue
        advice = (
            "their table of normals predicts them, so that pictures and marks belong together: check the "
            "spheres' diameters, the scale (mm per px or the camera's field of view) and depths or radii"
            if plain > least
            else "nor does their table of normals: check that the reference, the pictures and their marks "
            "belong together, and that the presses are alike where they are near each other"
        )
        raise ValueError(
            f"{where} the contact the fit predicts presses that it has not seen worse than the unchanged reference "
            f"picture does ({fitted:.1f} against {least:.1f} dB); {advice} ({plain:.1f} dB)"
        )


@dataclass(frozen=True)
class _Drawn:
    """A press that a fit has not seen, as its light, its table and perhaps its residual around balls draw it."""

    fit: LightFit
    press: int
    table: NormalTable
    marked: tuple[np.ndarray, ...]
    residual: BallResidual | None = None

    def picture(self, pictures: tuple[np.ndarray, ...], share: float) -> np.ndarray:
        """Return the uint8 picture (h, w, 3) with a share of the table."""
        light, table, away, contact = pictures
        code = light + share * (table - light)
        if self.residual is not None:
            code = code + residual_around(self.residual, away, contact).reshape(code.shape)
        return np.clip(np.round(code), 0, 255).astype(np.uint8)

    def levels(self, shares: Sequence[float]) -> list[tuple[float, float]]:
        """Return the scores as marked, for each share of the table."""
        return [self.fit.placed.scores(self.press, self.picture(self.marked, share)) for share in shares]

    def held_out(self, share: float) -> HeldOut:
        """Return how the press is predicted with a share of the table."""
        seen, press, marked = self.fit.placed, self.press, self.picture(self.marked, share)
        refined = _pictures(self.fit, self.table, press, self.fit.refined(press).presses[0])
        return HeldOut(
            seen.names[press],
            unchanged=seen.scores(press, seen.reference),
            table=seen.scores(press, self.marked[1]),
            marked=seen.scores(press, marked),
            refined=seen.scores(press, self.picture(refined, share)),
            picture=marked,
        )


def _pictures(fit: LightFit, table: NormalTable, press: int, pose_mm: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return a press by light and by table, in code values (h, w, 3), how far from it pixels see, in radii, and it."""
    placed = fit.placed
    reach_mm = max(MODELLED_MM, 1.25 * SCORED_RADII * placed.mark_mm[press])  # it may be off its mark
    seen = placed.seen(press, pose_mm)
    normals = seen.normals.reshape(placed.reference.shape)
    plain = placed.at_level(press, table.picture(placed.clean_reference, normals, placed.camera), fit.field)
    lit = placed.picture_of(fit.light, fit.field, press, pose_mm, reach_mm)
    radius_mm = placed.profiles[press].contact_radius_mm(pose_mm[2])
    away = (seen.positions[:, :2] - pose_mm[:2]) / radius_mm
    return lit, plain, away, np.array([*pose_mm[:2] / placed.half_view_mm, radius_mm])


def _drawn(fit: LightFit, part: np.ndarray) -> list[_Drawn]:
    """Return the presses of a part as the fit without it draws them."""
    table, expected = fit.normal_table(), [(press, fit.expected_mm(press)) for press in part.tolist()]
    return [_Drawn(fit, press, table, _pictures(fit, table, press, pose)) for press, pose in expected]


def _predicts_better(drawn: Sequence[_Drawn], other: Sequence[_Drawn], share: float) -> bool:
    """Return whether the sum of the median PSNRs, inside and around, is larger, and neither much smaller."""
    new, old = (np.median([press.levels((share,))[0] for press in own], axis=0) for own in (drawn, other))
    return bool((new - old).sum() > 0 and (new - old).min() > -_MOST_LOST_DB)


def table_share(levels: Sequence[Sequence[tuple[float, float]]]) -> float:
    """Return the one of `TABLE_SHARES` that predicts best, by PSNR of each press with each share, inside and around.

    That is the largest sum of both medians, of those shares with which neither is below the table's alone.
    """
    medians = np.median(levels, axis=0)
    better = (medians >= medians[-1]).all(axis=1)
    return TABLE_SHARES[int(np.where(better, medians.sum(axis=1), -np.inf).argmax())]
