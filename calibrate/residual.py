"""What a fit leaves around contacts of one ball, by place: as the rim, a thinner line than a solved membrane's.

Presses held out in three parts of seven sets gain 0.4 to 6.7 dB inside their contacts by it, and 1.8 to 6.4 around
(results/sensors.md). No renderer draws it: it is part of what a calibration predicts of its own ball.
"""

import numpy as np

from gelgap.render.sensor import RESIDUAL_TERMS, BallResidual

# In radii of the contact: between them it is linear, and 0 from the last on, as far as a fit sees. Where it ended at
# 2.6, predicted pictures had a disc around the dent, and 4 to 5 dB less there (FOTS).
_NEAR = (0.0, 0.25, 0.5, 0.65, 0.75, 0.83, 0.9, 0.96, 1.02, 1.08, 1.15, 1.25, 1.38)
_KNOTS = (*_NEAR, 1.55, 1.8, 2.15, 2.7, 3.5, 4.5)
_ORDERS = 4  # of waves around the contact
_WAVES = 2 * _ORDERS + 1
_SHAPES = (len(_KNOTS) - 1) * _WAVES
# The regularisation, in units of one press: `_RIDGE` draws each coefficient to 0 by its own weight, `_LEAST_RIDGE` all
# by the same; `_BEND` smooths over the radius, without which small contacts show rings. Slopes over the contacts' place
# and radius are regularised `_SLOPES` times as much.
_RIDGE, _LEAST_RIDGE, _BEND, _SLOPES = 0.15, 1e-3, 1.0, 3.0
_BY_RADIUS = np.diff(np.eye(len(_KNOTS))[:, :-1], 2, axis=0)
_BENDS = np.kron(_BY_RADIUS.T @ _BY_RADIUS, np.eye(_WAVES))
_FEWEST_BY_RADIUS = 8  # fewer than two for each term have no slope over the radius
_LEAST_HALF_RANGE = 0.01  # half views, mm: what varies less is noise
# By what share a ball's diameter and contact may differ from the fitted ones.
_MOST_OTHER = 0.1


def fitted_residual(
    diameter_mm: float,
    contacts: np.ndarray,
    index: np.ndarray,
    away: np.ndarray,
    left: np.ndarray,
    usable: np.ndarray,
) -> BallResidual:
    """Fit the residual of `contacts` (k, 3) to what is left (n, 3), where that is usable (n, 3).

    Each point is of the contact `index` (n,), and off it by `away` (n, 2) of its radii.
    """
    least, largest = contacts.min(axis=0), contacts.max(axis=0)
    terms = _terms(contacts, least, largest)
    terms[:, 3] *= len(contacts) >= _FEWEST_BY_RADIUS
    normal = np.zeros((3, RESIDUAL_TERMS, RESIDUAL_TERMS))
    right = np.zeros((3, RESIDUAL_TERMS, 1))
    for contact, contact_terms in enumerate(terms):
        of_it = index == contact
        shapes = _shapes(away[of_it])
        weighted = usable[of_it].T[:, None] * shapes.T  # (3, shapes, n)
        normal += np.kron(np.outer(contact_terms, contact_terms), weighted @ shapes)
        right += np.kron(contact_terms[:, None], weighted @ left[of_it].T[:, :, None])
    by_shape = normal.diagonal(axis1=1, axis2=2)[:, :_SHAPES, None] / len(contacts)
    level = by_shape.mean()  # of all channels, since a dark one shows nothing
    ridge = (_RIDGE * by_shape + _LEAST_RIDGE * level) * np.eye(_SHAPES) + _BEND * level * _BENDS
    solved = np.linalg.solve(normal + np.kron(np.diag([1, _SLOPES, _SLOPES, _SLOPES]), ridge), right)
    rounded = solved[..., 0].T.clip(-255, 255).round(2).tolist()
    return BallResidual(
        diameter_mm=diameter_mm, least=tuple(least), largest=tuple(largest), coefficients=rounded
    )


def holds_for(residual: BallResidual, diameter_mm: float, contact_radius_mm: float) -> bool:
    """Return whether a ball is the residual's, and pressed about as deep."""
    is_ball = abs(diameter_mm / residual.diameter_mm - 1) <= _MOST_OTHER
    least_mm, largest_mm = (1 - _MOST_OTHER) * residual.least[2], (1 + _MOST_OTHER) * residual.largest[2]
    return is_ball and least_mm <= contact_radius_mm <= largest_mm


def residual_around(residual: BallResidual, away: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Return (n, 3) code values at points `away` (n, 2) from a contact (3,), beyond fitted ones as at their end."""
    near, left = np.hypot(*away.T) < _KNOTS[-1], np.zeros((len(away), 3))
    (terms,) = _terms(contact[None], np.array(residual.least), np.array(residual.largest))
    by_term = np.reshape(residual.coefficients, (4, _SHAPES, 3))
    left[near] = _shapes(away[near]) @ np.tensordot(terms, by_term, 1)
    return left


def _terms(contacts: np.ndarray, least: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Return (k, 4): 1, and where contacts (k, 3) are between the least, −1, and the largest, 1."""
    half = np.maximum((largest - least) / 2, _LEAST_HALF_RANGE)
    return np.column_stack([np.ones(len(contacts)), ((contacts - (least + largest) / 2) / half).clip(-1, 1)])


def _shapes(away: np.ndarray) -> np.ndarray:
    """Return (n, shapes): each hat of the radius times each wave of the angle."""
    radius, angle = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
    hats = [np.interp(radius, _KNOTS, hat) for hat in np.eye(len(_KNOTS))[:-1]]
    waves = [np.ones_like(angle)]
    for order in range(1, _ORDERS + 1):
        waves += [np.cos(order * angle), np.sin(order * angle)]
    shapes = np.stack(hats, axis=1)[:, :, None] * np.stack(waves, axis=1)[:, None]
    shapes[:, 0, 1:] = 0.0  # a wave has no value at the centre
    return shapes.reshape(len(away), _SHAPES)
