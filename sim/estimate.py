"""How far a pose may be off because its mesh is no finer: what a user may trust in a state that is in equilibrium.

Each cause of error is a number that the solve has anyway; how much error comes with it is calibrated on random scenes
(`scripts/calibrate_estimate.py`) beside finer meshes and an axisymmetric solver: an estimate is the standard deviation
of the true errors of scenes with the same causes.
"""

import math

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh import cell_mm, stiffness_excess
from gelgap.sim.problem import ContactProblem
from gelgap.sim.solution import Record

CAUSES = ("always", "few cells", "stiff mesh", "sideways", "strain")
# A contact of fewer cells is not resolved at all.
_FEWEST_CELLS = 0.25


def causes_of_error(problem: ContactProblem, record: Record, contact_radius_mm: float) -> NDArray[np.float64]:
    """Return `CAUSES` (5,) as numbers that the error of a record's force grows with.

    1; 1 over the square of the cells across the deformed contact's radius; the excess of the mesh's stiffness that
    `mesh_moduli` took out; the tangential share of the force over the cells; the square of depth over thickness.
    """
    cells = max(contact_radius_mm / cell_mm(problem), _FEWEST_CELLS)
    tangential = math.hypot(*record.force_n[:2]) / max(float(np.linalg.norm(record.force_n)), 1e-300)
    excess = stiffness_excess(problem.moduli, problem.mesh_size.stiffness, problem.contact_width)
    strain = record.indenter_mm[2] / problem.thickness_mm
    return np.array([1.0, cells**-2, excess, tangential / cells, strain**2])
