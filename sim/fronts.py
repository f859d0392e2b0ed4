"""Condensation of a gel's linear equation onto its kept vertices, by a multifrontal Cholesky factor of all others.

One compiled call eliminates all dense fronts by LAPACK (Duff & Reid 1983, ACM Trans. Math. Softw. 9:302; Liu 1992,
SIAM Rev. 34:82). The door is `assembly_tree` and `Condensation`: no gel behind it.
It saves no time: a ball's gel at `draft` (6246 dofs) takes 27 ms, as does CHOLMOD's factor of it (SuperLU: 207), a
solution 3.9 ms beside 2.4 (`benchmarks/physics/cholesky.py`). It gives the condensed matrix, without a library more.
"""

import ctypes
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import get_cython_function_address
from numpy.typing import NDArray
from scipy import sparse

from gelgap.sim.indenter import Floats, Ints

# A subtree with at most this many vertices becomes one group: many small ones cost more than the zeros of a large one.
_SMALLEST_GROUP = 16
# A group takes in a child if at most this share of what it has then is zeros.
_LARGEST_SHARE_OF_ZEROS = 0.05


def _routine(library: str, name: str, arguments: int) -> Any:
    """Return a routine of SciPy's BLAS or LAPACK, all of whose arguments are pointers.

    Compiled functions get it as an argument: where it lies differs from process to process, and they are cached.
    """
    address = get_cython_function_address(f"scipy.linalg.cython_{library}", name)
    return ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * arguments)(address)


_ELIMINATION = _routine("lapack", "dpotrf", 5), _routine("blas", "dtrsm", 11), _routine("blas", "dsyrk", 10)
_SUBSTITUTION = _routine("blas", "dgemv", 11), _routine("blas", "dtrsv", 8)
_RIGHT, _LOWER, _TRANSPOSED, _PLAIN = (np.frombuffer(letter, np.uint8) for letter in (b"R", b"L", b"T", b"N"))
_ONE, _MINUS_ONE, _ZERO, _STEP = np.array([1.0]), np.array([-1.0]), np.array([0.0]), np.array([1], np.int32)


class Condensation:
    """Condenses A x = b, symmetric and positive definite with three dofs per vertex, onto the kept vertices.

    A is a sparse matrix (n, n) whose values change while its `pattern`, with both triangles, does not, plus a diagonal.
    Vertices, by their first dofs (v,) in the order of elimination, are eliminated in `groups`; the last one's are kept.
    """

    def __init__(self, pattern: sparse.csr_array, first_dof: Ints, groups: "list[Group]") -> None:
        self._size = pattern.shape[0]
        vertices = len(first_dof)
        position = np.full(self._size, -1)
        position[_dofs(first_dof)] = np.arange(3 * vertices)
        rows = position[np.repeat(np.arange(self._size), np.diff(pattern.indptr))]
        columns = position[pattern.indices]
        self._plan = plan = _plan(groups, first_dof, rows, columns)
        self._factor = np.zeros(plan.begin[-1])
        self._updates = np.zeros((plan.update + plan.below**2).max())
        self._solution = np.zeros(self._size)
        self.kept_dofs = plan.own_dofs[-3 * len(groups[-1].columns) :]

    def factorise(self, values: Floats, diagonal: Floats) -> Floats:
        """Factorise A and return the lower triangle of the condensed matrix (k, k), with zeros above.

        `values` are the sparse matrix's in its own order, `diagonal` (n,) is added. The factor stays for any number of
        right sides. LinAlgError if the matrix is not positive definite.
        """
        if not _eliminate(self._plan, values, diagonal, self._factor, self._updates, _ELIMINATION):
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        kept = len(self.kept_dofs)
        return self._factor[self._plan.begin[-2] :].reshape(kept, kept).T

    def condense(self, right_side: Floats) -> Floats:
        """Return what is left of b (n,) for the kept dofs (k,), after `factorise`."""
        self._solution[:] = right_side
        _substitute(self._plan, self._factor, self._solution, _SUBSTITUTION)
        return self._solution[self.kept_dofs]

    def expand(self, kept: Floats) -> Floats:
        """Return x (n,) from its kept dofs (k,), after `condense`; 0 where there is no vertex."""
        solution = np.zeros(self._size)
        solution[self.kept_dofs] = kept
        _substitute_back(self._plan, self._factor, self._solution, solution, _SUBSTITUTION)
        return solution


@dataclass(frozen=True)
class Group:
    """Vertices that are eliminated together, all known by their places in the order of elimination, which ascend.

    `columns` (c,) are its own, `rows` (r,) the later ones that they are coupled to once the children are eliminated;
    `children` are the numbers of groups all of whose rows this group has.
    """

    columns: Ints
    rows: Ints
    children: tuple[int, ...]


@dataclass
class _Branch:
    """A group that may still be taken in by its parent; `entries` counts what its columns truly hold."""

    columns: list[int]
    rows: set[int]
    children: list["_Branch"]
    entries: int


def assembly_tree(graph: sparse.csr_array, kept: int) -> list[Group]:
    """Return the groups of a mesh in postorder; the last consists of the last `kept` vertices and has no rows.

    `graph` (n, n) has an entry for every pair of vertices that are coupled, in the order of elimination. Groups are
    relaxed supernodes (Liu 1992, SIAM Rev. 34:82; Ashcraft & Grimes 1989, ACM Trans. Math. Softw. 15:291): a vertex
    takes in the groups that are eliminated right before it, unless too many zeros would be held.
    """
    count = graph.shape[0]
    later = sparse.triu(graph, 1, format="csr")
    first, neighbours = later.indptr.tolist(), later.indices.tolist()
    root = _Branch(list(range(count - kept, count)), set(), [], 0)
    waiting: list[list[_Branch]] = [[] for _ in range(count)]
    descendants = [1] * count
    for vertex in range(count - kept):
        rows = set(neighbours[first[vertex] : first[vertex + 1]])
        rows = rows.union(*(child.rows for child in waiting[vertex])) - {vertex}
        branch = _Branch([vertex], rows, [], entries=1 + len(rows))
        for child in sorted(waiting[vertex], key=lambda child: -len(child.rows)):
            columns, entries = len(branch.columns) + len(child.columns), branch.entries + child.entries
            held = columns * (columns + 1) // 2 + columns * len(rows)
            small = descendants[vertex] <= _SMALLEST_GROUP
            if small or held * (1 - _LARGEST_SHARE_OF_ZEROS) <= entries:
                branch.columns += child.columns
                branch.children += child.children
                branch.entries = entries
            else:
                branch.children.append(child)
        parent = min(rows, default=count)
        if parent < count - kept:
            waiting[parent].append(branch)
            descendants[parent] += descendants[vertex]
        else:
            root.children.append(branch)
    return _postordered(root)


def _postordered(root: _Branch) -> list[Group]:
    """Number the branches so that each comes right after its subtree."""
    branches, order = [root], []
    while branches:
        branch = branches.pop()
        order.append(branch)
        branches += branch.children
    order.reverse()
    number = {id(branch): index for index, branch in enumerate(order)}
    groups = []
    for branch in order:
        columns, rows = (np.array(sorted(part), dtype=np.int64) for part in (branch.columns, branch.rows))
        groups.append(Group(columns, rows, tuple(sorted(number[id(child)] for child in branch.children))))
    return groups


class _Plan(NamedTuple):
    """Where everything lies, of all groups' fronts one after another, in postorder.

    A front is the dense matrix of a group: its `own` (c, c) columns and what is `below` (r, c), both column by column,
    which become the factor's. Its update matrix (r, r) is what elimination leaves of the rest; it is added to the
    parent's front at `places` (r,), which ascend. `first_…` say where each front's part of the other arrays begins.
    """

    own: Ints  # c of each front
    below: Ints  # r of each front
    begin: Ints  # of each front in the factor's memory
    update: Ints  # where each update matrix begins in theirs
    first_own: Ints
    own_dofs: Ints  # where the columns stand in A
    first_row: Ints
    row_dofs: Ints  # where the rows stand in A
    places: NDArray[np.uint64]  # unsigned, since compiled code is slower if an index may be negative
    first_child: Ints
    children: Ints
    first_value: Ints
    source: Ints  # which of the sparse matrix's values go into the factor's memory
    target: Ints  # and where to


def _plan(groups: list[Group], first_dof: Ints, rows: Ints, columns: Ints) -> _Plan:
    """Lay out the fronts.

    `rows` and `columns` (values,) are the sparse matrix's, in the order of elimination, −1 where a dof has none.
    """
    vertices = len(first_dof)
    number = np.arange(len(groups))
    mine, later = np.array([(len(group.columns), len(group.rows)) for group in groups]).T
    mine_of, later_of = (np.concatenate([getattr(g, part) for g in groups]) for part in ("columns", "rows"))
    own, below = 3 * mine, 3 * later
    begin = _ends(own * (own + below))
    held = _ends(mine + later)
    # What the groups hold, one group after another, ascends if it is raised by the group's number.
    raised = np.concatenate([part for group in groups for part in (group.columns, group.rows)])
    raised += vertices * np.repeat(number, mine + later)

    def places(group: Ints, dof: Ints) -> Ints:
        """Return where dofs (n,) stand in the fronts of groups (n,)."""
        return 3 * (np.searchsorted(raised, vertices * group + dof // 3) - held[group]) + dof % 3

    parent = np.zeros(len(groups), np.int64)
    group_of = np.empty(vertices, np.int64)
    group_of[mine_of] = np.repeat(number, mine)
    for index, children in enumerate(group.children for group in groups):
        parent[list(children)] = index
    in_parent = places(np.repeat(parent, 3 * later), _dofs(3 * later_of))
    source = np.flatnonzero((columns >= 0) & (rows >= columns))
    source = source[np.argsort(group_of[columns[source] // 3], kind="stable")]
    front = group_of[columns[source] // 3]
    row = places(front, rows[source])
    column = places(front, columns[source])
    in_own = row + column * own[front]
    in_below = own[front] ** 2 + row - own[front] + column * below[front]
    return _Plan(
        own=own,
        below=below,
        begin=begin,
        update=_update_places(groups),
        first_own=_ends(own),
        own_dofs=_dofs(first_dof[mine_of]),
        first_row=_ends(below),
        row_dofs=_dofs(first_dof[later_of]),
        places=in_parent.astype(np.uint64),
        first_child=_ends([len(group.children) for group in groups]),
        children=np.array([child for group in groups for child in group.children], dtype=np.int64),
        first_value=np.searchsorted(front, np.arange(len(groups) + 1)),
        source=source,
        target=begin[front] + np.where(row < own[front], in_own, in_below),
    )


def _ends(lengths: Any) -> Ints:
    """Return where parts of these lengths (n,) begin, one after another, and where the last one ends, (n + 1,)."""
    return np.cumsum([0, *lengths])


def _update_places(groups: list[Group]) -> Ints:
    """Return where the update matrices lie; groups equally deep in the tree share memory if their parents differ."""
    sizes = [3 * len(group.rows) for group in groups]
    depth, begin = np.zeros((2, len(groups)), np.int64)
    needed = np.zeros(len(groups) + 1, np.int64)
    for number in reversed(range(len(groups))):
        offset = 0
        for child in groups[number].children:
            depth[child], begin[child] = depth[number] + 1, offset
            offset += sizes[child] ** 2
        needed[depth[number] + 1] = max(needed[depth[number] + 1], offset)
    return begin + _ends(needed)[depth]


def _dofs(first_dof: Ints) -> Ints:
    """Return the dofs (3 n,) of vertices from their first ones (n,)."""
    return (first_dof[:, None] + np.arange(3)).ravel()


@njit(cache=True)
def _eliminate(
    plan: _Plan, values: Floats, diagonal: Floats, factor: Floats, updates: Floats, routines: tuple
) -> bool:
    """Assemble and eliminate all fronts but the last, which is assembled only; return whether all had a factor.

    `values` and `diagonal` are those of `factorise`. Matrices lie column by column, so that their first index here is
    the column.
    """
    dpotrf, dtrsm, dsyrk = routines
    right, lower, transposed, plain = _RIGHT.ctypes, _LOWER.ctypes, _TRANSPOSED.ctypes, _PLAIN.ctypes
    one, minus_one = _ONE.ctypes, _MINUS_ONE.ctypes
    sizes = np.zeros(3, np.int32)
    c, r, failed = sizes[:1].ctypes, sizes[1:2].ctypes, sizes[2:].ctypes
    for front in range(len(plan.own)):
        size, rows, behind = plan.own[front], plan.below[front], np.uint64(plan.own[front])
        memory = factor[plan.begin[front] : plan.begin[front + 1]]
        memory[:] = 0
        for k in range(plan.first_value[front], plan.first_value[front + 1]):
            factor[plan.target[k]] = values[plan.source[k]]
        own, below = memory[: size * size].reshape(size, size), memory[size * size :].reshape(size, rows)
        for k in range(size):
            own[k, k] += diagonal[plan.own_dofs[plan.first_own[front] + k]]
        update, _ = _update(plan, updates, front)
        update[:] = 0
        for child in plan.children[plan.first_child[front] : plan.first_child[front + 1]]:
            added, places = _update(plan, updates, child)
            inner = np.searchsorted(places, behind)
            for column in range(len(places)):
                from_column = added[column]
                if column >= inner:
                    to_update = update[places[column] - behind]
                    for row in range(column, len(places)):
                        to_update[places[row] - behind] += from_column[row]
                    continue
                to_own, to_below = own[places[column]], below[places[column]]
                for row in range(column, inner):
                    to_own[places[row]] += from_column[row]
                for row in range(inner, len(places)):
                    to_below[places[row] - behind] += from_column[row]
        if front == len(plan.own) - 1:
            break
        sizes[0], sizes[1] = size, rows
        dpotrf(lower, c, own.ctypes, c, failed)
        if sizes[2] != 0:
            return False
        if rows == 0:
            continue
        dtrsm(right, lower, transposed, plain, r, c, one, own.ctypes, c, below.ctypes, r)
        dsyrk(lower, plain, r, c, minus_one, below.ctypes, r, one, update.ctypes, r)
    return True


@njit(cache=True)
def _update(plan: _Plan, updates: Floats, front: int) -> tuple[Floats, NDArray[np.uint64]]:
    """Return a front's update matrix (r, r) and its places (r,) in the parent's front."""
    rows, begin, first = plan.below[front], plan.update[front], plan.first_row[front]
    return updates[begin : begin + rows * rows].reshape(rows, rows), plan.places[first : first + rows]


@njit(cache=True)
def _eliminated(plan: _Plan, factor: Floats, front: int) -> tuple[Floats, Floats, Ints, Ints]:
    """Return where a front's own columns of the factor begin, what is below them, and where both stand in A."""
    own = factor[plan.begin[front] :]
    below = own[plan.own[front] * plan.own[front] :]
    return own, below, plan.own_dofs[plan.first_own[front] :], plan.row_dofs[plan.first_row[front] :]


@njit(cache=True)
def _substitute(plan: _Plan, factor: Floats, right_side: Floats, routines: tuple) -> None:
    """Eliminate the dofs of all fronts but the last from a right side (n,), in place."""
    dgemv, dtrsv = routines
    lower, plain, step = _LOWER.ctypes, _PLAIN.ctypes, _STEP.ctypes
    one, zero = _ONE.ctypes, _ZERO.ctypes
    sizes = np.zeros(2, np.int32)
    c, r = sizes[:1].ctypes, sizes[1:].ctypes
    for front in range(len(plan.own) - 1):
        sizes[0], sizes[1] = size, rows = plan.own[front], plan.below[front]
        own, below, own_dofs, row_dofs = _eliminated(plan, factor, front)
        left, passed = np.empty(size), np.empty(rows)
        for k in range(size):
            left[k] = right_side[own_dofs[k]]
        dtrsv(lower, plain, plain, c, own.ctypes, c, left.ctypes, step)
        for k in range(size):
            right_side[own_dofs[k]] = left[k]
        if rows == 0:
            continue
        dgemv(plain, r, c, one, below.ctypes, r, left.ctypes, step, zero, passed.ctypes, step)
        for k in range(rows):
            right_side[row_dofs[k]] -= passed[k]


@njit(cache=True)
def _substitute_back(
    plan: _Plan, factor: Floats, right_side: Floats, solution: Floats, routines: tuple
) -> None:
    """Find the dofs of all fronts but the last, from the last front's in `solution` (n,)."""
    dgemv, dtrsv = routines
    lower, transposed, plain = _LOWER.ctypes, _TRANSPOSED.ctypes, _PLAIN.ctypes
    one, minus_one, step = _ONE.ctypes, _MINUS_ONE.ctypes, _STEP.ctypes
    sizes = np.zeros(2, np.int32)
    c, r = sizes[:1].ctypes, sizes[1:].ctypes
    for front in range(len(plan.own) - 2, -1, -1):
        sizes[0], sizes[1] = size, rows = plan.own[front], plan.below[front]
        own, below, own_dofs, row_dofs = _eliminated(plan, factor, front)
        known, left = np.empty(rows), np.empty(size)
        for k in range(rows):
            known[k] = solution[row_dofs[k]]
        for k in range(size):
            left[k] = right_side[own_dofs[k]]
        if rows > 0:
            dgemv(transposed, r, c, minus_one, below.ctypes, r, known.ctypes, step, one, left.ctypes, step)
        dtrsv(lower, transposed, plain, c, own.ctypes, c, left.ctypes, step)
        for k in range(size):
            solution[own_dofs[k]] = left[k]
