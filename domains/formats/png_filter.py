"""The filter of a PNG's rows: each byte less the average of those to its left and above it."""

import numba
import numpy as np

_AVERAGE = 3  # the filter's number (PNG, W3C Recommendation, 3rd edition, 9.2)


def less_average(picture: np.ndarray) -> np.ndarray:
    """Return the filtered bytes (h, 1 + bytes per row) of a picture (h, w, ...): each row after its filter's number."""
    height, width = picture.shape[:2]
    big_endian = np.ascontiguousarray(picture, picture.dtype.newbyteorder(">"))
    rows = big_endian.reshape(height, -1).view(np.uint8)
    filtered = np.empty((height, 1 + rows.shape[1]), np.uint8)
    _less_average(rows, rows.shape[1] // width, filtered)
    return filtered


@numba.njit(cache=True)
def _row_less_average(row, left, above, out):
    for i in range(len(out)):
        # The average of two bytes, rounded down, without a wider type.
        average = np.uint8((left[i] & above[i]) + ((left[i] ^ above[i]) >> np.uint8(1)))
        out[i] = np.uint8(row[i] - average)


@numba.njit(cache=True)
def _less_average(rows, step, filtered):
    nothing = np.zeros(rows.shape[1], np.uint8)
    for j in range(len(rows)):
        row, above, out = rows[j], rows[j - 1] if j > 0 else nothing, filtered[j, 1:]
        filtered[j, 0] = _AVERAGE
        _row_less_average(row[:step], nothing[:step], above[:step], out[:step])
        _row_less_average(row[step:], row[:-step], above[step:], out[step:])
