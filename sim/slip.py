"""How far the membrane has slid over the indenter, from one pose of a contact to a later one."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gelgap.assets.names import one_line
from gelgap.sim.indenter import Floats
from gelgap.sim.membrane import MembraneState


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


class Stand(NamedTuple):
    """Where an indenter's origin (3,) is on the sensor, and how it is turned (3, 3)."""

    origin_mm: Floats
    turn: Floats


def slip_between(first: MembraneState, first_stand: Stand, then: MembraneState, then_stand: Stand) -> Slip:
    """Return how far the membrane has slid over the indenter between two poses of one solve, on one grid.

    Where the membrane sticks, it goes where the indenter's travel and turn carry it; slip is how far it is from there.
    """
    turn = then_stand.turn @ first_stand.turn.T
    carried_mm = then_stand.origin_mm + (first.places_mm - first_stand.origin_mm) @ turn.T
    touching = first.contact & then.contact
    slip_mm = np.where(touching[..., None], then.places_mm - carried_mm, np.nan)
    return Slip(then.x_mm, then.y_mm, slip_mm)
