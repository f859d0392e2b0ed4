"""The deformed outer membrane of one pose, with the force that deforms it."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gelgap.assets.array_file import read_arrays

GRID_SPACING_MM = 0.1
GRID_HALF_EXTENT_MM = (7.0, 5.5)

# The arrays of a saved state.
_NEEDED = ("x_mm", "y_mm", "displacement_mm")
_OPTIONAL = ("contact", "force_n", "contact_radius_mm", "converged")


def grid_axes(
    half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rest grid's axes, centred on the sensor: x_mm (141,) and y_mm (111,), or more values.

    The grid reaches at least `half_extent_mm` from the centre along x and y, and never less far than by default.
    """
    x_mm, y_mm = map(_axis_mm, GRID_HALF_EXTENT_MM, half_extent_mm)
    return x_mm, y_mm


def _axis_mm(least_mm: float, wanted_mm: float) -> NDArray[np.float64]:
    cells = math.ceil(max(least_mm, wanted_mm) / GRID_SPACING_MM - 1e-3)
    return np.round(np.arange(-cells, cells + 1) * GRID_SPACING_MM, 9)


@dataclass(frozen=True)
class Diagnostics:
    """How a pose was solved, for labels and for trust.

    `residual` is the largest force on a free vertex and `imbalance` the difference of the forces on indenter and
    backing, both over the indenter's force; `coulomb_excess` the largest `|f_t| / (μ f_n) − 1` over the contact's
    vertices, −1 without friction; `tension` the largest pull on one of them over the largest push. `sticking_fraction`
    is the share of the normal force carried by vertices that stick; `slip_mm` the largest sideways slip of a vertex on
    the path so far; `elastic_energy_mj` the energy stored in the gel, mJ; `min_volume_ratio` the smallest element's
    volume over its rest volume.
    """

    residual: float = 0.0
    iterations: int = 0
    sticking_fraction: float = 1.0
    slip_mm: float = 0.0
    elastic_energy_mj: float = 0.0
    min_volume_ratio: float = 1.0
    imbalance: float = 0.0
    coulomb_excess: float = -1.0
    tension: float = 0.0


@dataclass(frozen=True)
class MembraneState:
    """The outer membrane on its rest grid, in the sensor's frame.

    `displacement_mm` is (ny, nx, 3), `contact` (ny, nx) bool, `force_n` (3,) the force of the indenter on the sensor,
    `contact_radius_mm` the deformed radius where the normal pressure vanishes (0 without contact).
    """

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    displacement_mm: NDArray[np.float32]
    contact: NDArray[np.bool_]
    force_n: NDArray[np.float64]
    contact_radius_mm: float = 0.0
    converged: bool = True
    diagnostics: Diagnostics = field(default_factory=Diagnostics)

    def save(self, path: str | Path) -> None:
        """Write the state to an npz file (keys x_mm, y_mm, displacement_mm, contact, force_n, and scalars)."""
        arrays = {name: getattr(self, name) for name in (*_NEEDED, *_OPTIONAL)}
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a state that `save` wrote, or any npz with x_mm, y_mm and displacement_mm.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not an .npz file of arrays, one is missing or damaged, or shapes or types do not match.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"membrane state {path} does not exist")
        try:
            arrays = read_arrays(path, (*_NEEDED, *_OPTIONAL))
        except ValueError as error:
            raise ValueError(f"{path} is not an .npz file of arrays ({error})") from None
        missing = [name for name in _NEEDED if name not in arrays]
        if missing:
            raise ValueError(
                f"{path} lacks {', '.join(missing)}: a membrane state needs {', '.join(_NEEDED)}"
            )
        x_mm, y_mm, displacement_mm = (arrays[name] for name in _NEEDED)
        shape = (y_mm.size, x_mm.size)
        shapes = {
            "x_mm": shape[1:],
            "y_mm": shape[:1],
            "displacement_mm": (*shape, 3),
            "contact": shape,
            "force_n": (3,),
            "contact_radius_mm": (),
            "converged": (),
        }
        for name, values in arrays.items():
            if values.dtype.kind not in "biuf":
                raise ValueError(f"{name} in {path} holds {values.dtype}: must be numbers")
            if values.shape != shapes[name]:
                raise ValueError(f"{name} in {path} has shape {values.shape}: must be {shapes[name]}")
        return cls(
            x_mm=x_mm,
            y_mm=y_mm,
            displacement_mm=displacement_mm,
            contact=arrays.get("contact", np.zeros(shape, dtype=bool)),
            force_n=arrays.get("force_n", np.zeros(3)),
            contact_radius_mm=float(arrays.get("contact_radius_mm", 0.0)),
            converged=bool(arrays.get("converged", True)),
        )


def flat_state(half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM) -> MembraneState:
    """Return the undeformed membrane, without contact, on the grid of `grid_axes`."""
    x_mm, y_mm = grid_axes(half_extent_mm)
    shape = (len(y_mm), len(x_mm))
    return MembraneState(
        x_mm, y_mm, np.zeros((*shape, 3), np.float32), np.zeros(shape, dtype=bool), np.zeros(3)
    )
