"""Taking the markers out of a picture: find them in the picture itself, as one must with a real sensor, and fill in."""

import numba
import numpy as np

_FAR_PX = np.float32(1e6)


def detect_markers(
    picture: np.ndarray, largest_diameter_px: float | None = None, least_contrast: float = 0.25
) -> np.ndarray:
    """Return the bool (h, w) mask of dark markers in a uint8 (h, w, 3) sRGB picture.

    A marker is darker than its surroundings in every channel, which shading under coloured light never is: a black
    top-hat over the brightest channel finds it, and Otsu's threshold cuts it out. The mask is grown by a pixel or two,
    so that no rim stays.

    Parameters
    ----------
    largest_diameter_px
        Markers are no larger than this; by default 8 % of the picture's width.
    least_contrast
        By this share of their surroundings' code value markers are darker at least; shading and noise are not.

    Raises
    ------
    ValueError
        If the picture is not uint8 (h, w, 3).
    """
    import cv2

    _check(picture)
    width = picture.shape[1]
    size = int(largest_diameter_px or max(0.08 * width, 5)) | 1
    # OpenCV finds the brightest channel twenty times as fast as NumPy, whose inner loop is over three values.
    channels = cv2.max(cv2.max(picture[..., 0], picture[..., 1]), picture[..., 2])
    brightest = cv2.GaussianBlur(channels, (0, 0), 0.8 * max(width / 320, 0.5))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    around = cv2.morphologyEx(brightest, cv2.MORPH_CLOSE, kernel)
    depth = around - brightest
    otsu, _ = cv2.threshold(depth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    if otsu < least_contrast * np.median(around):
        return np.zeros(brightest.shape, bool)
    # The rim of a marker is half covered: cut at half of Otsu's level, and only where a core was found.
    # Codes are whole, so that a level for each code of the surroundings, rounded down, is a table.
    level = np.maximum(otsu, least_contrast * np.arange(256))
    core, rim = (
        (depth > cv2.LUT(around, np.minimum(share * level, 255).astype(np.uint8))).astype(np.uint8)
        for share in (1.0, 0.5)
    )
    grow = 2 * round(max(width / 320, 0.5)) + 1
    wide, narrow = (
        cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)) for size in (2 * grow + 1, grow)
    )
    return cv2.dilate(rim & cv2.dilate(core, wide), narrow).astype(bool)


def inpaint_telea(picture: np.ndarray, mask: np.ndarray, radius_px: int = 3) -> np.ndarray:
    """Return the uint8 picture with the masked pixels filled by Telea's fast marching (2004), the paper's choice.

    The bytes are those of OpenCV's `INPAINT_TELEA`, in 0.6 of its time: weights are found once for three colours,
    and a heap holds the front. At the edges, where OpenCV's bytes depend on its version, what lies outside the picture
    is unknown.
    """
    import cv2

    _check(picture, mask)
    masked = mask.astype(np.uint8)
    cross, square = (
        cv2.getStructuringElement(shape, (side, side))
        for shape, side in ((cv2.MORPH_CROSS, 3), (cv2.MORPH_RECT, 2 * radius_px + 1))
    )
    # The rim is known and next to the mask; the ring around it gets the distances that weights compare.
    rim, ring = (np.pad(cv2.dilate(masked, kernel) > masked, radius_px) for kernel in (cross, square))
    waiting = np.pad(mask.astype(bool), radius_px)
    start = np.flatnonzero(rim)
    arrival = np.full(rim.shape, _FAR_PX)
    arrival.flat[start] = 0
    arrival.flat[_march(start, ring & ~rim, arrival)] *= -1
    order = _march(start, waiting, arrival)[len(start) :]
    filled = np.zeros((*rim.shape, 4), np.float32)
    inside = np.s_[radius_px : radius_px + mask.shape[0], radius_px : radius_px + mask.shape[1]]
    filled[(*inside, np.s_[:3])] = picture
    _fill(order, np.pad(mask.astype(bool), radius_px, constant_values=True), arrival, radius_px, filled)
    return filled[(*inside, np.s_[:3])].astype(np.uint8)


@numba.njit(cache=True, error_model="numpy")
def _push(heap, size, key):
    at = size
    while at > 0 and heap[(at - 1) >> 1] > key:
        heap[at] = heap[(at - 1) >> 1]
        at = (at - 1) >> 1
    heap[at] = key


@numba.njit(cache=True, error_model="numpy")
def _pop(heap, size):
    """Return the least of `size` keys, and close the gap."""
    least, last = heap[0], heap[size - 1]
    at, child = 0, 1
    while child < size - 1:
        if child + 1 < size - 1 and heap[child + 1] < heap[child]:
            child += 1
        if heap[child] >= last:
            break
        heap[at] = heap[child]
        at, child = child, 2 * child + 1
    heap[at] = last
    return least


@numba.njit(cache=True, error_model="numpy")
def _march(start, waits, arrival):
    """Fill when a front from `start` arrives at the pixels that wait; return both, in the order that it meets them.

    Pixels are indices into the flat picture, whose margin does not wait. Of two that are met at the same distance, the
    one that was found first comes first.
    """
    width = waits.shape[1]
    waits, distance = waits.copy().ravel(), arrival.ravel()
    bits = distance.view(np.int32)  # of numbers ≥ 0, which they order
    order = np.empty(len(start) + np.count_nonzero(waits), np.int64)
    heap = np.empty(len(order), np.int64)
    found = size = len(start)
    for k in range(found):
        order[k], heap[k] = start[k], k
    while size > 0:
        at = order[_pop(heap, size) & 0xFFFFFFFF]
        size -= 1
        for step in (-width, -1, width, 1):
            to = at + step
            if not waits[to]:
                continue
            # The eikonal equation, first order: what the front has not reached is far away.
            along_y = np.float64(min(distance[to - width], distance[to + width]))
            along_x = np.float64(min(distance[to - 1], distance[to + 1]))
            apart = along_y - along_x
            if abs(apart) >= 1:
                distance[to] = 1 + min(along_y, along_x)
            else:
                distance[to] = (along_y + along_x + np.sqrt(2 - apart * apart)) * 0.5
            waits[to] = False
            order[found] = to
            _push(heap, size, (np.int64(bits[to]) << 32) | found)
            found += 1
            size += 1
    return order[:found]


@numba.njit(cache=True, error_model="numpy", inline="always")
def _slope(before, here, after, knows_before, knows_after):
    if knows_before:
        return (after - before) * np.float32(0.5) if knows_after else here - before
    return after - here if knows_after else np.float32(0)


@numba.njit(cache=True, error_model="numpy")
def _fill(order, unknown, arrival, radius, picture):
    """Fill a (h, w, 4) float32 picture at the pixels of `order`: the fourth value is for vector registers.

    A pixel is the mean of what its known neighbours expect, weighted by their distance, by how alike their times of
    arrival are and by how much they lie along the front's way (Telea 2004, equation 2 and section 2.3). Precision and
    order of sums are OpenCV's. Arrays have a margin of `radius`, which is unknown.
    """
    width = unknown.shape[1]
    zero, small, least, tiny = np.float32(0), np.float32(0.01), np.float32(1e-6), np.float32(1e-20)
    closeness = np.zeros((2 * radius + 1, 2 * radius + 1), np.float32)
    for y in range(-radius, radius + 1):
        for x in range(-radius, radius + 1):
            square = x * x + y * y
            if 0 < square <= radius * radius:
                closeness[y + radius, x + radius] = 1 / (square * np.sqrt(np.float64(square)))
    level, along_x, along_y = np.empty(4, np.float32), np.empty(4, np.float32), np.empty(4, np.float32)
    for at in order:
        j, i = at // width, at % width
        here = arrival[j, i]
        way_x = _slope(
            arrival[j, i - 1], here, arrival[j, i + 1], not unknown[j, i - 1], not unknown[j, i + 1]
        )
        way_y = _slope(
            arrival[j - 1, i], here, arrival[j + 1, i], not unknown[j - 1, i], not unknown[j + 1, i]
        )
        level[:], along_x[:], along_y[:], total = zero, zero, zero, tiny
        for row in range(j - radius, j + radius + 1):
            from_y = np.float32(j - row)
            for column in range(i - radius, i + radius + 1):
                near = closeness[row - j + radius, column - i + radius]
                if unknown[row, column] or near == zero:
                    continue
                from_x = np.float32(i - column)
                alike = np.float32(1 / (1 + np.float64(abs(arrival[row, column] - here))))
                along = from_x * way_x + from_y * way_y
                weight = abs(near * alike * (along if abs(along) > small else least))
                west, east = not unknown[row, column - 1], not unknown[row, column + 1]
                north, south = not unknown[row - 1, column], not unknown[row + 1, column]
                # A slope between two known neighbours counts twice.
                by_x, by_y = from_x * np.float32(west + east), from_y * np.float32(north + south)
                value = picture[row, column]
                x_before, x_after = picture[row, column - west], picture[row, column + east]
                y_before, y_after = picture[row - north, column], picture[row + south, column]
                for k in range(4):
                    level[k] += weight * value[k]
                    along_x[k] -= weight * ((x_after[k] - x_before[k]) * by_x)
                    along_y[k] -= weight * ((y_after[k] - y_before[k]) * by_y)
                total += weight
        for k in range(3):
            x, y = along_x[k], along_y[k]
            change = np.float64(x + y) / (np.sqrt(np.float64(x * x + y * y)) + tiny)
            whole = np.rint(np.float32(level[k] / total + change + 0.5))
            picture[j, i, k] = min(max(whole, zero), np.float32(255))
        unknown[j, i] = False


def _check(picture: np.ndarray, mask: np.ndarray | None = None) -> None:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise ValueError(f"picture must be uint8 (h, w, 3), not {picture.dtype} {picture.shape}")
    if mask is not None and mask.shape != picture.shape[:2]:
        raise ValueError(f"mask has shape {mask.shape}, and the picture asks for {picture.shape[:2]}")
