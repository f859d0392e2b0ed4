"""Condensation of a gel's linear equation onto its kept vertices, by a multifrontal Cholesky factor of all others.

LAPACK does the arithmetic on dense fronts (Duff & Reid 1983, ACM Trans. Math. Softw. 9:302; Liu 1992, SIAM Rev. 34:82).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import blas, lapack

from gelgap.sim.assembly_tree import Group, Ints, assembly_tree

Floats = NDArray[np.float64]

_AXES = np.arange(3)


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


@dataclass(frozen=True)
class _Block:
    """Where a front lies in the factor's memory: its own part from `begin` on, column by column, then what is below.

    `own` is how many columns it has, and rows of its own part; `below` how many rows follow, the right side's the last.
    """

    begin: int
    own: int
    below: int

    @property
    def middle(self) -> int:
        """Where what is below begins."""
        return self.begin + self.own * self.own

    @property
    def end(self) -> int:
        return self.middle + self.own * self.below


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
        self._size = pattern.shape[0]
        position = np.full(self._size, -1)
        position[_dofs(first_dof)] = np.arange(3 * len(first_dof))
        groups = assembly_tree(_graph(pattern, position, len(first_dof)), kept)
        blocks = _blocks(groups)
        self._factor = np.zeros(blocks[-1].end)
        self._fronts = _fronts(groups, blocks, self._factor, first_dof)
        self._source, self._target = _targets(pattern, position, groups, blocks)
        self._diagonal = np.concatenate([b.begin + np.arange(b.own) * (b.own + 1) for b in blocks])
        self._right_side = np.concatenate([b.middle + np.arange(1, b.own + 1) * b.below - 1 for b in blocks])
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

    def _assemble(self, front: _Front) -> None:
        if front.children:
            front.update.fill(0)
        for number in front.children:
            child = self._fronts[number]
            _extend_add(front.own, front.below, front.update, child.update, child.places)


def _graph(pattern: sparse.csr_array, position: Ints, vertices: int) -> sparse.csr_array:
    """Return which vertices are coupled, (v, v), in the order of elimination."""
    rows = position[np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))] // 3
    columns = position[pattern.indices] // 3
    both = (rows >= 0) & (columns >= 0)
    pairs = sparse.coo_array(
        (np.ones(both.sum(), bool), (rows[both], columns[both])), shape=(vertices, vertices)
    )
    return pairs.tocsr()


def _blocks(groups: list[Group]) -> list[_Block]:
    """Return the groups' places in the factor's memory, one after another."""
    blocks, begin = [], 0
    for group in groups:
        blocks.append(_Block(begin, 3 * len(group.columns), 3 * len(group.rows) + 1))
        begin = blocks[-1].end
    return blocks


def _fronts(groups: list[Group], blocks: list[_Block], factor: Floats, first_dof: Ints) -> list[_Front]:
    """Return the fronts as views on the factor's memory and on that of their updates."""
    updates = _update_matrices(groups, [block.below for block in blocks])
    parent = {child: group for group in groups for child in group.children}
    fronts = []
    for number, (group, block) in enumerate(zip(groups, blocks, strict=True)):
        places = np.empty(0, np.int64)
        if number in parent:
            both = np.concatenate([parent[number].columns, parent[number].rows])
            order = np.argsort(both)
            places = np.append(_dofs(3 * order[np.searchsorted(both[order], group.rows)]), 3 * len(both))
        fronts.append(
            _Front(
                own=factor[block.begin : block.middle].reshape((block.own, block.own), order="F"),
                below=factor[block.middle : block.end].reshape((block.below, block.own), order="F"),
                update=updates[number],
                own_dofs=_dofs(first_dof[group.columns]),
                row_dofs=_dofs(first_dof[group.rows]),
                children=group.children,
                places=places,
            )
        )
    return fronts


def _update_matrices(groups: list[Group], rows: list[int]) -> list[Floats]:
    """Return the groups' update matrices, of `rows` each; groups as deep in the tree share memory if parents differ."""
    depth = [0] * len(groups)
    begin = [0] * len(groups)
    needed = [0] * (len(groups) + 1)
    needed[0] = rows[-1] ** 2
    for number in reversed(range(len(groups))):
        offset = 0
        for child in groups[number].children:
            depth[child], begin[child] = depth[number] + 1, offset
            offset += rows[child] ** 2
        needed[depth[number] + 1] = max(needed[depth[number] + 1], offset)
    memory = [np.empty(length) for length in needed]
    return [
        memory[depth[number]][begin[number] : begin[number] + count**2].reshape((count, count), order="F")
        for number, count in enumerate(rows)
    ]


def _targets(
    pattern: sparse.csr_array, position: Ints, groups: list[Group], blocks: list[_Block]
) -> tuple[Ints, Ints]:
    """Return which of the sparse matrix's values go into the factor's memory, and where to."""
    rows = position[np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))]
    columns = position[pattern.indices]
    group_of = np.empty(len(position) // 3 + 1, dtype=np.int64)
    place_in_group = np.empty_like(group_of)
    for number, group in enumerate(groups):
        group_of[group.columns] = number
        place_in_group[group.columns] = np.arange(len(group.columns))
    lower = np.flatnonzero((columns >= 0) & (rows >= columns))
    lower = lower[np.argsort(group_of[columns[lower] // 3], kind="stable")]
    ends = np.searchsorted(group_of[columns[lower] // 3], np.arange(len(groups) + 1))
    target = np.empty(len(lower), dtype=np.int64)
    for number, (group, block) in enumerate(zip(groups, blocks, strict=True)):
        some = lower[ends[number] : ends[number + 1]]
        row, column = rows[some], 3 * place_in_group[columns[some] // 3] + columns[some] % 3
        inside = group_of[row // 3] == number
        in_own = block.begin + 3 * place_in_group[row // 3] + row % 3 + column * block.own
        in_below = block.middle + 3 * np.searchsorted(group.rows, row // 3) + row % 3 + column * block.below
        target[ends[number] : ends[number + 1]] = np.where(inside, in_own, in_below)
    return lower, target


def _dofs(first_dof: Ints) -> Ints:
    """Return the dofs (3 n,) of vertices from their first ones (n,)."""
    return (first_dof[:, None] + _AXES).ravel()


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
