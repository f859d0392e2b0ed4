"""A mesh that follows the contact's path: boxes that halve towards it, in the plane and with height, split into tetrahedra.

Each layer of the gel is a quadtree in the plane (Finkel & Bentley 1974, Acta Inform. 4:1): squares of a size that grows with
the distance from the segments along which the indenter travels and, layer by layer, with depth. A box is a polyhedron: its
top may border on four smaller boxes, its sides on smaller neighbours. It gets a vertex in its centre and one in the
centre of each face, as the prisms of `mesh.py` do, and so a mesh of boxes of many sizes has no hanging nodes.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh import GelMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Square = tuple[int, int, int]  # least x, least y and width, in units of the smallest width


@dataclass(frozen=True)
class PathMeshSize:
    """How fine a mesh is, by what the contact itself gives.

    A contact, by the radius at which the indenter cuts the rest membrane, is `across` cells wide from its axis; beyond
    `margin` radii of the path, cells grow by `growth` per mm. The first layer has `first_layer` of a cell's width; each
    further one is `layer_growth` thicker, up to `largest_layer` of the gel's thickness, and from the base up alike, from
    `base_layer` of it. Boxes are at least `depth_growth` times as wide as their top lies deep.
    """

    across: float
    growth: float = 0.5
    first_layer: float = 0.55
    layer_growth: float = 1.8
    largest_layer: float = 0.22
    base_layer: float = 0.06
    depth_growth: float = 0.6
    margin: float = 1.1
    reach: float = 3.3
    largest_cell: float = 0.8


class Target:
    """Which width cells should have at a point: the least that any segment of the path asks for."""

    def __init__(self, size: PathMeshSize, segments_mm: Floats, radii_mm: Floats, largest_mm: float) -> None:
        self.size, self.segments_mm, self.radii_mm, self.largest_mm = size, segments_mm, radii_mm, largest_mm

    def width_mm(self, points_mm: Floats, slack_mm: Floats) -> Floats:
        """Return the width (n,) at points (n, 2), up to `slack_mm` (n,) nearer to the path."""
        width_mm = np.full(len(points_mm), self.largest_mm)
        for (start, end), radius in zip(self.segments_mm, self.radii_mm, strict=True):
            along = end - start
            share = np.clip((points_mm - start) @ along / max(along @ along, 1e-12), 0, 1)
            distance = np.linalg.norm(points_mm - start - share[:, None] * along, axis=1)
            beyond = np.maximum(distance - slack_mm - self.size.margin * radius, 0)
            width_mm = np.minimum(width_mm, radius / self.size.across + self.size.growth * beyond)
        return width_mm


@dataclass(frozen=True)
class Axis:
    """A coordinate along which the boxes are counted: place 0 is the contact's axis, `low` ≤ 0 and `high` ≥ 0 the rims.

    Between them places are stretched a little, so that the pad's edges lie on the rims.
    """

    low: int
    high: int
    low_mm: float
    high_mm: float
    origin_mm: float = 0.0

    @classmethod
    def between(cls, low_mm: float, high_mm: float, cell_mm: float, root: int) -> "Axis":
        """Return the axis from `low_mm` to `high_mm`, whose boxes can be as wide as they are away from the rim."""
        low, high = (_whole(edge / cell_mm, root) for edge in (-low_mm, high_mm))
        origin = high_mm if high == 0 else low_mm if low == 0 else 0.0
        return cls(-low, high, low_mm, high_mm, origin)

    def mm(self, place: Floats) -> Floats:
        return np.interp(place, [self.low, 0, self.high] if self.low and self.high else [self.low, self.high],
                         [self.low_mm, self.origin_mm, self.high_mm] if self.low and self.high else [self.low_mm, self.high_mm])


def _whole(cells: float, root: int) -> int:
    """Return a whole number near `cells`, a multiple of the largest power of two up to `root` that is near enough."""
    if cells < 0.35:
        return 0
    step = root
    while step > 1 and abs(round(cells / step) * step / cells - 1) > 0.12:
        step //= 2
    return max(1, round(cells / step)) * step


def layers_mm(thickness_mm: float, first_mm: float, size: PathMeshSize) -> Floats:
    """Return the z of the interfaces from 0 down: layers that thicken from the membrane and from the base, up to a largest."""
    largest = size.largest_layer * thickness_mm
    upper, lower = [min(first_mm, largest)], [min(size.base_layer * thickness_mm, largest)]
    while sum(upper) + sum(lower) < thickness_mm:
        grow = upper if upper[-1] <= lower[-1] else lower
        grow.append(min(grow[-1] * size.layer_growth, largest))
    thick = np.array([*upper, *lower[::-1]])
    excess = thick.sum() - thickness_mm
    # What is too much is taken from the layers in proportion to the square of their thickness: least from the thin ones.
    thick -= excess * thick**2 / (thick**2).sum()
    return -np.concatenate([[0.0], np.cumsum(thick)])


def squares(axes: tuple[Axis, Axis], root: int, cell_mm: float, target: Target, least_mm: float) -> list[Square]:
    """Return the squares of one layer, no wider than the target or `least_mm`, whichever is wider."""
    x, y = axes
    i, j = (np.arange(math.floor(a.low / root), math.ceil(a.high / root)) * root for a in axes)
    cells = np.stack(np.meshgrid(i, j, indexing="ij"), -1).reshape(-1, 2)
    done, width = [], root
    while len(cells):
        low, high = cells, cells + width
        inside = (high[:, 0] > x.low) & (low[:, 0] < x.high) & (high[:, 1] > y.low) & (low[:, 1] < y.high)
        cells = cells[inside]
        low, high = cells, cells + width
        crosses = (low[:, 0] < x.low) | (high[:, 0] > x.high) | (low[:, 1] < y.low) | (high[:, 1] > y.high)
        centre = np.column_stack([axis.mm(cells[:, k] + width / 2) for k, axis in enumerate(axes)])
        wide = width * cell_mm
        wanted = np.maximum(target.width_mm(centre, np.full(len(cells), 0.5 * wide)), least_mm)
        split = (crosses | (wide > 1.42 * wanted)) & (width > 1)
        done += [(int(a), int(b), width) for a, b in cells[~split]]
        width //= 2
        cells = (cells[split][:, None] + width * np.array([(0, 0), (1, 0), (0, 1), (1, 1)])).reshape(-1, 2)
    return done


def path_mesh(
    size: PathMeshSize,
    thickness_mm: float,
    segments_mm: Floats,
    radii_mm: Floats,
    pad_mm: tuple[float, float, float, float] | None,
    *,
    symmetric: bool,
    wide_reach_mm: float = 0.0,
) -> GelMesh:
    """Mesh the gel around segments (n, 2, 2) of the path, along which contacts have cut radii up to `radii_mm` (n,)."""
    radii_mm = np.maximum(radii_mm, 1e-3)
    cell_mm = float(radii_mm.min()) / size.across
    largest_mm = size.largest_cell * thickness_mm
    root = 2 ** max(0, math.floor(math.log2(1.42 * largest_mm / cell_mm)))
    reach = max(size.reach * thickness_mm, wide_reach_mm, 1.6 * float(radii_mm.max()))
    low, high = segments_mm.min(axis=(0, 1)) - reach, segments_mm.max(axis=(0, 1)) + reach
    if pad_mm is not None:
        low, high = np.maximum(low, [pad_mm[0], pad_mm[2]]), np.minimum(high, [pad_mm[1], pad_mm[3]])
    if symmetric:
        low[1] = 0.0
    axes = tuple(Axis.between(low[k], high[k], cell_mm, root) for k in range(2))
    z_mm = layers_mm(thickness_mm, size.first_layer * cell_mm, size)
    target = Target(size, segments_mm, radii_mm, largest_mm)
    planes = [squares(axes, root, cell_mm, target, size.depth_growth * -z) for z in z_mm[:-1]]
    vertices, tetrahedra = _split_boxes(planes, z_mm, axes)
    return GelMesh(vertices, tetrahedra, symmetric)


def _split_boxes(planes: list[list[Square]], z_mm: Floats, axes: tuple[Axis, Axis]) -> tuple[Floats, NDArray[np.int32]]:
    """Split the boxes of layers, by their `planes`, into tetrahedra; return vertices (n, 3) and tetrahedra (m, 4).

    Between two layers the faces are the squares of the upper one, which are no wider than those below.
    """
    places: list[tuple[float, float, float]] = []
    number: dict[tuple, int] = {}
    tetrahedra: list[tuple[int, int, int, int]] = []

    def vertex(x: float, y: float, z: float) -> int:
        key = (x, y, z)
        if key not in number:
            number[key] = len(places)
            places.append(key)
        return number[key]

    corners = [
        {(a, b) for i, j, w in plane for a, b in ((i, j), (i + w, j), (i, j + w), (i + w, j + w))} for plane in planes
    ]

    def divided(nodes: set, a: tuple[int, int], b: tuple[int, int]) -> list[tuple[int, int]]:
        """Return a, and the nodes between a and b, without b."""
        if abs(a[0] - b[0]) + abs(a[1] - b[1]) > 1:
            middle = ((a[0] + b[0]) // 2, (a[1] + b[1]) // 2)
            if middle in nodes:
                return divided(nodes, a, middle) + divided(nodes, middle, b)
        return [a]

    def outline(nodes: set, square: Square) -> list[tuple[int, int]]:
        i, j, w = square
        turn = ((i, j), (i + w, j), (i + w, j + w), (i, j + w))
        return [point for k in range(4) for point in divided(nodes, turn[k], turn[(k + 1) % 4])]

    def fan(ring: list[int], face: int, body: int) -> None:
        """Add tetrahedra between a face, whose ring is counterclockwise seen from outside, and the body's centre."""
        for k, a in enumerate(ring):
            tetrahedra.append((ring[(k + 1) % len(ring)], a, face, body))

    for layer, plane in enumerate(planes):
        above = planes[max(layer - 1, 0)]
        nodes_above, nodes, top, base = corners[max(layer - 1, 0)], corners[layer], layer, layer + 1
        smaller: dict[Square, list[Square]] = {square: [] for square in plane}
        widths = sorted({w for _, _, w in plane})
        for square in above:
            for w in widths:
                over = (square[0] // w * w, square[1] // w * w, w)
                if over in smaller:
                    smaller[over].append(square)
                    break
        for square in plane:
            i, j, w = square
            body = vertex(i + w / 2, j + w / 2, layer + 0.5)
            for face in smaller[square]:
                ring = [vertex(*point, top) for point in outline(nodes_above, face)]
                fan(ring, vertex(face[0] + face[2] / 2, face[1] + face[2] / 2, top), body)
            round_ = outline(nodes, square)
            fan([vertex(*point, base) for point in round_[::-1]], vertex(i + w / 2, j + w / 2, base), body)
            for k, a in enumerate(round_):
                b = round_[(k + 1) % len(round_)]
                upper = [vertex(*point, top) for point in [*divided(nodes_above, b, a), a]]
                ring = [*upper, vertex(*a, base), vertex(*b, base)]
                fan(ring, vertex((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, layer + 0.5), body)
    x, y, z = np.array(places).T
    vertices = np.column_stack([axes[0].mm(x), axes[1].mm(y), np.interp(z, np.arange(len(z_mm)), z_mm)])
    return vertices, np.array(tetrahedra, dtype=np.int32)
