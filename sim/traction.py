"""What happens between membrane and indenter: contact stress on the rest grid, forces on a coarse grid, and slip.

The stress is that of the vertices' contact forces over their shares of the deformed surface, interpolated. What that
loses of the force and the torque is given back where the stress is, so that the map's integrals are the labels.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.assets.array_file import write_arrays
from gelgap.assets.names import one_line
from gelgap.sim.indenter import Floats
from gelgap.sim.membrane import GRID_HALF_EXTENT_MM, MembraneState

COARSE_SHAPE = (24, 32)


@dataclass(frozen=True, eq=False)
class Traction:
    """Contact stress on a state's rest grid.

    `traction_mpa` (ny, nx, 3) is the indenter's force on the membrane per deformed area, in the sensor's axes, and
    `area_mm2` (ny, nx) that area: the sum of their product is the state's force, and of its moment the torque, to
    1e-6. `correction` is the share of the map that was added for this.
    """

    __repr__ = one_line

    state: MembraneState
    point_mm: tuple[float, float]
    traction_mpa: Floats
    area_mm2: Floats
    correction: float

    @property
    def cell_force_n(self) -> Floats:
        """The force (ny, nx, 3) of each grid point's part of the membrane."""
        return self.traction_mpa * self.area_mm2[..., None]

    @property
    def force_n(self) -> Floats:
        """The map's integral (3,)."""
        return self.cell_force_n.sum(axis=(0, 1))

    @property
    def torque_n_mm(self) -> Floats:
        """The map's torque (3,) about the contact point."""
        return np.cross(self.places_mm, self.cell_force_n).sum(axis=(0, 1))

    @cached_property
    def places_mm(self) -> Floats:
        """Where the grid's points (ny, nx, 3) are, from the contact point."""
        return self.state.places_mm - [*self.point_mm, 0.0]

    @property
    def normal_mpa(self) -> Floats:
        """The pressure (ny, nx): the stress against the deformed membrane's outward normal."""
        return -(self.traction_mpa * self._normals).sum(axis=-1)

    @property
    def tangential_mpa(self) -> Floats:
        """The size of the stress along the deformed membrane, (ny, nx)."""
        along = self.traction_mpa + self.normal_mpa[..., None] * self._normals
        return np.linalg.norm(along, axis=-1)

    @cached_property
    def _normals(self) -> Floats:
        area = _area_vectors_mm2(self.state.places_mm)
        return area / np.linalg.norm(area, axis=-1, keepdims=True)

    def coarse_n(self, half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM) -> Floats:
        """Return the force (24, 32, 3) in N on each cell of a coarse grid around the sensor's centre.

        A point's force goes to the cell that the point is in, as deformed, or to the outermost ones beyond the extent:
        the sum is the force.
        """
        place, (rows, columns) = self.state.places_mm, COARSE_SHAPE
        column = np.floor((place[..., 0] / half_extent_mm[0] + 1) / 2 * columns).clip(0, columns - 1)
        row = np.floor((place[..., 1] / half_extent_mm[1] + 1) / 2 * rows).clip(0, rows - 1)
        cell = (row * columns + column).astype(int).ravel()
        sums = [np.bincount(cell, own, rows * columns) for own in self.cell_force_n.reshape(-1, 3).T]
        return np.stack(sums, axis=-1).reshape(rows, columns, 3).astype(float)

    def save(self, path: str | Path) -> None:
        """Write an npz of x_mm, y_mm, traction_mpa, area_mm2, normal_mpa, tangential_mpa and coarse_n."""
        names = ("traction_mpa", "area_mm2", "normal_mpa", "tangential_mpa")
        own = {name: getattr(self, name) for name in names} | {"coarse_n": self.coarse_n()}
        write_arrays(path, {"x_mm": self.state.x_mm, "y_mm": self.state.y_mm} | own)


def balanced_traction(state: MembraneState, point_mm: tuple[float, float], traction_mpa: Floats) -> Traction:
    """Return a state's contact stress (ny, nx, 3), changed so that its integrals are the state's force and torque.

    What is added is |t| (a + b × x), with a and b constant.
    """
    area_mm2 = np.linalg.norm(_area_vectors_mm2(state.places_mm), axis=-1)
    found = Traction(state, point_mm, traction_mpa, area_mm2, 0.0)
    if not traction_mpa.any():
        return found
    weight = np.linalg.norm(found.traction_mpa, axis=-1)
    touched = np.nonzero(weight > 0)
    weight, place, area = weight[touched], found.places_mm[touched], found.area_mm2[touched]
    # Columns: what each of the six components of (a, b) adds to the map.
    shapes = np.stack([*np.broadcast_to(np.eye(3)[:, None], (3, len(place), 3))])
    turns = np.stack([np.cross(axis, place) for axis in np.eye(3)])
    modes = np.concatenate([shapes, turns]) * weight[:, None]
    forces = modes * area[:, None]
    sums = np.concatenate([forces.sum(axis=1), np.cross(place, forces).sum(axis=1)], axis=1)
    wanted = np.concatenate([found.state.force_n, found.state.torque_n_mm])
    missing = wanted - np.concatenate([found.force_n, found.torque_n_mm])
    factors = np.linalg.lstsq(sums.T, missing, rcond=1e-12)[0]
    added = np.tensordot(factors, modes, 1)
    traction = found.traction_mpa.copy()
    traction[touched] += added
    share = np.abs(added).sum() / max(np.abs(traction).sum(), 1e-300)
    return replace(found, traction_mpa=traction, correction=float(share))


def _area_vectors_mm2(places_mm: Floats) -> Floats:
    """Return the deformed area (ny, nx, 3) of each grid point's part of the membrane, along its outward normal."""
    along_y, along_x = np.gradient(places_mm, axis=(0, 1))
    return np.cross(along_x, along_y)


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
        write_arrays(path, {"x_mm": self.x_mm, "y_mm": self.y_mm, "slip_mm": self.slip_mm})
