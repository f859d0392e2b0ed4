"""The solution of a contact problem, what the gel does at each waypoint, and its bytes on disk."""

import hashlib
import io
from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from gelgap.assets.array_file import read_arrays
from gelgap.sim.membrane import Diagnostics
from gelgap.sim.problem import ContactProblem

# The bytes are this mark, the SHA-256 of all that follows, and arrays in NumPy's npz, which holds no code: `problem` is
# the problem as JSON, others stack the records' fields. With another number in the mark, older files count as damaged.
_MARK = b"gelgap solution 1\n"
_PROBLEM = TypeAdapter(ContactProblem)
_STACKED = ("displacement_mm", "normal_force_n", "indenter_mm", "force_n", "converged")


@dataclass(frozen=True)
class Record:
    """Equilibrium at one waypoint: what the surface, the labels and the diagnostics are made from.

    `displacement_mm` (n, 3) belongs to the solution's surface vertices, `normal_force_n` (n,) is the normal contact
    force at each of them, `indenter_mm` (3,) the indenter's displacement from touching the gel, `force_n` (3,) its
    force on the gel.
    """

    displacement_mm: NDArray[np.float32]
    normal_force_n: NDArray[np.float32]
    indenter_mm: NDArray[np.float64]
    force_n: NDArray[np.float64]
    converged: bool
    diagnostics: Diagnostics


@dataclass(frozen=True, eq=False)
class Solution:
    """The records of a problem's waypoints on the vertices `rest_mm` (n, 2) of the outer membrane.

    A problem has one solution, so two solutions are equal if their problems are.
    """

    problem: ContactProblem
    rest_mm: NDArray[np.float64]
    records: tuple[Record, ...]

    def whole_surface(self, record: Record) -> tuple[NDArray[np.float64], ...]:
        """Return (rest_mm, displacement_mm, normal_force_n) of a record, with the mirror image of a symmetric half."""
        rest, displacement = self.rest_mm, record.displacement_mm.astype(float)
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
    problem = _PROBLEM.dump_json(solution.problem)
    stacked = {name: np.stack([getattr(record, name) for record in solution.records]) for name in _STACKED}
    diagnostics = np.array([astuple(record.diagnostics) for record in solution.records], dtype=np.float64)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        problem=np.frombuffer(problem, dtype=np.uint8),
        rest_mm=solution.rest_mm,
        diagnostics=diagnostics,
        **stacked,
    )
    content = buffer.getvalue()
    return _MARK + hashlib.sha256(content).digest() + content


def solution_from_bytes(data: bytes) -> Solution | None:
    """Return the solution of a file's bytes; None if a single bit differs, or they are not of this version."""
    start = len(_MARK) + hashlib.sha256().digest_size
    content = data[start:]
    if data[:start] != _MARK + hashlib.sha256(content).digest():
        return None
    try:
        arrays = read_arrays(content)
        problem = _PROBLEM.validate_json(arrays["problem"].tobytes())
        _check_shapes(arrays, len(problem.waypoints_mm))
    except (ValueError, KeyError):
        return None
    columns = zip(*(arrays[name] for name in (*_STACKED, "diagnostics")), strict=True)
    records = tuple(
        Record(*values, converged=bool(converged), diagnostics=_diagnostics(diagnostics))
        for *values, converged, diagnostics in columns
    )
    return Solution(problem, arrays["rest_mm"], records)


def is_of_this_format(data: bytes) -> bool:
    """Return whether bytes begin as those of `solution_bytes` do: if they are no solution, they are damaged."""
    return data.startswith(_MARK)


def _check_shapes(arrays: dict[str, np.ndarray], n: int) -> None:
    """Raise ValueError if arrays do not belong together; KeyError if one is missing."""
    vertices = len(arrays["rest_mm"])
    shapes = {
        "rest_mm": (vertices, 2),
        "displacement_mm": (n, vertices, 3),
        "normal_force_n": (n, vertices),
        "indenter_mm": (n, 3),
        "force_n": (n, 3),
        "converged": (n,),
        "diagnostics": (n, len(fields(Diagnostics))),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind not in "bf":
            raise ValueError(f"{name} has another shape or type")


def _diagnostics(values: np.ndarray) -> Diagnostics:
    kinds = (type(field.default) for field in fields(Diagnostics))
    return Diagnostics(*(kind(value) for kind, value in zip(kinds, values, strict=True)))
