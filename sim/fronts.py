"""Condensation of a gel's linear equation onto its kept vertices, by a multifrontal Cholesky factor of all others.

LAPACK does the arithmetic on dense fronts (Duff & Reid 1983, ACM Trans. Math. Softw. 9:302; Liu 1992, SIAM Rev. 34:82).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import blas, lapack

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A subtree with at most this many vertices becomes one group: many small ones cost more than the zeros of a large one.
_SMALLEST_GROUP = 32
# A group takes in a child if at most this share of what it has then is zeros.
_LARGEST_SHARE_OF_ZEROS = 0.2


class Condensation:
    """Condenses A x = b, symmetric and positive definite with three dofs per vertex, onto the kept vertices.

    A is a sparse matrix whose values change while its pattern does not, plus a diagonal.

    Parameters
    ----------
    pattern
        The sparse matrix (n, n), of any values, with both of its triangles.
    first_dof
        The first dof of each vertex (v,) in the order of elimination.
    kept
        How many vertices, the last ones, are kept.
    """

    def __init__(self, pattern: sparse.csr_array, first_dof: Ints, kept: int) -> None:
        self._size, vertices = pattern.shape[0], len(first_dof)
        position = np.full(self._size, -1)
        position[_dofs(first_dof)] = np.arange(3 * vertices)
        rows = position[np.repeat(np.arange(self._size), np.diff(pattern.indptr))]
        columns = position[pattern.indices]
        both = (rows >= 0) & (columns >= 0)
        pairs = (rows[both] // 3, columns[both] // 3)
        graph = sparse.coo_array((np.ones(both.sum(), bool), pairs), shape=(vertices, vertices)).tocsr()
        groups = assembly_tree(graph, kept)
        own = np.array([3 * len(group.columns) for group in groups])
        below = np.array([3 * len(group.rows) + 1 for group in groups])
        begin = np.cumsum([0, *(own * (own + below))])
        self._factor = np.zeros(begin[-1])
        self._fronts = _fronts(groups, begin, self._factor, first_dof)
        self._source, self._target = _targets(rows, columns, groups, begin)
        blocks = list(zip(begin[:-1], own, below, strict=True))
        self._diagonal = np.concatenate([first + np.arange(c) * (c + 1) for first, c, _ in blocks])
        self._right_side = np.concatenate(
            [first + c * c + np.arange(1, c + 1) * r - 1 for first, c, r in blocks]
        )
        self._dofs = np.concatenate([front.own_dofs for front in self._fronts])
        self.kept_dofs = self._fronts[-1].own_dofs

    def condense(self, values: Floats, diagonal: Floats, right_side: Floats) -> tuple[Floats, Floats]:
        """Return the condensed matrix (k, k), of which only the lower triangle counts, and right side (k,).

        `values` are the sparse matrix's in its own order, `diagonal` (n,) is added, `right_side` (n,) is b.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is not positive definite.
        """
        self._factor.fill(0)
        self._factor[self._target] = values[self._source]
        self._factor[self._diagonal] += diagonal[self._dofs]
        self._factor[self._right_side] = right_side[self._dofs]
        *eliminated, kept = self._fronts
        for front in eliminated:
            self._assemble(front)
            front.eliminate()
        self._assemble(kept)
        return kept.own, kept.below[-1]

    def expand(self, kept: Floats) -> Floats:
        """Return x (n,) from its kept dofs (k,), after `condense`; 0 where there is no vertex."""
        solution = np.zeros(self._size)
        solution[self.kept_dofs] = kept
        for front in self._fronts[-2::-1]:
            left = -np.append(solution[front.row_dofs], -1.0) @ front.below
            solution[front.own_dofs] = blas.dtrsv(front.own, left, lower=1, trans=1)
        return solution

    def _assemble(self, front: "_Front") -> None:
        if front.children:
            front.update.fill(0)
        for number in front.children:
            child = self._fronts[number]
            _extend_add(front.own, front.below, front.update, child.update, child.places)


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
    rows: Ints
    children: list["_Branch"]
    entries: int


def assembly_tree(graph: sparse.csr_array, kept: int) -> list[Group]:
    """Return the groups of a mesh in postorder; the last consists of the last `kept` vertices and has no rows.

    `graph` (n, n) has an entry for every pair of vertices that are coupled, in the order of elimination. Groups are
    relaxed supernodes (Liu 1992, SIAM Rev. 34:82; Ashcraft & Grimes 1989, ACM Trans. Math. Softw. 15:291): a vertex
    takes in the groups that are eliminated right before it, unless too many zeros would be held.
    """
    count = graph.shape[0]
    root = _Branch(list(range(count - kept, count)), np.empty(0, np.int64), [], 0)
    waiting: list[list[_Branch]] = [[] for _ in range(count)]
    descendants = np.ones(count, dtype=np.int64)
    for vertex in range(count - kept):
        rows = graph.indices[graph.indptr[vertex] : graph.indptr[vertex + 1]]
        rows = np.unique(np.concatenate([rows, *(child.rows for child in waiting[vertex])]))
        rows = rows[rows > vertex]
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
        parent = int(rows[0]) if len(rows) else count
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
    return [
        Group(
            np.sort(branch.columns),
            branch.rows,
            tuple(sorted(number[id(child)] for child in branch.children)),
        )
        for branch in order
    ]


@dataclass(frozen=True)
class _Front:
    """The dense matrix of a group: its `own` triangle (c, c) and what is `below` (r + 1, c), which become the factor's.

    The right side is the last row. `update` (r + 1, r + 1) is what elimination leaves of the rest; it is added to the
    parent's front at `places` (r + 1,). Its memory belongs to a later front as soon as the parent has it. `own_dofs`
    (c,) and `row_dofs` (r,) say where all this stands in A.
    """

    own: Floats
    below: Floats
    update: Floats
    own_dofs: Ints
    row_dofs: Ints
    children: tuple[int, ...]
    places: Ints

    def eliminate(self) -> None:
        """Turn the front into a part of the factor, and find its update."""
        _, failed = lapack.dpotrf(self.own, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        blas.dtrsm(1.0, self.own, self.below, side=1, lower=1, trans_a=1, overwrite_b=1)
        # What a front without children finds in the memory of its update is not its own.
        begun = 1.0 if self.children else 0.0
        blas.dsyrk(-1.0, self.below, beta=begun, c=self.update, lower=1, overwrite_c=1)


def _fronts(groups: list[Group], begin: Ints, factor: Floats, first_dof: Ints) -> list[_Front]:
    """Return the fronts as views on the factor's memory and on that of their updates.

    Each front lies in the factor from its `begin` on: its own part column by column, then what is below.
    """
    updates = _update_matrices(groups)
    parent = {child: group for group in groups for child in group.children}
    fronts = []
    for number, group in enumerate(groups):
        places = np.empty(0, np.int64)
        if number in parent:
            both = np.concatenate([parent[number].columns, parent[number].rows])
            order = np.argsort(both)
            places = np.append(_dofs(3 * order[np.searchsorted(both[order], group.rows)]), 3 * len(both))
        own, below = 3 * len(group.columns), 3 * len(group.rows) + 1
        middle = begin[number] + own * own
        fronts.append(
            _Front(
                own=factor[begin[number] : middle].reshape((own, own), order="F"),
                below=factor[middle : begin[number + 1]].reshape((below, own), order="F"),
                update=updates[number],
                own_dofs=_dofs(first_dof[group.columns]),
                row_dofs=_dofs(first_dof[group.rows]),
                children=group.children,
                places=places,
            )
        )
    return fronts


def _update_matrices(groups: list[Group]) -> list[Floats]:
    """Return the groups' update matrices; groups equally deep in the tree share memory if their parents differ."""
    sizes = [3 * len(group.rows) + 1 for group in groups]
    depth, begin = [0] * len(groups), [0] * len(groups)
    needed = [sizes[-1] ** 2] + [0] * len(groups)
    for number in reversed(range(len(groups))):
        offset = 0
        for child in groups[number].children:
            depth[child], begin[child] = depth[number] + 1, offset
            offset += sizes[child] ** 2
        needed[depth[number] + 1] = max(needed[depth[number] + 1], offset)
    memory = [np.empty(length) for length in needed]
    return [
        memory[depth[number]][begin[number] : begin[number] + size**2].reshape((size, size), order="F")
        for number, size in enumerate(sizes)
    ]


def _targets(rows: Ints, columns: Ints, groups: list[Group], begin: Ints) -> tuple[Ints, Ints]:
    """Return which of the sparse matrix's values go into the factor's memory, and where to.

    `rows` and `columns` (values,) are places in the order of elimination, −1 where a dof has none.
    """
    vertices = sum(len(group.columns) for group in groups)
    group_of, place_in_group = np.empty(vertices, np.int64), np.empty(vertices, np.int64)
    for number, group in enumerate(groups):
        group_of[group.columns] = number
        place_in_group[group.columns] = np.arange(len(group.columns))
    lower = np.flatnonzero((columns >= 0) & (rows >= columns))
    lower = lower[np.argsort(group_of[columns[lower] // 3], kind="stable")]
    (row, row_axis), (column, column_axis) = (np.divmod(values[lower], 3) for values in (rows, columns))
    group = group_of[column]
    own, below = (
        np.array([3 * len(g.columns) for g in groups])[group],
        np.array([3 * len(g.rows) + 1 for g in groups])[group],
    )
    # The groups' rows, one group after another, ascend if each is raised by its group's number.
    raised = np.concatenate([number * vertices + g.rows for number, g in enumerate(groups)])
    first_row = np.cumsum([0, *(len(g.rows) for g in groups)])[group]
    place_below = np.searchsorted(raised, group * vertices + row) - first_row
    column = 3 * place_in_group[column] + column_axis
    in_own = 3 * place_in_group[row] + row_axis + column * own
    in_below = own * own + 3 * place_below + row_axis + column * below
    return lower, begin[group] + np.where(group_of[row] == group, in_own, in_below)


def _dofs(first_dof: Ints) -> Ints:
    """Return the dofs (3 n,) of vertices from their first ones (n,)."""
    return (first_dof[:, None] + np.arange(3)).ravel()


@njit(cache=True)
def _extend_add(own: Floats, below: Floats, update: Floats, child: Floats, places: Ints) -> None:
    """Add a child's update matrix (n, n), its lower triangle, at `places` (n,) of a front."""
    size = own.shape[0]
    for column in range(len(places)):
        to = places[column]
        for row in range(column, len(places)):
            place = places[row]
            if place < size:
                own[place, to] += child[row, column]
            elif to < size:
                below[place - size, to] += child[row, column]
            else:
                update[place - size, to - size] += child[row, column]
