"""How far the membrane has slid over the indenter, from one pose of a contact to a later one."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.assets.names import one_line
from gelgap.sim.indenter import Floats, rotation

if TYPE_CHECKING:
    from gelgap.sim.solved import ContactSolve


@dataclass(frozen=True, eq=False)
class Slip:
    """How far the membrane has slid over the indenter since an earlier pose, on the rest grid.

    `slip_mm` (ny, nx, 3) is in the sensor's axes, and NaN where the membrane does not touch the indenter at both poses.
    It is net slip: what went and came back is none. At the contact's rim, where the grid is finer than the mesh, it is
    uncertain by some hundredths of a millimetre.
    """

    __repr__ = one_line

    x_mm: Floats
    y_mm: Floats
    slip_mm: Floats

    def save(self, path: str | Path) -> None:
        """Write an npz of x_mm, y_mm and slip_mm."""
        with Path(path).open("wb") as file:
            np.savez_compressed(file, x_mm=self.x_mm, y_mm=self.y_mm, slip_mm=self.slip_mm)


def slip_between(before: "ContactSolve", after: "ContactSolve") -> Slip:
    """Return how far the membrane has slid over the indenter between two poses of one solve.

    Where the membrane sticks, it goes where the indenter's travel and turn carry it; slip is how far it is from there.
    """
    first = before.state()
    then = after.state((first.x_mm[-1], first.y_mm[-1]))
    if then.contact.shape != first.contact.shape:
        first = before.state((then.x_mm[-1], then.y_mm[-1]))
    (origin_mm, turn), (origin_then_mm, turn_then) = _stand(before), _stand(after)
    carried_mm = origin_then_mm + (first.places_mm - origin_mm) @ (turn_then @ turn.T).T
    touching = first.contact & then.contact
    slip_mm = np.where(touching[..., None], then.places_mm - carried_mm, np.nan)
    return Slip(then.x_mm, then.y_mm, slip_mm)


def _stand(contact: "ContactSolve") -> tuple[Floats, Floats]:
    """Return where an indenter's origin is (3,), and how it is turned (3, 3), on the sensor."""
    pose = contact.pose
    height_mm = contact.indenter.turned(pose.turn_deg).origin_height_mm
    origin_mm = contact.indenter_mm + np.array([pose.point_x_mm, pose.point_y_mm, height_mm])
    return origin_mm, rotation(np.array(pose.turn_deg))
