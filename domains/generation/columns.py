"""How each column of a domain is made: labels from a contact, pictures and points by a renderer.

`gelgap.data.formats.shards` says what the columns are.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from gelgap.data.formats.shards import OPTIONAL, height_codes, picture_cell
from gelgap.render import MembraneRenderer, marker_rest_mm
from gelgap.sim import MembraneState, Pose


class Contact(NamedTuple):
    """What the labels of one frame are made from; `force_n` is what the force sensor reads, the state's is true."""

    frame: int
    pose: Pose
    trajectory: int
    step: int
    split: str
    state: MembraneState
    force_n: tuple[float, ...]
    indenter: str


class View(NamedTuple):
    """One contact as a sensor sees it; `coarse_n` is its contact force by cells of the view, if that is wanted."""

    renderer: MembraneRenderer
    state: MembraneState
    coarse_n: np.ndarray | None = None

    @property
    def membrane(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The arguments by which a renderer takes the membrane: x, y and displacement, mm."""
        return self.state.x_mm, self.state.y_mm, self.state.displacement_mm


def _height_map(view: View) -> dict[str, Any]:
    return picture_cell(height_codes(view.renderer.height_map_mm(*view.membrane)))


def _contact_mask(view: View) -> dict[str, Any]:
    mask = view.renderer.contact_mask(*view.membrane, view.state.contact)
    return picture_cell(mask.astype(np.uint8) * 255)


def _marker_rest_mm(view: View) -> list[list[float]]:
    return _point_list(marker_rest_mm(view.renderer.sensor.markers))


def _marker_px(view: View) -> list[list[float]]:
    return _point_list(view.renderer.marker_px(*view.membrane))


def _traction(view: View) -> list[float] | None:
    return None if view.coarse_n is None else view.coarse_n.astype(np.float32).ravel().tolist()


def _point_list(points: np.ndarray) -> list[list[float]]:
    return points.reshape(-1, 2).astype(np.float32).tolist()


def _angle_deg(contact: Contact) -> float | None:
    return contact.pose.angle_deg if contact.pose.radius_mm else None


def _diagnostic(name: str) -> Callable[[Contact], Any]:
    return lambda contact: getattr(contact.state.diagnostics, name)


def _torque(axis: int) -> Callable[[Contact], float]:
    return lambda contact: float(contact.state.torque_n_mm[axis])


LABEL_MAKERS: dict[str, Callable[[Contact], Any]] = {
    "frame_id": lambda contact: contact.frame,
    "point_id": lambda contact: contact.pose.point_id,
    "contact_class": lambda contact: contact.pose.contact_class,
    "depth_mm": lambda contact: contact.pose.depth_mm,
    "radius_mm": lambda contact: contact.pose.radius_mm,
    "angle_deg": _angle_deg,
    "trajectory_id": lambda contact: contact.trajectory,
    "step": lambda contact: contact.step,
    "x_mm": lambda contact: contact.pose.point_x_mm,
    "y_mm": lambda contact: contact.pose.point_y_mm,
    "commanded_z_mm": lambda contact: -contact.pose.depth_mm,
    "shear_x_mm": lambda contact: contact.pose.shear_x_mm,
    "shear_y_mm": lambda contact: contact.pose.shear_y_mm,
    "fx_n": lambda contact: contact.force_n[0],
    "fy_n": lambda contact: contact.force_n[1],
    "fz_n": lambda contact: contact.force_n[2],
    "converged": lambda contact: bool(contact.state.converged),
    "contact_radius_mm": lambda contact: float(contact.state.contact_radius_mm),
    "split": lambda contact: contact.split,
    "indenter": lambda contact: contact.indenter,
    "tx_n_mm": _torque(0),
    "ty_n_mm": _torque(1),
    "tz_n_mm": _torque(2),
    "roll_x_deg": lambda contact: contact.pose.turn_deg[0],
    "roll_y_deg": lambda contact: contact.pose.turn_deg[1],
    "twist_deg": lambda contact: contact.pose.turn_deg[2],
    **{column.name: _diagnostic(column.name) for column in OPTIONAL["diagnostics"]},
}
"""What makes each label of one frame."""
CELL_MAKERS: dict[str, Callable[[View], Any]] = {
    "height_map": _height_map,
    "contact_mask": _contact_mask,
    "marker_rest_mm": _marker_rest_mm,
    "marker_px": _marker_px,
    "traction_n": _traction,
}
"""What makes each column that frames without a picture do not have."""
