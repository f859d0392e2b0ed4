"""Two domains as the arrays of skada, the library for domain adaptation in scikit-learn's manner."""

from typing import Literal, get_args

import numpy as np

from gelgap.domains.dataset import LabelledFrames

Axis = Literal["x", "y", "z"]

# The numbers that skada itself gives a single source and a single target; their sign is what counts.
_SOURCE, _TARGET = 1, -2


def to_skada(
    source: LabelledFrames,
    target: LabelledFrames,
    axis: Axis,
    size_px: int | tuple[int, int] = 16,
    mask_target_labels: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return X, y and sample_domain of a source's frames, followed by a target's, for one axis of the force.

    Parameters
    ----------
    source, target
        The domains, or some of their frames.
    axis
        Whose force is the label: skada takes labels of one dimension only.
    size_px
        Size of the reduced pictures: the longer side, or width and height.
    mask_target_labels
        Whether the target's labels are hidden, as training without them needs; to evaluate, they are given.

    Returns
    -------
    X
        (n, height·width·3) float32: each picture less its reference picture, in [−1, 1], pixels row by row.
    y
        (n,) float64, force in N; NaN where masked, by which skada tells regression from classification.
    sample_domain
        (n,) integers, positive for the source and negative for the target.

    Raises
    ------
    ValueError
        If the axis is unknown, or the pictures of the domains are reduced to different sizes.
    """
    if axis not in get_args(Axis):
        raise ValueError(f"axis {axis!r} is unknown; known: {', '.join(get_args(Axis))}")
    sizes = [frames.image_size_px(size_px) for frames in (source, target)]
    if sizes[0] != sizes[1]:
        (w0, h0), (w1, h1) = sizes
        raise ValueError(
            f"pictures of {source.name} and {target.name} become {w0}×{h0} and {w1}×{h1} px with size_px = {size_px}; "
            f"give size_px as width and height"
        )
    forces_n = [frames.values_of((f"f{axis}_n",))[:, 0] for frames in (source, target)]
    if mask_target_labels:
        forces_n[1] = np.full(len(target), np.nan)
    return (
        np.concatenate([_differences(frames, sizes[0]) for frames in (source, target)]),
        np.concatenate(forces_n).astype(np.float64),
        np.repeat([_SOURCE, _TARGET], [len(source), len(target)]),
    )


def _differences(frames: LabelledFrames, size_px: tuple[int, int]) -> np.ndarray:
    """Return every picture less the reference picture, (n, height·width·3) float32 in [−1, 1]."""
    contact, references = frames.images(size_px), frames.references_at(size_px)
    return (
        np.subtract(contact, references[frames.reference_id], dtype=np.float32).reshape(len(frames), -1) / 255
    )
