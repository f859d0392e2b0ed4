"""How far a pose may be off because its mesh is no finer: what a user may trust in a state that is in equilibrium.

Each cause of error is a number that the solve has anyway; how much error comes with it was calibrated on random scenes
beside finer meshes and an axisymmetric solver: an estimate is the standard deviation of the true errors of scenes with
the same causes.
"""

import math
from dataclasses import asdict, dataclass
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from gelgap.assets import asset_path
from gelgap.assets.names import one_line
from gelgap.assets.toml_file import read_toml
from gelgap.sim.grading import EDGE_STEP_CELLS, edge_radius_mm
from gelgap.sim.indenter import Floats
from gelgap.sim.problem import LARGEST_POISSON_RATIO, ContactProblem
from gelgap.sim.rim import sticking_share
from gelgap.sim.scene import Elastomer, Moduli
from gelgap.sim.solution import Record, Solution, SolveDiagnostics, sticks

CAUSES = ("cells", "few in contact", "stiff mesh", "sideways", "strain")
# A contact that sticks ends at a ring of vertices, up to a cell from where it truly does: evenly spread, 1/√12 of a
# cell rms, and a twist's torque grows with the cube of the radius.
_TWIST_OFF_BY_CELLS = 3 / math.sqrt(12)
# What was fitted, or chosen beside a reference; the file says how.
_FITTED = SimpleNamespace(**read_toml(asset_path("fitted", "estimate.toml")))
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
        if self.sticking_fraction >= 1 - _FITTED.negligible_slip_share:
            return "stick"
        return "gross" if self.sticking_fraction <= _FITTED.negligible_slip_share else "partial"

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
    of_path = _FITTED.tangential_of_a_path if problem.travel_mm > 0 else 0.0
    of_lean = _FITTED.tangential_of_a_lean * math.sin(math.radians(problem.body_at(index).lean_deg))
    tangential = max(tangential, of_path, of_lean)
    strain = record.indenter_mm[2] / problem.thickness_mm
    # A body of many features gets fewer cells across each.
    coarse = max(1 / problem.mesh_size.across, problem.cell_mm / problem.meshed_radius_mm)
    return np.array([coarse, cells**-2, problem.stiffness_excess, tangential / cells, strain**2 * coarse])


def _cells(problem: ContactProblem, contact_radius_mm: float) -> float:
    """Return how many cells there are across a contact's radius; fewer if it lies across the mesh's lines."""
    return max(problem.narrowness * contact_radius_mm / problem.cell_mm, _FITTED.fewest_cells)


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
    variance = np.array(_FITTED.variance_per_cause) @ causes**2
    variance[:3] += _off_lines(problem, record) ** 2
    if problem.is_ring and radius_mm:
        variance[2] += (problem.cell_mm / 2 / radius_mm) ** 2
        variance[3] += (_FITTED.between_lines * problem.cell_mm / _patch_mm(problem, record)) ** 2
    if problem.covers_pad:
        variance[0] += _FITTED.covered**2
    edge_mm = edge_radius_mm(problem, EDGE_STEP_CELLS * problem.cell_mm)
    variance[0] += (_FITTED.sharp_edge * max(0.0, problem.cell_mm / edge_mm - 1)) ** 2
    variance[:2] += record.moved_error**2
    rise = _FITTED.layer_rise * max(0.0, gel.poisson_ratio - LARGEST_POISSON_RATIO)
    variance[0] += (rise * (radius_mm / problem.thickness_mm) ** 2) ** 2
    coarse = math.sqrt(variance[:2].max()) > LARGEST_ESTIMATE[problem.quality.name]
    stated = Moduli(gel.young_modulus_mpa, gel.poisson_ratio)
    equivalent = problem.moduli_of(gel)
    free = equivalent.young_modulus_mpa / stated.young_modulus_mpa - 1
    confined = _confined_mpa(equivalent) / _confined_mpa(stated) - 1
    wide = min(radius_mm, problem.meshed_radius_mm) / problem.thickness_mm
    stiffer = np.interp(wide, [0.0, _FITTED.confined_thicknesses], [free, confined])
    variance[:2] += (_FITTED.equivalent_off * stiffer) ** 2
    fz, shear, radius, membrane = np.sqrt(variance).tolist()
    force_n = modulus_ratio * float(np.linalg.norm(record.force_n))
    torque_n_mm = abs(float(record.torque_n_mm[2]))
    diagnostics = asdict(record.diagnostics)
    diagnostics["elastic_energy_mj"] *= modulus_ratio
    # Where static friction holds many vertices, they may bear more than `friction` allows.
    few_stick = diagnostics["sticking_fraction"] <= 2 * _FITTED.largest_centre_share
    turns = few_stick and _turns_about_a_vertex(record, problem.friction)
    diagnostics["sticking_fraction"] = 0.0 if turns else sticking_share(solution, record)
    return Diagnostics(
        **diagnostics,
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
        if problem.narrowness >= _FITTED.across_share:
            return 0.0
        return _FITTED.across_lines * problem.cell_mm / math.sqrt(math.prod(problem.half_cut_mm))
    if problem.is_round and not problem.is_ring and problem.relief is not None:
        return 0.0
    return (
        _FITTED.between_lines * problem.cell_mm * problem.meshed_radius_mm / _patch_mm(problem, record) ** 2
    )


def _patch_mm(problem: ContactProblem, record: Record) -> float:
    """Return the radius of a record's own patch, at least a cell; that of the mesh where it is one disc, or turns."""
    if not problem.is_ring and (problem.is_round or problem.turns_deg):
        return problem.meshed_radius_mm
    patch_mm = problem.indenter.contact_radius_mm(-float(record.indenter_mm[2]))
    return min(problem.meshed_radius_mm, max(patch_mm, problem.cell_mm))


def _twist_off(cells: float, factor: float) -> float:
    """Return by what share a sticking twist's torque may be off, by its `twist_factor`."""
    if factor == 1.0:
        return _TWIST_OFF_BY_CELLS / cells
    return factor * math.hypot(_FITTED.corrected_twist_off / cells**2, _FITTED.twist_reference_off)


def _turns_about_a_vertex(record: Record, friction: float) -> bool:
    """Return whether no more than one vertex with load sticks, and others bear nearly all of it."""
    normal = np.maximum(record.normal_force_n, 0.0)
    tangential = np.sqrt(np.maximum((record.contact_force_n**2).sum(axis=1) - normal**2, 0.0))
    shares = normal[sticks(tangential, normal, friction)] / max(normal.sum(), 1e-300)
    largest = shares.max(initial=0.0)
    return bool(
        len(shares)
        and largest < _FITTED.largest_centre_share
        and shares.sum() - largest <= _FITTED.negligible_slip_share
    )
