"""The assembly tree of a sparse Cholesky factor: which vertices of a mesh are eliminated together, and after which."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

# A subtree with at most this many vertices becomes one group: many small ones cost more than the zeros of a large one.
_SMALLEST_GROUP = 32
# A group takes in a child if at most this share of what it has then is zeros.
_LARGEST_SHARE_OF_ZEROS = 0.2

Ints = NDArray[np.int64]


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
    relaxed supernodes (Liu 1992, SIAM Rev. 34:82; Ashcraft & Grimes 1989, ACM Trans. Math. Softw. 15:291).
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
        parent = int(rows[0]) if len(rows) else count
        small = descendants[vertex] <= _SMALLEST_GROUP
        for child in sorted(waiting[vertex], key=lambda child: -len(child.rows)):
            _take(branch, child, whole=bool(small))
        if parent < count - kept:
            waiting[parent].append(branch)
            descendants[parent] += descendants[vertex]
        else:
            root.children.append(branch)
    return _postordered(root)


def _take(branch: _Branch, child: _Branch, *, whole: bool) -> None:
    """Take in a child, or keep it as one if that would hold too many zeros and the branch is not small as a `whole`."""
    columns = len(branch.columns) + len(child.columns)
    entries = branch.entries + child.entries
    held = columns * (columns + 1) // 2 + columns * len(branch.rows)
    if whole or held * (1 - _LARGEST_SHARE_OF_ZEROS) <= entries:
        branch.columns += child.columns
        branch.children += child.children
        branch.entries = entries
    else:
        branch.children.append(child)


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
