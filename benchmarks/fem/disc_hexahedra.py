"""Half a disc of hexahedra, on the same plane cells as the meshes of `gelgap.sim`."""

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh.plane import DiscGrid, half_disc


def half_disc_hexahedra(
    grid: DiscGrid, layers_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the nodes (n, 3) and hexahedra (m, 8) of layers whose z, from 0 down, are `layers_mm`."""
    plane, quads = half_disc(grid)
    points = np.concatenate([np.column_stack([plane, np.full(len(plane), z)]) for z in layers_mm])
    hexes = [
        np.concatenate([quads + (layer + 1) * len(plane), quads + layer * len(plane)], axis=1)
        for layer in range(len(layers_mm) - 1)
    ]
    return points, np.concatenate(hexes)
