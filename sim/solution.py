"""The solution of a contact problem, what the gel does at each waypoint, and the cache that keeps it on disk.

The cache has one file per key, safe for concurrent writers and for a crash.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from gelgap.assets.array_file import read_arrays
from gelgap.assets.locks import cache_folder
from gelgap.assets.names import one_line
from gelgap.assets.whole_file import TEMPORARY_SUFFIX, write_whole
from gelgap.sim.problem import ContactProblem

_SUFFIX = ".solution"
# A file is NumPy's npz, which holds no code and a CRC-32 of each array: `problem` is the problem as JSON, `rest_mm` are
# the vertices of one mesh after another, `vertices` their numbers, and the others the fields of the records: those of
# vertices one record after another, the rest stacked.
_PROBLEM = TypeAdapter(ContactProblem)
_OF_VERTICES = "displacement_mm", "normal_force_n", "contact_force_n"
_STACKED = "indenter_mm", "force_n", "converged", "torque_n_mm", "mesh", "moved_mm", "moved_error"
# A vertex sticks if its friction is below this share of Coulomb's bound.
_STICKING_SHARE = 0.99


@dataclass(frozen=True)
class SolveDiagnostics:
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


def sticks(tangential_n: NDArray, normal_n: NDArray, friction: float | NDArray) -> NDArray[np.bool_]:
    """Return which vertices (n,) stick, by the sizes of their friction and normal force, and their coefficient."""
    return tangential_n < _STICKING_SHARE * friction * normal_n


@dataclass(frozen=True)
class Record:
    """Equilibrium at one waypoint: what the surface, the labels and the diagnostics are made from.

    `displacement_mm` (n, 3) belongs to the surface vertices of a `mesh`, which the solution numbers; `normal_force_n`
    (n,) is the normal contact force at each of them, `contact_force_n` (n, 3) the whole one, `indenter_mm` (3,) the
    indenter's displacement from touching the gel, turned as it is, `force_n` (3,) its force on the gel, and
    `torque_n_mm` (3,) its torque about the contact point, the origin of the problem's frame. The state of a steady
    slide is one from earlier on the way, moved by `moved_mm` (2,), vertices and all; its force is off by a share
    `moved_error` for that.
    """

    displacement_mm: NDArray[np.float32]
    normal_force_n: NDArray[np.float32]
    contact_force_n: NDArray[np.float32]
    indenter_mm: NDArray[np.float64]
    force_n: NDArray[np.float64]
    torque_n_mm: NDArray[np.float64]
    converged: bool
    diagnostics: SolveDiagnostics
    mesh: int = 0
    moved_mm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    moved_error: float = 0.0


@dataclass(frozen=True, eq=False)
class Solution:
    """The records of a problem's waypoints on the outer membrane's vertices, `rest_mm` (n, 2) of each mesh.

    A problem has one solution, so two solutions are equal if their problems are.
    """

    __repr__ = one_line

    problem: ContactProblem
    rest_mm: tuple[NDArray[np.float64], ...]
    records: tuple[Record, ...]

    def rest_of(self, record: Record) -> NDArray[np.float64]:
        """Return where a record's vertices (n, 2) are at rest."""
        return self.rest_mm[record.mesh] + record.moved_mm

    def whole_surface(self, record: Record) -> tuple[NDArray[np.float64], ...]:
        """Return (rest_mm, displacement_mm, normal_force_n) of a record, with the mirror image of a symmetric half.

        Vertices in the plane of symmetry keep the force on one half.
        """
        rest, displacement = self.rest_of(record), record.displacement_mm.astype(float)
        force = record.normal_force_n.astype(float)
        if not self.problem.symmetric:
            return rest, displacement, force
        off_plane = rest[:, 1] > 1e-9
        return (
            np.concatenate([rest, rest[off_plane] * [1, -1]]),
            np.concatenate([displacement, displacement[off_plane] * [1, -1, 1]]),
            np.concatenate([force, force[off_plane]]),
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Solution) and self.problem == other.problem

    def __hash__(self) -> int:
        return hash(self.problem)


def solution_bytes(solution: Solution) -> bytes:
    """Return a solution as the bytes of a file."""
    problem, records = _PROBLEM.dump_json(solution.problem), solution.records
    arrays: dict[str, Any] = {}
    for name in _OF_VERTICES:
        arrays[name] = np.concatenate([getattr(record, name) for record in records])
    for name in _STACKED:
        arrays[name] = np.stack([getattr(record, name) for record in records])
    diagnostics = np.array([astuple(record.diagnostics) for record in records], dtype=np.float64)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        problem=np.frombuffer(problem, dtype=np.uint8),
        rest_mm=np.concatenate(solution.rest_mm),
        vertices=[len(rest_mm) for rest_mm in solution.rest_mm],
        diagnostics=diagnostics,
        **arrays,
    )
    return buffer.getvalue()


def solution_from_bytes(data: bytes) -> Solution | None:
    """Return the solution of a file's bytes; None if they cannot be read, or are of another version."""
    try:
        arrays: dict[str, Any] = {**read_arrays(data)}
        problem = _PROBLEM.validate_json(arrays["problem"].tobytes())
        rest_mm = np.split(arrays["rest_mm"], np.cumsum(arrays["vertices"])[:-1])
        ends = np.cumsum(arrays["vertices"][arrays["mesh"]])[:-1]
        for name in _OF_VERTICES:
            arrays[name] = np.split(arrays[name], ends)
        records = tuple(_record(arrays, index) for index in range(len(problem.waypoints_mm)))
        return Solution(problem, tuple(rest_mm), records)
    except (ValueError, KeyError, IndexError):
        return None


def _record(arrays: Mapping[str, Sequence[Any]], index: int) -> Record:
    of_record = {name: arrays[name][index] for name in (*_OF_VERTICES, *_STACKED)}
    of_record["converged"] = bool(of_record["converged"])
    of_record["mesh"] = int(of_record["mesh"])
    diagnostics: dict[str, Any] = {
        field.name: value.item()
        for field, value in zip(fields(SolveDiagnostics), arrays["diagnostics"][index], strict=True)
    }
    diagnostics["iterations"] = int(diagnostics["iterations"])
    return Record(**of_record, diagnostics=SolveDiagnostics(**diagnostics))


def load_solution(key: str) -> Solution | None:
    """Return the cached solution of that key, or None if there is none that can be read."""
    solution = read_solution(_path(key))
    return solution if solution is not None and solution.problem.key == key else None


def read_solution(file: Path) -> Solution | None:
    """Return the solution of a file; None if it is gone or cannot be read."""
    try:
        return solution_from_bytes(file.read_bytes())
    except OSError:
        return None


def has_solution(key: str) -> bool:
    """Return whether there is a file for that key; only loading it says whether it can be read."""
    return _path(key).is_file()


def store_solution(solution: Solution) -> None:
    """Write a solution under its problem's key, or raise RuntimeError if the disk does not take it."""
    write_whole(_path(solution.problem.key), solution_bytes(solution))


def cached_files() -> list[Path]:
    """Return the files of the cached solutions."""
    return list(cache_folder().glob(f"*{_SUFFIX}"))


def clear_cache() -> None:
    """Delete all cached solutions, and what writers that were killed have left."""
    for file in (*cached_files(), *cache_folder().glob(f"*{TEMPORARY_SUFFIX}")):
        file.unlink(missing_ok=True)


def _path(key: str) -> Path:
    return cache_folder() / f"{key}{_SUFFIX}"
