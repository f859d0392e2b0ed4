"""A few labelled frames of the target: which ones, and a model fine-tuned on them or corrected by them.

Frames must come from the target's training part; its test frames stay for judging.
"""

import copy
from dataclasses import replace

import numpy as np
import torch
from torch.nn import functional

from gelgap.adapt.batches import Draw, generator, network_inputs, normalised_labels
from gelgap.adapt.loop import TrainingDiverged
from gelgap.adapt.machine import autocast, torch_threads
from gelgap.adapt.model import AffineCorrection, ForceModel
from gelgap.domains import LabelledFrames

STEPS = 100
"""Steps of fine-tuning, whatever the number of frames."""
LEARNING_RATE = 1e-2
"""Of all weights, with momentum 0.9; at 0.002 one label does less harm, but 20 and more leave larger errors."""
_BATCH = 32
_MOMENTUM = 0.9
# Of the ridge: the weakest leaves an exact relation as it is, the strongest leaves the predictions.
_PENALTIES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 1e3)


def draw_labelled(frames: LabelledFrames, k: int, seed: int) -> LabelledFrames:
    """Return k frames drawn by the seed, one from each of k equal ranges of the commanded depth.

    Whoever records a few labelled frames chooses their depths, not their forces. A data set without the column
    `depth_mm` has its frames drawn at random.

    Raises
    ------
    ValueError
        If there are fewer than k frames, or k < 1.
    """
    return frames.take(labelled_rows(frames, k, seed))


def labelled_rows(frames: LabelledFrames, k: int, seed: int) -> np.ndarray:
    """Return the indices (k,) of the frames of `draw_labelled`."""
    n = len(frames)
    if not 1 <= k <= n:
        raise ValueError(f"k = {k} labelled frames of {frames.name}: must be 1 to {n}")
    rng = generator(Draw.LABELLED, seed)
    order = rng.permutation(n)
    depth_mm = frames.columns.get("depth_mm")
    if depth_mm is not None:
        order = order[np.argsort(np.nan_to_num(depth_mm[order]), kind="stable")]
    return np.array([rng.choice(part) for part in np.array_split(order, k)])


def fine_tune(
    model: ForceModel,
    frames: LabelledFrames,
    *,
    steps: int = STEPS,
    learning_rate: float = LEARNING_RATE,
    seed: int | None = None,
) -> ForceModel:
    """Return a copy of a model whose weights are trained on labelled frames of the domain it is for.

    SGD on the squared error of all labels, 100 steps of at most 32 frames at a constant rate of 0.01, the same for
    any number of frames and any adapted model. The batch normalisations keep their statistics, so that a single frame
    is enough. Seed: the model's unless given.

    Raises
    ------
    ValueError
        If there are no frames, a label is outside the model's range, or the model has an affine correction.
    TrainingDiverged
        If the loss is no longer finite.
    """
    _check(model, frames)
    if model.correction is not None:
        raise ValueError(
            "a model with an affine correction cannot be fine-tuned: fine-tune first, then correct"
        )
    network = copy.deepcopy(model.network).eval()
    pictures = network_inputs(frames, model.profile, model.device, model.input_statistics)
    force = torch.from_numpy(normalised_labels(frames)).to(model.device)
    optimizer = torch.optim.SGD(network.parameters(), learning_rate, _MOMENTUM)
    rng = generator(Draw.FINE_TUNING, model.seed if seed is None else seed)
    with torch_threads(model.profile.threads):
        for _ in range(steps):
            rows = torch.from_numpy(rng.permutation(len(frames))[:_BATCH]).to(model.device)
            with autocast(model.profile, model.device):
                features = network.features(pictures.inputs(rows))
            loss = functional.mse_loss(network.regressor(features.float()), force[rows])
            if not torch.isfinite(loss):
                raise TrainingDiverged("fine-tuning: the loss is not finite; lower the learning rate")
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
    return replace(model, network=network)


def affine_correction(model: ForceModel, frames: LabelledFrames) -> ForceModel:
    """Return the model with each label of its predictions corrected, F' = a·F + b, by labelled frames of its domain.

    a and b are a ridge regression's that draws them to 1 and 0. One penalty serves all labels: the strongest whose
    leave-one-out error on the frames is within a standard error of the least (Breiman's rule), so that few labels
    change little unless they agree. A single frame gives b alone, half its error.

    Raises
    ------
    ValueError
        If there are no frames, or a label is outside the model's range.
    """
    _check(model, frames)
    predicted = model.predict(frames)
    scale = (model.labels.high - model.labels.low) / 2
    # Over the range's half-width: then both columns of the regression, and all labels, are of one size.
    columns = np.stack([predicted / scale, np.ones_like(predicted)], axis=2)
    error = (frames.label_values - predicted) / scale
    if len(frames) == 1:
        change = np.stack([np.zeros(len(scale)), error[0] / 2], axis=1)
    else:
        change = _ridge(columns, error, _penalty(columns, error))
    correction = AffineCorrection(tuple((1 + change[:, 0]).tolist()), tuple((change[:, 1] * scale).tolist()))
    return replace(
        model, correction=correction if model.correction is None else correction.after(model.correction)
    )


def _ridge(columns: np.ndarray, error: np.ndarray, penalty: float) -> np.ndarray:
    """Return the coefficients (l, 2) of the labels, from columns (k, l, 2) and errors (k, l)."""
    gram = np.einsum("kai,kaj->aij", columns, columns) + penalty * np.eye(2)
    return np.linalg.solve(gram, np.einsum("kai,ka->ai", columns, error)[..., None])[..., 0]


def _penalty(columns: np.ndarray, error: np.ndarray) -> float:
    """Return the strongest penalty whose leave-one-out error is within a standard error of the least."""
    others = ~np.eye(len(error), dtype=bool)
    left_out = np.empty((len(_PENALTIES), len(error)))
    for i, penalty in enumerate(_PENALTIES):
        for k, rest in enumerate(others):
            change = _ridge(columns[rest], error[rest], penalty)
            left_out[i, k] = np.square(error[k] - (columns[k] * change).sum(axis=1)).sum()
    mean = left_out.mean(axis=1)
    best = mean.argmin()
    allowed = mean[best] + left_out[best].std(ddof=1) / np.sqrt(len(error))
    return max(penalty for penalty, value in zip(_PENALTIES, mean, strict=True) if value <= allowed)


def _check(model: ForceModel, frames: LabelledFrames) -> None:
    if len(frames) == 0:
        raise ValueError(f"there are no labelled frames of {frames.name}; at least 1 is needed")
    if frames.labels != model.labels:
        raise ValueError(
            f"{frames.name} has the labels {frames.labels}, the model {model.labels}; they must have one range: "
            "with_labels(frames, model.labels) gives the frames the model's"
        )
    frames.check_labels()
