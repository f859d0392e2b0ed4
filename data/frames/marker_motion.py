"""Displacement of the membrane, in mm, from its markers in a picture and the reference, whatever pattern they have.

Markers are found in both pictures, matched from neighbour to neighbour, brought to mm by the camera, and interpolated
by thin plates. A frame of 320×240 px takes 2 ms; dense flow of pictures with and without their markers took 13 ms, and
was as far from the true displacement.
"""

import numba
import numpy as np

from gelgap.assets.pinhole import Pinhole
from gelgap.data.inpainting import smooth_brightness, without_dark_spots

# By this share of their surroundings' code value markers are darker at least; noise and most shading is not.
_LEAST_CONTRAST = 0.25
FEWEST_MARKERS = 8
# Of the distance to the nearest neighbour: a marker is this near to where its neighbours' motion puts it.
_MATCHED_WITHIN = 0.4
# Of the rest area: blobs of other sizes are markers that have merged, or are half hidden.
_AREA_FACTORS = 0.4, 1.7
# The gel is held at rest at this many points, this far beyond the grid: a bound for what lies beyond the markers.
_AT_REST_BEYOND_MM, _AT_REST = 3.0, 24


class MarkerTracker:
    """The markers of one reference picture: finds each of them again in pictures of the same sensor.

    Attributes
    ----------
    rest_mm
        (n, 2) where the markers are without contact, in the sensor's plane.

    Raises
    ------
    ValueError
        If the reference is not uint8 (h, w, 3), or shows fewer than eight markers.
    """

    def __init__(self, reference: np.ndarray, camera: Pinhole) -> None:
        from scipy.spatial import Delaunay, cKDTree

        self._camera, self._shape = camera, reference.shape
        darkness = _darkness(reference)
        self._level = _marker_level(darkness)
        places, areas = _blobs(darkness, self._level)
        median = np.median(areas) if len(areas) else 0.0
        usual = (areas > 0.4 * median) & (areas < 2.5 * median)
        if (count := np.count_nonzero(usual)) < FEWEST_MARKERS:
            raise ValueError(f"the reference shows {count} markers; motion needs {FEWEST_MARKERS} or more")
        self._rest_px, self._areas = places[usual], areas[usual]
        self._start, self._neighbours = Delaunay(self._rest_px).vertex_neighbor_vertices
        self._spacing_px = cKDTree(self._rest_px).query(self._rest_px, k=2)[0][:, 1]
        self.rest_mm = self._in_mm(self._rest_px)

    def displacement_mm(self, picture: np.ndarray) -> np.ndarray:
        """Return (n, 2): how far each marker seems to have moved; NaN for one not seen, or not told from others.

        One that sinks by d, r off the axis of a camera H away, seems to move outwards by r d/(H − d), up to 0.2 mm.

        Raises
        ------
        ValueError
            If the picture is not of the reference's size.
        """
        if picture.shape != self._shape:
            raise ValueError(
                f"the picture has shape {picture.shape} and the reference {self._shape}; both must be of one size"
            )
        places, areas = _blobs(_darkness(picture), self._level)
        found = np.full(len(self.rest_mm), -1)
        if len(places):
            rest = self._rest_px, self._areas, self._spacing_px, self._start, self._neighbours
            found = _matched(*rest, places, areas)
        moved = np.full(self.rest_mm.shape, np.nan)
        seen = found >= 0
        moved[seen] = self._in_mm(places[found[seen]]) - self.rest_mm[seen]
        return moved

    def _in_mm(self, places_px: np.ndarray) -> np.ndarray:
        size_px = self._shape[1], self._shape[0]
        return self._camera.plane_points_mm(places_px[:, 0], places_px[:, 1], size_px)


class ThinPlate:
    """Interpolates displacements of fixed places on a grid: the surface of least bending energy through those known.

    Its matrices are made once, so that a frame costs a product. Those that are not known are first set to what bends
    least, which gives the interpolant of the others. On an ellipse around the grid nothing moves.

    Parameters
    ----------
    places_mm
        (n, 2).
    size, span_mm
        Columns and rows of the grid, and the width and height around (0, 0) that they divide.
    """

    def __init__(self, places_mm: np.ndarray, size: tuple[int, int], span_mm: tuple[float, float]) -> None:
        from scipy.spatial.distance import cdist

        self._size, angles = size, np.linspace(0, 2 * np.pi, _AT_REST, endpoint=False)
        half_mm = np.array(span_mm) / 2 + _AT_REST_BEYOND_MM
        at_rest_mm = half_mm * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        places_mm = np.concatenate([places_mm, at_rest_mm])
        axes = (
            ((np.arange(count) + 0.5) / count - 0.5) * span for count, span in zip(size, span_mm, strict=True)
        )
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        n = len(places_mm)
        system = np.zeros((n + 3, n + 3))
        system[:n, :n], system[:n, n:] = _kernel(cdist(places_mm, places_mm)), _linear(places_mm)
        system[n:, :n] = system[:n, n:].T
        solution = np.linalg.inv(system)[:, :n]
        self._bending = solution[:n]
        self._weights = np.hstack([_kernel(cdist(grid, places_mm)), _linear(grid)]) @ solution
        self._weights = self._weights.astype(np.float32)

    def __call__(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Return (rows, columns, 2) float32 of displacements (n, 2), NaN where unknown."""
        whole = np.concatenate([displacement_mm, np.zeros((_AT_REST, 2))])
        known = ~np.isnan(whole[:, 0])
        if not known.all():
            pull = self._bending[np.ix_(~known, known)] @ whole[known]
            whole[~known] = np.linalg.solve(self._bending[np.ix_(~known, ~known)], -pull)
        field = self._weights @ whole.astype(np.float32)
        return field.reshape(self._size[1], self._size[0], 2)


def _kernel(distances: np.ndarray) -> np.ndarray:
    return distances**2 * np.log(np.maximum(distances, 1e-12))


def _linear(places: np.ndarray) -> np.ndarray:
    return np.column_stack([np.ones(len(places)), places])


def _darkness(picture: np.ndarray) -> np.ndarray:
    """Return uint8 (h, w): by how many 255ths its surroundings are brighter than a pixel, in the brightest channel."""
    import cv2

    smooth = smooth_brightness(picture)
    height, width = smooth.shape
    # What is around varies slowly: at 160 px it costs a sixteenth.
    small = min(1.0, 160 / width)
    reduced = cv2.resize(smooth, None, fx=small, fy=small, interpolation=cv2.INTER_AREA)
    around = cv2.resize(without_dark_spots(reduced), (width, height))
    lower = cv2.subtract(around, smooth)
    return cv2.divide(lower, around, scale=255.0)


def _marker_level(darkness: np.ndarray) -> float:
    """Return the darkness at which half a pixel is a marker: half of Otsu's, or of the least contrast."""
    import cv2

    otsu, _ = cv2.threshold(darkness, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    return max(otsu, 255 * _LEAST_CONTRAST) / 2


def _blobs(darkness: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres (n, 2) px and areas (n,) of dark blobs that the picture shows whole, and are dark enough."""
    import cv2

    height, width = darkness.shape
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        (darkness > level).astype(np.uint8), connectivity=4
    )
    rows, columns = np.nonzero(labels)
    own = labels[rows, columns]
    excess = darkness[rows, columns].astype(np.float64) - level
    count = len(stats)
    weight = np.bincount(own, excess, count)
    deepest = np.zeros(count)
    np.maximum.at(deepest, own, excess)
    left, top, wide, high, area = stats.T
    whole = (left > 0) & (top > 0) & (left + wide < width) & (top + high < height)
    kept = whole & (deepest > level) & (area >= 6)
    kept[0] = False
    sums = np.stack([np.bincount(own, excess * along, count) for along in (columns, rows)], axis=1)
    return sums[kept] / weight[kept, None], area[kept].astype(float)


@numba.njit(cache=True, error_model="numpy")
def _nearest(x, y, places):
    best, least = -1, np.inf
    for j in range(len(places)):
        square = (places[j, 0] - x) ** 2 + (places[j, 1] - y) ** 2
        if square < least:
            best, least = j, square
    return best, np.sqrt(least)


@numba.njit(cache=True, error_model="numpy")
def _matched(rest, rest_area, spacing, start, neighbours, places, areas):
    """Return which of `places` (m, 2) each marker at rest (n, 2) is, −1 for none; each is one marker at most.

    A marker that has moved by a pitch lies where another one was, so that the nearest place misleads. Matching starts
    where nothing seems to move, and goes on to the marker that is nearest to where its matched neighbours' motion puts
    it, best first. What it needs is that neighbours move alike, within less than half their distance.
    """
    n = len(rest)
    found, taken = np.full(n, -1), np.zeros(len(places), np.bool_)
    still = np.empty(n)
    for i in range(n):
        still[i] = _nearest(rest[i, 0], rest[i, 1], places)[1] / spacing[i]
    quiet = still.copy()
    for i in range(n):
        around = neighbours[start[i] : start[i + 1]]
        quiet[i] += still[around].max()
    first = np.argmin(quiet)
    cost, choice = np.full(n, np.inf), np.full(n, -1)
    cost[first], choice[first] = still[first], _nearest(rest[first, 0], rest[first, 1], places)[0]
    while True:
        i = np.argmin(cost)
        if cost[i] > _MATCHED_WITHIN:
            return found
        cost[i] = np.inf
        if taken[choice[i]]:
            continue
        found[i], taken[choice[i]] = choice[i], True
        for k in neighbours[start[i] : start[i + 1]]:
            if found[k] >= 0:
                continue
            moved_x = moved_y = total = 0.0
            for other in neighbours[start[k] : start[k + 1]]:
                if found[other] >= 0:
                    weight = 1 / ((rest[other, 0] - rest[k, 0]) ** 2 + (rest[other, 1] - rest[k, 1]) ** 2)
                    moved_x += weight * (places[found[other], 0] - rest[other, 0])
                    moved_y += weight * (places[found[other], 1] - rest[other, 1])
                    total += weight
            j, distance = _nearest(rest[k, 0] + moved_x / total, rest[k, 1] + moved_y / total, places)
            least, most = _AREA_FACTORS[0] * rest_area[k], _AREA_FACTORS[1] * rest_area[k]
            if least < areas[j] < most:
                cost[k], choice[k] = distance / spacing[k], j
