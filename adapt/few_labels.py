"""Labels from elsewhere: networks pretrained on many domains, and a few labelled frames that correct or fine-tune one.

Labelled frames must come from the target's training part; its test frames stay for judging.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from gelgap.adapt.data import Draw, generator, has_other_aspect, network_inputs, normalised_labels
from gelgap.adapt.evaluation import Evaluation, errors_text, evaluate, evaluate_constant_mean
from gelgap.adapt.inputs import FITTED, INPUTS
from gelgap.adapt.methods.base import TrainingDiverged
from gelgap.adapt.model import AffineCorrection, ForceModel, with_statistics_of
from gelgap.adapt.network import autocast, torch_threads
from gelgap.adapt.profile import Profile
from gelgap.adapt.runs import Stage1, stage1_key
from gelgap.adapt.trainer import train_source
from gelgap.assets.checksums import sha256
from gelgap.assets.progress import Progress, hidden_progress
from gelgap.assets.settings import Settings
from gelgap.data import LabelledFrames, Labels, join_domains, open_domain, with_labels
from gelgap.data.frames.dataset import labelled_frames
from gelgap.data.frames.run_labels import within_range
from gelgap.data.inspection import log_notes

STEPS = 100
"""Steps of fine-tuning to a target, whatever the number of frames."""
LEARNING_RATE = 1e-2
"""Of all weights, with momentum 0.9; at 0.002 one label does less harm, but 20 and more leave larger errors."""
NEW_SENSOR_STEPS = 200
NEW_SENSOR_LEARNING_RATE = 4e-3
"""Of a network from elsewhere, whose outputs may be far off: at 0.01 some end as a constant, on few and like frames."""
CLIP = "clip"
CHECKPOINT = "pretrained.pt"
_BATCH = 32
_MOMENTUM = 0.9
# Of the ridge: the weakest leaves an exact relation as it is, the strongest leaves the predictions.
_PENALTIES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 1e3)
# Labels that span less of the network's range than this are too small for it to tell well.
_NARROW = 0.05
# The last of the domains are kept for judging: one in this many.
_HELD_OUT_OF = 10
# Of a stream, samples from this one on: further than any training comes.
_UNSEEN_FROM = 10**9


def draw_labelled(frames: LabelledFrames, k: int, seed: int) -> LabelledFrames:
    """Return k frames drawn by the seed, one from each of k equal ranges of the commanded depth.

    Whoever records a few labelled frames chooses their depths, not their forces. A data set without the column
    `depth_mm` has its frames drawn at random. Frames without labels are not drawn.

    Raises
    ------
    ValueError
        If there are fewer than k frames with labels, or k < 1.
    """
    frames = labelled_frames(frames)
    return frames.take(_rows_by_depth(frames, k, seed))


def _rows_by_depth(frames: LabelledFrames, k: int, seed: int) -> np.ndarray:
    n = len(frames)
    if not 1 <= k <= n:
        raise ValueError(f"k = {k} labelled frames of {frames.name}: must be 1 to {n}")
    rng = generator(Draw.LABELLED, seed)
    order = rng.permutation(n)
    depth_mm = frames.columns.get("depth_mm")
    if depth_mm is not None:
        order = order[np.argsort(np.nan_to_num(depth_mm[order]), kind="stable")]
    return np.array([rng.choice(part) for part in np.array_split(order, k)])


def _rows_of_clips(frames: LabelledFrames, k: int, seed: int) -> np.ndarray:
    if CLIP not in frames.columns:
        raise ValueError(f"clips = {k}: {frames.name} has no column {CLIP!r}; draw single frames instead")
    clips = frames.columns[CLIP].astype(str)
    names = np.unique(clips)
    if not 1 <= k <= len(names):
        raise ValueError(f"clips = {k} of {frames.name}: must be 1 to {len(names)}")
    return np.flatnonzero(np.isin(clips, generator(Draw.LABELLED, seed).choice(names, k, replace=False)))


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
        If there are no frames, a label is outside the model's range, the model has an affine correction or
        is of sequences or of dents from first touch.
    TrainingDiverged
        If the loss is no longer finite.
    """
    _check(model, frames)
    if model.correction is not None:
        raise ValueError("a model with an affine correction cannot be fine-tuned: fine-tune, then correct")
    if model.profile.sequence_length > 1:
        raise ValueError("sequence models cannot be fine-tuned: correct them, by whole trajectories")
    network = copy.deepcopy(model.network).eval()
    pictures = network_inputs(frames, model.profile, model.device, model.own_map)
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
        If there are no frames, a label is outside the model's range, or the model is of dents from first touch.
    """
    _check(model, frames)
    predicted = replace(model, input_map=model.own_map).predict_frames(frames)
    scale = (model.labels.high - model.labels.low) / 2
    # Over the range's half-width: then both columns of the regression, and all labels, are of one size.
    columns = np.stack([predicted / scale, np.ones_like(predicted)], axis=2)
    error = (frames.label_values - predicted) / scale
    if len(frames) == 1:
        change = np.stack([np.zeros(len(scale)), error[0] / 2], axis=1)
    else:
        change = _ridge_of_one_penalty(columns, error)
    gain = 1 + change[:, 0]
    offset = change[:, 1] * scale
    return model.corrected(AffineCorrection(tuple(gain.tolist()), tuple(offset.tolist())))


def _ridge_of_one_penalty(columns: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the coefficients (l, 2) of the labels, from columns (k, l, 2) and errors (k, l)."""
    from sklearn.linear_model import Ridge, RidgeCV

    labels = list(zip(columns.swapaxes(0, 1), error.T, strict=True))
    every = RidgeCV(_PENALTIES, fit_intercept=False, store_cv_results=True)
    left_out = np.sum([every.fit(*of_label).cv_results_ for of_label in labels], axis=0)
    mean = left_out.mean(axis=0)
    best = mean.argmin()
    allowed = mean[best] + left_out[:, best].std(ddof=1) / np.sqrt(len(error))
    ridge = Ridge(max(np.array(_PENALTIES)[mean <= allowed]), fit_intercept=False)
    return np.stack([ridge.fit(*of_label).coef_ for of_label in labels])


def _check(model: ForceModel, frames: LabelledFrames) -> None:
    if len(frames) == 0:
        raise ValueError(f"there are no labelled frames of {frames.name}; at least 1 is needed")
    if INPUTS[model.profile.input].from_touch:
        raise ValueError(
            f"input {model.profile.input}: few labelled frames lack their first touch, so that such a model is neither "
            "fine-tuned nor corrected by them; a ratio of moduli scales it (with_modulus_ratio)"
        )
    if frames.labels != model.labels:
        raise ValueError(
            f"{frames.name} has the labels {frames.labels}, the model {model.labels}; they must have one range: "
            "with_labels(frames, model.labels) gives the frames the model's"
        )
    frames.check_labels()


@dataclass(frozen=True)
class Pretraining:
    """A pretrained network: its checkpoint, the frames that it has learnt from, and its error on unseen domains.

    `left_out` frames have a force outside the declared range.
    """

    checkpoint: Path
    frames: int
    left_out: int
    held_out: Evaluation
    held_out_constant_mean: Evaluation

    def __str__(self) -> str:
        errors = {
            "constant mean, unseen domains": self.held_out_constant_mean,
            "pretrained, unseen domains": self.held_out,
        }
        lines = [f"{self.checkpoint}: trained on {self.frames} frames", errors_text(errors)]
        if self.left_out:
            lines.append(f"{self.left_out} frames without a force in the declared range were left out")
        if self.held_out.mean_mae_percent >= self.held_out_constant_mean.mean_mae_percent:
            lines.append(
                "the network is no better than the constant mean: it has learnt nothing that carries over; give it "
                "more domains, frames or epochs"
            )
        return "\n".join(lines)


def pretrain(
    folders: Sequence[str | Path],
    out_dir: str | Path,
    profile: str | Profile = "cpu",
    seed: int = 0,
    *,
    progress: Progress = hidden_progress,
) -> Pretraining:
    """Train stage 1 on many domains, and judge it on the last tenth of them, which it does not see.

    The checkpoint `pretrained.pt` in `out_dir` is one that `adapt_folders` takes as `weights`. An interrupted training
    is resumed from its last epoch, a finished one is not repeated.

    Raises
    ------
    ValueError
        If there are fewer than two domains, the profile is unknown, or domains do not fit together.
    RuntimeError
        If another process is training it.
    """
    profile = Profile.named(profile)
    if len(folders) < 2:
        raise ValueError(f"{len(folders)} domains: pretraining needs 2 or more, the last to judge by")
    domains = [open_domain(folder) for folder in folders]
    log_notes(domains)
    within = [within_range(domain) for domain in domains]
    held_out = max(1, len(domains) // _HELD_OUT_OF)
    seen = join_domains(within[:-held_out])
    unseen = join_domains(within[-held_out:])
    model, _ = Stage1(seen, profile, seed, out=Path(out_dir), progress=progress).model()
    left_out = sum(map(len, domains)) - sum(map(len, within))
    return _pretrained(model, Path(out_dir), len(seen), left_out, seen, unseen)


class FrameStream(Protocol):
    """Frames that are made when they are asked for, the same for the same numbers, as a `gelgap.domains.PressStream`.

    `ranges` is all that they are drawn from.
    """

    @property
    def ranges(self) -> Settings: ...

    def frames(self, start: int, stop: int) -> LabelledFrames:
        """Return those of samples start…stop whose force lies within its range."""


def pretrain_on_stream(
    stream: FrameStream,
    out_dir: str | Path,
    profile: str | Profile = "cpu",
    seed: int = 0,
    *,
    frames_per_epoch: int = 3600,
    progress: Progress = hidden_progress,
) -> Pretraining:
    """Train stage 1 on a stream, every epoch on samples that it has not seen, and judge it on others of other lights.

    Nothing is stored but the checkpoint, as that of `pretrain`, and the state after each epoch, from which an
    interrupted training is resumed. Another stream, profile or seed has a state of its own.

    Raises
    ------
    ValueError
        If the profile is unknown or needs many pictures of each light, or no force of an epoch is within its range.
    """
    profile = Profile.named(profile)
    if profile.input in FITTED:
        raise ValueError(f"input {profile.input}: a stream has few pictures of each light; choose another")
    out_dir = Path(out_dir)
    n = frames_per_epoch
    out_dir.mkdir(parents=True, exist_ok=True)

    def frames_of_epoch(epoch: int) -> LabelledFrames:
        return stream.frames(epoch * n, (epoch + 1) * n)

    first = frames_of_epoch(0)
    # The first frames do not have all presses.
    key = sha256(f"{stage1_key(first, profile, seed)} {stream.ranges.model_dump_json()}".encode())
    resume_file = out_dir / f"stream-state-{key[:8]}.pt"
    model = train_source(
        first, profile, seed, resume_file=resume_file, progress=progress, frames_of_epoch=frames_of_epoch
    )
    unseen = stream.frames(_UNSEEN_FROM, _UNSEEN_FROM + max(n // _HELD_OUT_OF, 1))
    return _pretrained(model, out_dir, n * profile.source_epochs, n - len(first), first, unseen)


def _pretrained(
    model: ForceModel, folder: Path, frames: int, left_out: int, seen: LabelledFrames, unseen: LabelledFrames
) -> Pretraining:
    """Write the checkpoint and judge the model on domains that it has not seen."""
    model.save(folder / CHECKPOINT)
    constant_mean = evaluate_constant_mean(seen, unseen)
    return Pretraining(folder / CHECKPOINT, frames, left_out, evaluate(model, unseen), constant_mean)


@dataclass(frozen=True)
class Finetuning:
    """A fine-tuned model, how many frames taught it, and errors on other frames: of their mean, before, and after.

    `left_out` frames have a label that the model's range does not hold, `unlabelled` ones lack a label; `range_used` is
    the share of each label's range that the labels of the others span.
    """

    model: ForceModel
    frames: int
    left_out: int
    unlabelled: int
    constant_mean: Evaluation
    before: Evaluation
    after: Evaluation
    range_used: tuple[float, ...]

    def __str__(self) -> str:
        errors = {
            f"mean of the {self.frames} labelled frames": self.constant_mean,
            "no label": self.before,
            "fine-tuned": self.after,
        }
        lines = [f"errors on {self.after.n} other frames", errors_text(errors)]
        if self.left_out:
            lines.append(f"left out: {self.left_out} frames with a label outside {self.model.labels}")
        if self.unlabelled:
            lines.append(f"neither drawn nor tested on: {self.unlabelled} frames without labels")
        if narrow := [
            f"{quantity.symbol} {100 * share:.2g} %"
            for quantity, share in zip(self.model.labels.quantities, self.range_used, strict=True)
            if share < _NARROW
        ]:
            lines.append(
                f"labels fill little of the network's ranges ({', '.join(narrow)} of {self.model.labels}), and its "
                "errors are a share of those: train one whose ranges are like these labels'"
            )
        if self.after.mean_mae_percent >= self.constant_mean.mean_mae_percent:
            lines.append("fine-tuning is no better than the mean of the labelled frames: use that, or more")
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
    counted, such as those of a gauge that reads a little above 0 at rest, and so are frames without labels. Batch
    normalisations get the statistics of all pictures of `on`, labelled or not, before and after; then all weights take
    200 steps.

    Parameters
    ----------
    checkpoint
        A gelgap checkpoint, such as `pretrain` writes.
    on, test
        Folders of data sets; the same folder twice: what is not drawn is tested on.
    frames
        How many frames to draw, as `draw_labelled` does.
    clips
        Or how many clips with labels to draw, by the column `clip`; all their frames with labels are taken.
    seed
        Of the draw and of the training.

    Raises
    ------
    ValueError
        If not exactly one of frames and clips is given, there are fewer, the data sets lack the model's labels, or none
        of the frames to learn or to test on lies within their ranges.
    """
    if (frames is None) == (clips is None):
        raise ValueError(
            f"frames = {frames}, clips = {clips}: give one of the two, how many labelled frames or clips are learnt"
        )
    shown, tested = open_domain(on), open_domain(test)
    is_same = Path(on).resolve() == Path(test).resolve()
    model = of_common_labels(ForceModel.load(checkpoint), shown, tested)
    squeezed = [one for one in (shown, tested) if has_other_aspect(one.size_px, model.size_px)]
    notes = [f"{one.name} has another aspect than the model: it is squeezed" for one in squeezed]
    log_notes((shown, tested), notes)
    labelled = labelled_frames(with_labels(shown, model.labels))
    others = labelled_frames(with_labels(tested, model.labels))
    unlabelled = len(shown) - len(labelled) + (0 if is_same else len(tested) - len(others))
    if frames is not None:
        drawn = _rows_by_depth(labelled, frames, seed)
    elif clips is not None:
        drawn = _rows_of_clips(labelled, clips, seed)
    if is_same:
        others = labelled.take(np.setdiff1d(np.arange(len(labelled)), drawn))
        if not len(others):
            raise ValueError(f"{on}: all of its {len(drawn)} frames are drawn; leave some to test on")
    before = len(drawn) + len(others)
    few = within_range(labelled.take(drawn))
    others = within_range(others)
    beyond = f"lies within the ranges that the model was trained in, {model.labels}"
    if not len(few):
        raise ValueError(f"{on}: none of the {len(drawn)} drawn frames {beyond}")
    if not len(others):
        raise ValueError(f"{test}: none of the others {beyond}")
    model = with_statistics_of(model, shown)
    tuned = fine_tune(model, few, steps=NEW_SENSOR_STEPS, learning_rate=NEW_SENSOR_LEARNING_RATE, seed=seed)
    return Finetuning(
        model=replace(tuned, target=shown.name),
        frames=len(few),
        left_out=before - len(few) - len(others),
        unlabelled=unlabelled,
        constant_mean=evaluate_constant_mean(few, others),
        before=evaluate(model, others),
        after=evaluate(tuned, others),
        range_used=tuple(
            (np.ptp(others.label_values, axis=0) / (tuned.labels.high - tuned.labels.low)).tolist()
        ),
    )


def of_common_labels(model: ForceModel, *data: LabelledFrames) -> ForceModel:
    """Return the model with those of its labels alone that all data sets have."""
    names = model.labels.names
    at = [k for k, name in enumerate(names) if all(name in frames.known_labels for frames in data)]
    if not at:
        raise ValueError(
            f"the model predicts {', '.join(names)}, none of which both {data[0].name} and {data[1].name} have"
        )
    if len(at) == len(names):
        return model
    network = copy.deepcopy(model.network)
    head = network.regressor[0]
    head.weight = nn.Parameter(head.weight.detach()[at])
    head.bias = nn.Parameter(head.bias.detach()[at])
    head.out_features = network.n_labels = len(at)
    labels = Labels.of({names[k]: model.labels.ranges[k] for k in at})
    return replace(model, network=network, labels=labels)
