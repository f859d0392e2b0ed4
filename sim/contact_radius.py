"""The radius of a round contact, from the normal forces of the vertices in it."""

import numpy as np

from gelgap.sim.solution import Record, Solution

# The edge of the contact, over which the line is fitted, carries these shares of the normal force outside of it.
_EDGE_SHARES = (0.02, 0.6)


def contact_radius_mm(solution: Solution, record: Record) -> float:
    """Return the deformed radius at which the normal pressure vanishes; 0 if fewer than three vertices carry force.

    Near the edge of a smooth round contact the pressure goes as √(a² − r²), so the normal force carried outside of
    radius r goes as (a² − r²)^(3/2): its power 2/3 is a straight line in r² that meets zero at a². Radii count from the
    centre of the force, and from the indenter's axis where the pad's edge cuts the contact off.
    """
    if np.count_nonzero(record.normal_force_n > 0) < 3:
        return 0.0
    rest, displacement, force = solution.whole_surface(record)
    loaded = force > 0
    rest, displacement, force = rest[loaded], displacement[loaded], force[loaded]
    position = rest + displacement[:, :2]
    pad_mm = solution.problem.pad_mm
    cut_off = pad_mm is not None and (np.abs(rest[:, [0, 0, 1, 1]] - np.array(pad_mm)) < 1e-9).any()
    centre = record.indenter_mm[:2] if cut_off else (force @ position) / force.sum()
    square = ((position - centre) ** 2).sum(axis=1)
    inwards = np.argsort(-square)
    square, force = square[inwards], force[inwards]
    share_outside = (np.cumsum(force) - 0.5 * force) / force.sum()
    largest = float(np.sqrt(square.max()))
    one_radius = 1e-6 * square.max()
    edge = (share_outside > _EDGE_SHARES[0]) & (share_outside < _EDGE_SHARES[1])
    if edge.sum() < 3 or np.ptp(square[edge]) < one_radius:
        edge = share_outside > 0
    if np.ptp(square[edge]) < one_radius:
        return largest
    slope, offset = np.polyfit(square[edge], share_outside[edge] ** (2 / 3), 1)
    return float(np.sqrt(max(-offset / slope, 0.0))) if slope < 0 else largest
