"""A trained network on a few labelled frames or clips of other data, and what that brings on frames it has not seen."""

import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from torch import nn

from gelgap.adapt.batches import Draw, generator
from gelgap.adapt.evaluation import Evaluation, evaluate, evaluate_constant_mean
from gelgap.adapt.few_labels import fine_tune, labelled_rows
from gelgap.adapt.model import ForceModel
from gelgap.adapt.normalisation import with_statistics_of
from gelgap.domains import QUANTITIES, LabelledFrames, Labels, open_domain, with_labels, within_range

CLIP = "clip"
STEPS = 200
LEARNING_RATE = 4e-3
"""Of a network from elsewhere, whose outputs may be far off: at 0.01 some end as a constant, on few and like frames."""


@dataclass(frozen=True)
class Finetuning:
    """A fine-tuned model, how many frames taught it, and errors on other frames: of their mean, before, and after.

    `left_out` frames have a label that the model's range does not hold.
    """

    model: ForceModel
    frames: int
    left_out: int
    constant_mean: Evaluation
    before: Evaluation
    after: Evaluation

    def __str__(self) -> str:
        known = [QUANTITIES[name] for name in self.model.labels.names]
        columns = " ".join(f"{f'{what.symbol}/{what.unit}':>8}" for what in known)
        errors = {
            f"mean of the {self.frames} labelled frames": self.constant_mean,
            "no label": self.before,
            "fine-tuned": self.after,
        }
        lines = [f"{f'MAE on {self.after.n} other frames':<34} {columns}"]
        for name, error in errors.items():
            lines.append(f"{name:<34} " + " ".join(f"{value:8.4f}" for value in error.mae))
        if self.left_out:
            lines.append(f"left out: {self.left_out} frames with a label outside {self.model.labels}")
        return "\n".join(lines)


def finetune(
    checkpoint: str | Path,
    on: str | Path,
    test: str | Path,
    *,
    frames: int | None = None,
    clips: int | None = None,
    seed: int = 0,
) -> Finetuning:
    """Fine-tune a checkpoint on labelled frames of a data set, and judge it on another, or on the rest of the same.

    The labels are those of the model that both data sets have, in the model's ranges. Frames beyond are left out and
    counted, such as those of a gauge that reads a little above 0 at rest. Batch normalisations get the statistics of
    all pictures of `on`, for which no label is needed, before and after; then all weights take 200 steps.

    Parameters
    ----------
    checkpoint
        A gelgap checkpoint, such as `pretrain` writes.
    on, test
        Folders of data sets; the same folder twice: what is not drawn is tested on.
    frames
        How many frames to draw, as `draw_labelled` does.
    clips
        Or how many clips to draw, by the column `clip`; all their frames are taken.
    seed
        Of the draw and of the training.

    Raises
    ------
    ValueError
        If not exactly one of frames and clips is given, there are fewer, the data sets lack the model's labels, or none
        of the frames to learn or to test on lies within their ranges.
    """
    if (frames is None) == (clips is None):
        raise ValueError(f"frames = {frames}, clips = {clips}: give one of the two")
    labelled: LabelledFrames = open_domain(on)
    others: LabelledFrames = open_domain(test)
    draw = labelled_rows if clips is None else _rows_of_clips
    drawn = draw(labelled, frames or clips or 0, seed)
    if Path(on).resolve() == Path(test).resolve():
        others = others.take(np.setdiff1d(np.arange(len(others)), drawn))
        if not len(others):
            raise ValueError(f"{on}: all of its {len(drawn)} frames are drawn; leave some to test on")
    before = len(drawn) + len(others)
    model = of_common_labels(ForceModel.load(checkpoint), labelled, others)
    few, others = (within_range(with_labels(part, model.labels)) for part in (labelled.take(drawn), others))
    if not (len(few) and len(others)):
        raise ValueError(
            f"{on}, {test}: no labelled, or no other frame lies within the model's {model.labels}"
        )
    left_out = before - len(few) - len(others)
    model = with_statistics_of(model, labelled)
    tuned = fine_tune(model, few, steps=STEPS, learning_rate=LEARNING_RATE, seed=seed)
    return Finetuning(
        model=replace(tuned, target=labelled.name),
        frames=len(few),
        left_out=left_out,
        constant_mean=evaluate_constant_mean(few, others),
        before=evaluate(model, others),
        after=evaluate(tuned, others),
    )


def _rows_of_clips(frames: LabelledFrames, k: int, seed: int) -> np.ndarray:
    """Return the indices of the frames of k clips."""
    if CLIP not in frames.columns:
        raise ValueError(f"clips = {k}: {frames.name} has no column {CLIP!r}; draw single frames instead")
    names = np.unique(frames.columns[CLIP].astype(str))
    if not 1 <= k <= len(names):
        raise ValueError(f"clips = {k} of {frames.name}: must be 1 to {len(names)}")
    chosen = generator(Draw.LABELLED, seed).choice(names, k, replace=False)
    return np.flatnonzero(np.isin(frames.columns[CLIP].astype(str), chosen))


def of_common_labels(model: ForceModel, *data: LabelledFrames) -> ForceModel:
    """Return the model with those of its labels alone that all data sets have."""
    names = model.labels.names
    at = [k for k, name in enumerate(names) if all(name in frames.columns for frames in data)]
    if not at:
        raise ValueError(
            f"the model predicts {', '.join(names)}, none of which both {data[0].name} and {data[1].name} have"
        )
    if len(at) == len(names):
        return model
    network = copy.deepcopy(model.network)
    layer = network.regressor[0]
    fewer = nn.Linear(layer.in_features, len(at)).to(layer.weight.device)
    fewer.weight.data, fewer.bias.data = layer.weight.data[at].clone(), layer.bias.data[at].clone()
    network.regressor[0], network.n_labels = fewer, len(at)
    labels = Labels(tuple(names[k] for k in at), tuple(model.labels.ranges[k] for k in at))
    return replace(model, network=network, labels=labels)
