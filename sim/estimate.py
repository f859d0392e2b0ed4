"""How far a pose may be off because its mesh is no finer: what a user may trust in a state that is in equilibrium.

Each cause of error is a number that the solve has anyway; how much error comes with it was calibrated on random scenes
beside finer meshes and an axisymmetric solver: an estimate is the standard deviation of the true errors of scenes with
the same causes.
"""

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from gelgap.assets.names import one_line
from gelgap.sim.grading import EDGE_STEP_CELLS, edge_radius_mm
from gelgap.sim.indenter import Floats
from gelgap.sim.problem import LARGEST_POISSON_RATIO, ContactProblem
from gelgap.sim.rim import sticking_share
from gelgap.sim.scene import Elastomer, Moduli
from gelgap.sim.solution import Record, Solution, SolveDiagnostics, sticks

CAUSES = ("cells", "few in contact", "stiff mesh", "sideways", "strain")
# A contact of fewer cells is not resolved at all.
_FEWEST_CELLS = 0.25
# A mesh that is drawn out along a path differs before and behind the contact, and pushes it sideways even without
# friction, by up to 0.8 % of Fz at `draft`: as if this share of the force were tangential.
_TANGENTIAL_OF_A_PATH = 0.1
# So does a tilted body, times the sine of its lean: a sticking cylinder that leans by 8° is pushed sideways by 0.8 %
# of Fz too much at `draft`, 0.6 % at `standard` (0.6 mm deep, beside hexahedra of mean dilatation).
_TANGENTIAL_OF_A_LEAN = 1.5
# A contact that sticks ends at a ring of vertices, up to a cell from where it truly does: evenly spread, 1/√12 of a
# cell rms, and a twist's torque grows with the cube of the radius.
_TWIST_OFF_BY_CELLS = 3 / math.sqrt(12)
# What is left of it, times the square of a cell over the contact's radius, once `twist_factor` has corrected it; and
# what the references themselves may be off.
_CORRECTED_TWIST_OFF, _TWIST_REFERENCE_OFF = 0.4, 0.03
# The variance of Fz, shear, contact radius and membrane, as a share, over the square of each cause (commit 032934a is
# the last that has `scripts/calibrate_estimate.py`): Fz and radius are of presses among scenes 72 to 249 beside the
# axisymmetric solver, shear and membrane of 300 to 341.
# The scenes resolve their contacts: what few cells do to Fz is from the tables' shallowest presses, which share a mesh.
_VARIANCE_PER_CAUSE = (
    (0.000393, 0.00134, 0.0284, 0.0, 0.0972),
    (0.0, 2.31e-05, 0.0, 0.0104, 0.0),
    (0.00113, 0.0064, 0.312, 0.0, 0.324),
    (0.0, 0.0, 0.206, 0.0, 0.0304),
)
# A mesh between lines has its cells anywhere, not in the middle of each patch, as rings of cells have under a ring: a
# torus and a punch have mostly up to 2.5 and 1.3 % too much beside felupe (4.3 once), a ball by its surface 1.2 % rms
# at `draft`, 0.7 at `standard`, two balls up to 2.2 and 1.2 %, one ring of waves 1.0 at `standard`. A share of force,
# times a cell over the patch's radius, squared where a mesh is made for deeper poses: a ridge of one to two cells has
# 25 % too little. The membrane of a ring is off by 1.7 % of the depth, rms of six, where such a share of it says 2.2.
_BETWEEN_LINES = 0.05
# The outline of a contact that lies across the lines passes between vertices: boxes by 5 to 45° near a pad's edges have
# up to 6 % more or less force than along the lines, 2 % rms at `draft`. A share of the force, times a cell over half
# the size of the box around it, where the contact is narrower than this share of the box.
_ACROSS_LINES, _ACROSS_SHARE = 0.055, 0.9
# Around an edge sharper than a cell there are few vertices, which lie anywhere: a share of the force, times the cells
# that fit the edge's radius, less one. A cylinder's force (R 1.5 on 3 mm, 0.5 deep) is 2.8 % too large with an edge of
# 0.1 mm at `draft`, 0.8 and 2.5 % with 0.1 and 0.05 mm at `standard`, beside axisymmetric finite elements.
_SHARP_EDGE = 0.0055
# Gel of ν 0.48 that is covered wholly, 0.15 of 3 mm deep, has 3 % too much force without friction and 2.5 % too little
# without slip beside felupe at `draft`: MuJoCo's energy is not its own under pressure from all sides.
_COVERED = 0.0175
# By lubrication theory a wide contact is stiffer by (a/h)² times half to twice this for what ν is above the mesh's.
_LAYER_RISE = 4.0
# MuJoCo's equivalent moduli are too stiff by E′ over E under a contact that is small beside its layer, and by up to a
# tenth (their λ + 2μ) from a radius of `_CONFINED_THICKNESSES` on. The estimate takes `_EQUIVALENT_OFF` of that.
_EQUIVALENT_OFF, _CONFINED_THICKNESSES = 0.6, 6.0
# A contact sticks, or slips as a whole, if no more than this share of its normal force is on other vertices.
_NEGLIGIBLE_SLIP_SHARE = 0.02
# The vertex in the middle of a turn sticks, with less of the load than this unless the contact has few vertices.
_LARGEST_CENTRE_SHARE = 0.1
# Estimates of a component of force, as a share of the whole force, above which a quality does not keep its promise:
# errors above twice the estimate are rare, and twice this is promised.
LARGEST_ESTIMATE = {"draft": 0.03, "standard": 0.02, "fine": 0.01}


class Errors(NamedTuple):
    """Estimates of a state's errors, as standard deviations: force (3,), contact radius, displacement (rms)."""

    force_n: Floats
    contact_radius_mm: float
    membrane_mm: float


@dataclass(frozen=True)
class Diagnostics(SolveDiagnostics):
    """How a pose was solved, and how far it may be off: estimates of the errors that its mesh makes.

    In `sticking_fraction` a single vertex that sticks among sliding ones does not count: a contact that turns as a
    whole has one at its centre, and a smaller region is less than the mesh resolves.

    An estimate is a standard deviation: nineteen of twenty errors are below twice it. `shear_error_n` is that of Fx and
    of Fy, each; `tz_error_n_mm` that of a twist's torque where the contact sticks, less where it slides;
    `membrane_error_mm` that of the displacement, rms within four contact radii. A pose is `coarse` if its force's
    estimate is above what its quality promises, and `folded` if its membrane folds over, so that no camera sees it as
    it is.
    """

    __repr__ = one_line

    fz_error_n: float = 0.0
    shear_error_n: float = 0.0
    tz_error_n_mm: float = 0.0
    contact_radius_error_mm: float = 0.0
    membrane_error_mm: float = 0.0
    coarse: bool = False
    folded: bool = False

    @property
    def slip(self) -> str:
        """`stick` or `gross` if nearly all of the normal force is on vertices that stick or slide, else `partial`."""
        if self.sticking_fraction >= 1 - _NEGLIGIBLE_SLIP_SHARE:
            return "stick"
        return "gross" if self.sticking_fraction <= _NEGLIGIBLE_SLIP_SHARE else "partial"

    @property
    def force_error_n(self) -> tuple[float, float, float]:
        """The estimates of Fx, Fy and Fz."""
        return self.shear_error_n, self.shear_error_n, self.fz_error_n


def causes_of_error(solution: Solution, index: int, contact_radius_mm: float) -> Floats:
    """Return `CAUSES` (5,) as numbers that the error of a record's force grows with.

    1 over the cells across the radius that the mesh is made for; 1 over the square of those across the deformed
    contact's; the excess of the mesh's stiffness that is taken out; the tangential share of the force over the cells;
    the square of depth over thickness, over the first.
    """
    problem, record = solution.problem, solution.records[index]
    cells = _cells(problem, contact_radius_mm)
    tangential = _tangential(solution, index) / max(float(np.linalg.norm(record.force_n)), 1e-300)
    of_path = _TANGENTIAL_OF_A_PATH if problem.travel_mm > 0 else 0.0
    of_lean = _TANGENTIAL_OF_A_LEAN * math.sin(math.radians(problem.body_at(index).lean_deg))
    tangential = max(tangential, of_path, of_lean)
    strain = record.indenter_mm[2] / problem.thickness_mm
    # A body of many features gets fewer cells across each.
    coarse = max(1 / problem.mesh_size.across, problem.cell_mm / problem.meshed_radius_mm)
    return np.array([coarse, cells**-2, problem.stiffness_excess, tangential / cells, strain**2 * coarse])


def _cells(problem: ContactProblem, contact_radius_mm: float) -> float:
    """Return how many cells there are across a contact's radius; fewer if it lies across the mesh's lines."""
    return max(problem.narrowness * contact_radius_mm / problem.cell_mm, _FEWEST_CELLS)


def _tangential(solution: Solution, index: int) -> float:
    """Return the tangential force, N, that a record's error grows with.

    What was built up on its way and then taken back has errors of its own, which add as variances do. On a straight way
    on which the force only grows that is the force itself.
    """
    built_up = np.array([solution.records[k].force_n[:2] for k in solution.problem.way(index)])
    taken_back = built_up - built_up[-1]
    return float(np.sqrt((built_up**2 + taken_back**2).sum(axis=1)).max())


def diagnose(
    solution: Solution, index: int, radius_mm: float, twist: float, modulus_ratio: float, gel: Elastomer
) -> Diagnostics:
    """Return a record's diagnostics with estimates; forces and energy are `modulus_ratio` times the solved gel's.

    `twist` is the record's `twist_factor`.
    """
    problem, record = solution.problem, solution.records[index]
    causes = causes_of_error(solution, index, radius_mm)
    variance = np.array(_VARIANCE_PER_CAUSE) @ causes**2
    variance[:3] += _off_lines(problem, record) ** 2
    if problem.is_ring and radius_mm:
        variance[2] += (problem.cell_mm / 2 / radius_mm) ** 2
        variance[3] += (_BETWEEN_LINES * problem.cell_mm / _patch_mm(problem, record)) ** 2
    if problem.covers_pad:
        variance[0] += _COVERED**2
    edge_mm = edge_radius_mm(problem, EDGE_STEP_CELLS * problem.cell_mm)
    variance[0] += (_SHARP_EDGE * max(0.0, problem.cell_mm / edge_mm - 1)) ** 2
    variance[:2] += record.moved_error**2
    rise = _LAYER_RISE * max(0.0, gel.poisson_ratio - LARGEST_POISSON_RATIO)
    variance[0] += (rise * (radius_mm / problem.thickness_mm) ** 2) ** 2
    coarse = math.sqrt(variance[:2].max()) > LARGEST_ESTIMATE[problem.quality.name]
    own, equivalent = Moduli(gel.young_modulus_mpa, gel.poisson_ratio), problem.moduli_of(gel)
    free = equivalent.young_modulus_mpa / own.young_modulus_mpa - 1
    confined = _confined_mpa(equivalent) / _confined_mpa(own) - 1
    wide = min(radius_mm, problem.meshed_radius_mm) / problem.thickness_mm
    stiffer = np.interp(wide, [0.0, _CONFINED_THICKNESSES], [free, confined])
    variance[:2] += (_EQUIVALENT_OFF * stiffer) ** 2
    fz, shear, radius, membrane = np.sqrt(variance).tolist()
    force_n = modulus_ratio * float(np.linalg.norm(record.force_n))
    torque_n_mm = abs(float(record.torque_n_mm[2]))
    found = asdict(record.diagnostics)
    found["elastic_energy_mj"] *= modulus_ratio
    # Where static friction holds many vertices, they may bear more than `friction` allows.
    few_stick = found["sticking_fraction"] <= 2 * _LARGEST_CENTRE_SHARE
    turns = few_stick and _turns_about_a_vertex(record, problem.friction)
    found["sticking_fraction"] = 0.0 if turns else sticking_share(solution, record)
    return Diagnostics(
        **found,
        fz_error_n=fz * force_n,
        shear_error_n=shear * force_n,
        tz_error_n_mm=_twist_off(_cells(problem, radius_mm), twist) * modulus_ratio * torque_n_mm,
        contact_radius_error_mm=radius * radius_mm,
        membrane_error_mm=membrane * abs(float(record.indenter_mm[2])),
        coarse=coarse,
    )


def _confined_mpa(moduli: Moduli) -> float:
    """Return the modulus λ + 2μ of gel that cannot give sideways, at the ν of its mesh."""
    meshed = Moduli(moduli.young_modulus_mpa, min(moduli.poisson_ratio, LARGEST_POISSON_RATIO))
    return meshed.lame_mpa + 2 * meshed.shear_mpa


def _off_lines(problem: ContactProblem, record: Record) -> float:
    """Return by what share force, and a radius from its centre, may be off where a contact is not along the lines."""
    if problem.indenter.convex:
        if problem.narrowness >= _ACROSS_SHARE:
            return 0.0
        return _ACROSS_LINES * problem.cell_mm / math.sqrt(math.prod(problem.half_cut_mm))
    if problem.is_round and not problem.is_ring and problem.relief is not None:
        return 0.0
    return _BETWEEN_LINES * problem.cell_mm * problem.meshed_radius_mm / _patch_mm(problem, record) ** 2


def _patch_mm(problem: ContactProblem, record: Record) -> float:
    """Return the radius of a record's own patch, at least a cell; that of the mesh where it is one disc, or turns."""
    if not problem.is_ring and (problem.is_round or problem.turns_deg):
        return problem.meshed_radius_mm
    own_mm = problem.indenter.contact_radius_mm(-float(record.indenter_mm[2]))
    return min(problem.meshed_radius_mm, max(own_mm, problem.cell_mm))


def _twist_off(cells: float, factor: float) -> float:
    """Return by what share a sticking twist's torque may be off, by its `twist_factor`."""
    if factor == 1.0:
        return _TWIST_OFF_BY_CELLS / cells
    return factor * math.hypot(_CORRECTED_TWIST_OFF / cells**2, _TWIST_REFERENCE_OFF)


def _turns_about_a_vertex(record: Record, friction: float) -> bool:
    """Return whether no more than one vertex with load sticks, and others bear nearly all of it."""
    normal = np.maximum(record.normal_force_n, 0.0)
    tangential = np.sqrt(np.maximum((record.contact_force_n**2).sum(axis=1) - normal**2, 0.0))
    shares = normal[sticks(tangential, normal, friction)] / max(normal.sum(), 1e-300)
    largest = shares.max(initial=0.0)
    return bool(
        len(shares) and largest < _LARGEST_CENTRE_SHARE and shares.sum() - largest <= _NEGLIGIBLE_SLIP_SHARE
    )
