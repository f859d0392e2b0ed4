"""What a network is shown of pictures, an entry of `INPUTS` each: every method can be trained on any of them.

Most are a linear map of the colours of the difference to the reference picture, found for each domain from its training
pictures, without labels. The calibrated input assumes that the indenter leaves round dents: the mean colour of the wall
that faces +x, less that of the opposite one, is the domain's response to a slope along x.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import FiniteFloat

if TYPE_CHECKING:
    from torch import Tensor

    from gelgap.assets.pinhole import Pinhole
    from gelgap.data import LabelledFrames
    from gelgap.data.frames.marker_motion import MarkerTracker, ThinPlate
    from gelgap.data.frames.paired_frames import PairedFrames

LOG = logging.getLogger(__name__)
_BATCH = 256
# A channel that does not vary, as that of a picture without contact, is not blown up.
_LEAST_STD = 1e-3
# Of the largest singular value: directions of colour that hardly respond to a slope are not blown up to noise.
_LEAST_RESPONSE = 0.1
# A difference below this share of the range is noise; above it a pixel belongs to the dent.
_LEAST_DIFFERENCE = 0.02
_MOST_LOST = 0.5


class InputMap(NamedTuple):
    """A linear map of the channels of one domain's inputs: matrix (c, C) and offset (c,)."""

    matrix: tuple[tuple[FiniteFloat, ...], ...]
    offset: tuple[FiniteFloat, ...]

    def __call__(self, inputs: "Tensor") -> "Tensor":
        """Return mapped inputs (B, c, h, w) of inputs (B, C, h, w), channels last in memory."""
        return mapped(inputs, *map(inputs.new_tensor, self))

    @classmethod
    def of(cls, matrix: np.ndarray, offset: np.ndarray | None = None) -> "InputMap":
        offset = np.zeros(len(matrix)) if offset is None else offset
        return cls(tuple(map(tuple, matrix.tolist())), tuple(offset.tolist()))


def mapped(inputs: "Tensor", matrix: "Tensor", offset: "Tensor") -> "Tensor":
    """Return inputs (B, c, h, w) of (B, C, h, w), by one matrix (c, C) and offset (c,) or by one for each of B."""
    pixels = inputs.permute(0, 2, 3, 1).flatten(1, 2) @ matrix.mT + offset[..., None, :]
    return pixels.unflatten(1, inputs.shape[2:]).permute(0, 3, 1, 2)


Fit = Callable[["PairedFrames"], InputMap]
"""Finds the map of a domain from its pictures."""
Find = Callable[["LabelledFrames", tuple[int, int], tuple[float, float]], np.ndarray]
"""Gives what is shown of frames, (n, h, w, channels), for a size in px and a span in mm."""


@dataclass(frozen=True)
class Input:
    """One way to show pictures: what it is, and the map of a domain, from its pictures (None: as they are paired).

    It may have another number of channels than paired pictures, need their difference, or keep the weights (not the
    statistics) of the backbone from which training starts. `find` gives what is shown instead of colours. If it is
    `from_touch`, frames need their trajectory, and turn.
    """

    about: str
    fit: "Fit | None" = None
    channels: int | None = None
    needs_difference: bool = False
    find: "Find | None" = None
    from_touch: bool = False
    frozen: bool = False


def standardisation(pictures: "PairedFrames") -> InputMap:
    """Return the map that gives every channel mean 0 and deviation 1 over the pictures."""
    import torch

    total = squares = torch.zeros((), dtype=torch.float64)
    for rows in torch.arange(len(pictures)).split(_BATCH):
        colour = pictures.inputs(rows).double()
        total = total + colour.sum(dim=(0, 2, 3))
        squares = squares + colour.square().sum(dim=(0, 2, 3))
    n = len(pictures) * colour[0, 0].numel()
    mean = (total / n).cpu().numpy()
    std = np.sqrt(np.maximum((squares / n).cpu().numpy() - mean**2, _LEAST_STD**2))
    return InputMap.of(np.diag(1 / std), -mean / std)


def grey(pictures: "PairedFrames") -> InputMap:
    """Return the mean of the three channels."""
    return InputMap.of(np.full((1, 3), 1 / 3))


def calibration(pictures: "PairedFrames") -> InputMap:
    """Return the map from colour differences to slope along x, slope along y, and what all walls of a dent share.

    The response A (colours × 3) is the mean of the difference times (x, y, ρ)/ρ over the pixels of all dents; x, y are
    from a dent's centre, ρ is its mean radius. The map is the inverse of A, in which singular values below a tenth of
    the largest are raised to it, scaled so that each of its channels has deviation 1 over the pictures.

    Raises a ValueError if no picture shows a dent.
    """
    import torch

    response = np.zeros((3, 3))
    covariance = np.zeros((3, 3))
    weight = 0.0
    for rows in torch.arange(len(pictures)).split(_BATCH):
        colour = pictures.inputs(rows)
        strength = colour.abs().mean(dim=1)
        # Differences are four times those of pictures in [0, 1].
        strength = (strength * (strength > 4 * _LEAST_DIFFERENCE)).double()
        total = strength.sum(dim=(1, 2)).clamp_min(1e-12)[:, None, None]
        y, x = (torch.arange(n, device=colour.device, dtype=torch.float64) for n in colour.shape[2:])
        dx = x[None, None, :] - (strength * x[None, None, :] / total).sum(dim=(1, 2), keepdim=True)
        dy = y[None, :, None] - (strength * y[None, :, None] / total).sum(dim=(1, 2), keepdim=True)
        radius = (strength * torch.hypot(dx, dy) / total).sum(dim=(1, 2), keepdim=True).clamp_min(1e-12)
        inside = (strength > 0).double() * (torch.hypot(dx, dy) < 2 * radius)
        walls = dx / radius, dy / radius, torch.ones_like(strength)
        shape = torch.stack(torch.broadcast_tensors(*walls), dim=1)
        response += torch.einsum("nchw,nkhw,nhw->ck", colour.double(), shape, inside).cpu().numpy()
        covariance += torch.einsum("nchw,nkhw->ck", colour.double(), colour.double()).cpu().numpy()
        weight += float(inside.sum())
    if weight == 0:
        raise ValueError("no picture shows a dent, by which its colours could be calibrated")
    u, values, v = np.linalg.svd(response / weight)
    matrix = v.T / np.maximum(values, _LEAST_RESPONSE * values[0]) @ u.T
    variance = np.einsum("ic,cd,id->i", matrix, covariance, matrix) / (len(pictures) * colour[0, 0].numel())
    return InputMap.of(matrix / np.sqrt(variance)[:, None])


def displacement_fields(
    frames: "LabelledFrames", size_px: tuple[int, int], span_mm: tuple[float, float]
) -> np.ndarray:
    """Return how far the membrane has moved along x and y, (n, h, w, 2) in mm, float16: to 0.2 µm of 0.5 mm.

    Markers are found and matched in the stored pictures and interpolated on a grid of the gel, which is the same for
    every sensor, whatever its pattern, camera and light (`gelgap.data.frames.marker_motion`).

    Raises what `rest_markers` does, and a ValueError if most pictures show other markers.
    """
    fields = np.zeros((len(frames), size_px[1], size_px[0], 2), np.float16)
    unmatched = []
    for number, (tracker, plate) in rest_markers(frames, size_px, span_mm):
        for row in np.flatnonzero(frames.reference_id == number):
            moved_mm = tracker.displacement_mm(frames.picture(int(row)))
            if np.isnan(moved_mm[:, 0]).mean() > _MOST_LOST:
                unmatched.append(int(row))
            fields[row] = plate(moved_mm)
    if unmatched:
        told = (
            f"input markers: {frames.name}: in {len(unmatched)} of {len(frames)} pictures most markers of the "
            f"reference are not found again; first: frame {min(unmatched)}"
        )
        if 2 * len(unmatched) > len(frames):
            raise ValueError(f"{told}; is it a reference of this sensor?")
        LOG.warning(told)
    return fields


def rest_markers(
    frames: "LabelledFrames", size_px: tuple[int, int], span_mm: tuple[float, float]
) -> "Iterator[tuple[int, tuple[MarkerTracker, ThinPlate]]]":
    """Yield the number of each reference that frames have, and what follows its markers.

    Raises a ValueError if mm per pixel are not known, or a reference shows no markers.
    """
    for number in np.unique(frames.reference_id).tolist():
        if (camera := frames.cameras[number]) is None:
            raise ValueError(
                f"input markers: mm per pixel of {frames.name} are not known; put a sensor.toml beside its pictures, a "
                "sensor's own or with the line mm_per_px = 0.05"
            )
        reference = frames.rest_pictures[number]()
        try:
            yield number, _rest(reference.tobytes(), reference.shape, camera, size_px, span_mm)
        except ValueError as error:
            raise ValueError(f"input markers: {frames.name}: {error}; choose another input") from None


def dents(frames: "LabelledFrames", size_px: tuple[int, int], span_mm: tuple[float, float]) -> np.ndarray:
    """Return dents and their edges around the place of first touch, (n, h, w, 2) float16 (`dents_from_touch`)."""
    from gelgap.data.frames.first_touch import dents_from_touch

    return dents_from_touch(frames, size_px)


@lru_cache(maxsize=16)
def _rest(
    reference: bytes,
    shape: tuple[int, int, int],
    camera: "Pinhole",
    size_px: tuple[int, int],
    span_mm: tuple[float, float],
) -> "tuple[MarkerTracker, ThinPlate]":
    """Return what is made once for a reference, also where pictures come one by one."""
    from gelgap.data.frames.marker_motion import MarkerTracker, ThinPlate

    tracker = MarkerTracker(np.frombuffer(reference, np.uint8).reshape(shape), camera)
    return tracker, ThinPlate(tracker.rest_mm, size_px, span_mm)


INPUTS = {
    "pictures": Input("the picture and its reference as the profile pairs them"),
    "calibrated": Input("colours as slopes, by one matrix a domain", calibration, needs_difference=True),
    "standardised": Input("each channel standardised by its domain's pictures", standardisation),
    "grey": Input("the mean of the colours", grey, 1, needs_difference=True),
    "markers": Input("how far markers have moved", None, 2, needs_difference=True, find=displacement_fields),
    "touch": Input(
        "dents around the place of first touch", None, 2, needs_difference=True, find=dents, from_touch=True
    ),
    "pretrained": Input("features of a pretrained network (--weights), whose weights stay", frozen=True),
}
"""What a network can be shown."""
FITTED = ("calibrated", "standardised")
FEW_TO_FIT = 8
"""Inputs whose map depends on a domain's pictures, and how many give one that fits (docs/adaptation.md)."""


class Found:
    """What is found in the stored pictures of frames and shown instead of their colours, (n, c, h, w).

    `find` says what it can refuse: for markers in mm (`displacement_fields`), for dents their trajectory.
    """

    def __init__(
        self,
        find: Find,
        frames: "LabelledFrames",
        size_px: tuple[int, int],
        span_mm: tuple[float, float],
        device: object,
    ) -> None:
        import torch

        kept = _FIELDS.setdefault(frames, {})
        key = find, size_px, span_mm
        if key not in kept:
            kept[key] = find(frames, size_px, span_mm)
        self._fields = torch.from_numpy(kept[key]).to(device)

    def inputs(self, rows: "np.ndarray | Tensor") -> "Tensor":
        """Return what is shown of these frames, (B, c, h, w)."""
        return self._fields[rows].float().permute(0, 3, 1, 2)

    def __len__(self) -> int:
        return len(self._fields)


# Every stage and evaluation of a run asks for them.
_FIELDS: "WeakKeyDictionary[LabelledFrames, dict[object, np.ndarray]]" = WeakKeyDictionary()
