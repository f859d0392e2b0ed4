"""Training: stage 1 learns the source's forces, stage 2 goes on while a method adapts the network to the target.

Both stages are one loop, `train`, which can be resumed after each epoch. What tells methods apart is the loss that they
add to a step.
"""

import copy
import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gelgap.adapt.data import (
    Batch,
    Draw,
    TrainingDomain,
    check_classes,
    epoch_order,
    generator,
    hidden_batches,
    mix_colours,
    network_inputs,
    normalised_labels,
    shift_pictures,
    steps_per_epoch,
    turn_dents,
)
from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.methods.base import (
    Activations,
    Adaptation,
    FeatureCollapse,
    Method,
    Step,
    TrainingDiverged,
    loss_of,
)
from gelgap.adapt.methods.registry import make_method
from gelgap.adapt.model import ForceModel, estimate_statistics, input_map, load_start
from gelgap.adapt.network import (
    ForceNetwork,
    autocast,
    load_checkpoint,
    make_network,
    save_checkpoint,
    torch_threads,
)
from gelgap.adapt.profile import Profile
from gelgap.adapt.selection import effective_rank
from gelgap.assets.progress import Progress, hidden_progress
from gelgap.data import LabelledFrames, with_labels
from gelgap.data.frames.dataset import pictures_alone

LOG = logging.getLogger(__name__)
MAX_SKIPPED_IN_A_ROW = 20
COLLAPSED_SPREAD = 0.05
HEALTHY_SPREAD = 0.3


def train_source(
    source: LabelledFrames,
    profile: Profile,
    seed: int = 0,
    *,
    weights: str | Path | None = None,
    resume_file: Path | None = None,
    progress: Progress = hidden_progress,
    frames_of_epoch: Callable[[int], LabelledFrames] | None = None,
) -> ForceModel:
    """Train a network on the source's labels alone: its forces, or which `with_labels` gave it.

    Parameters
    ----------
    source
        Its training frames.
    weights
        A gelgap checkpoint to start from, or a torchvision ResNet state dictionary for the backbone.
    resume_file
        State after each epoch; a training that finds it is resumed.
    frames_of_epoch
        Gives the training frames of each epoch after the first, where they are drawn anew.

    Raises
    ------
    ValueError
        If a label lies outside its range, there are fewer than two frames, or the profile shifts pictures whose contact
        point is learnt.
    """
    source.check_labels()
    model = untrained(source, profile, seed)
    if INPUTS[profile.input].frozen and weights is None:
        raise ValueError(f"input {profile.input}: needs the weights of a pretrained network (--weights)")
    if weights is not None:
        load_start(model.network, Path(weights), source.labels.names, profile)
    if INPUTS[profile.input].from_touch:
        _note_contacts_alone(source, profile, model.device)
    with torch_threads(profile.threads), torch.random.fork_rng(devices=[]):
        records = train(
            model.network,
            profile,
            seed,
            source,
            title=f"source {source.name}",
            resume_file=resume_file,
            progress=progress,
            frames_of_epoch=frames_of_epoch,
        )
        changed = profile.colour_mixing or profile.marker_hiding or profile.shift_px
        if changed or INPUTS[profile.input].from_touch:
            estimate_statistics(model.network, source, profile, seed)
    model.network.eval()
    history = tuple(map(asdict, records))
    return replace(model, history=history, input_map=input_map(source, profile, model.device))


def _note_contacts_alone(source: LabelledFrames, profile: Profile, device: torch.device) -> None:
    shown = network_inputs(source, profile, device)
    if all(shown.inputs(row).any() for row in torch.arange(len(shown)).split(1)):
        told = "no training frame is without contact, and the network reads a force where there is none"
        LOG.warning("input %s: %s: %s; add some", profile.input, source.name, told)


def untrained(source: LabelledFrames, profile: Profile, seed: int = 0) -> ForceModel:
    """Return the model with which stage 1 begins, for methods that do not need its training."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    network = make_network(profile, source.n_classes, seed, len(source.labels)).to(device)
    return ForceModel(
        network.eval(),
        profile,
        source.labels,
        source.n_classes,
        seed,
        source.name,
        source.size_px,
        camera=source.cameras[0],
    )


def adapt(
    model: ForceModel,
    source: LabelledFrames,
    target: LabelledFrames,
    method: str,
    profile: Profile | None = None,
    seed: int | None = None,
    *,
    resume_file: Path | None = None,
    progress: Progress = hidden_progress,
) -> ForceModel:
    """Return a copy of a stage-1 model adapted to the target's pictures; its labels stay unused.

    Parameters
    ----------
    source, target
        Training frames of both domains. Only a method that declares `uses_target_labels` reads target labels. Which
        labels, and in which ranges, is the model's.
    profile, seed
        Those of the stage-1 model unless given; the network's part of the profile must be the same.
    resume_file
        State after each epoch of stage 2; a training that finds it is resumed.

    Raises
    ------
    ValueError
        If the method is unknown, a used label is absent or outside the model's range, or a class-aware method is asked
        for on data without contact classes.
    FeatureCollapse
        If the network becomes a constant predictor.
    TrainingDiverged
        If 20 steps in a row had a loss or gradient that was not finite.
    """
    profile = model.profile if profile is None else profile
    seed = model.seed if seed is None else seed
    chosen = make_method(method, profile, model.n_classes, len(model.labels), seed)
    source = with_labels(source, model.labels)
    source.check_labels()
    if chosen.uses_target_labels:
        target = with_labels(target, model.labels)
        target.check_labels()
    if chosen.uses_classifier:
        check_classes(source, method)
    adapted = replace(
        model,
        network=copy.deepcopy(model.network),
        profile=profile,
        seed=seed,
        size_px=target.size_px,
        camera=target.cameras[0],
        target=target.name,
        method=method,
        input_map=input_map(target, profile, model.device),
    )

    records: list[EpochRecord] = []
    with torch_threads(profile.threads), torch.random.fork_rng(devices=[]):
        if chosen.trains:
            records = train(
                adapted.network,
                profile,
                seed,
                source,
                target,
                chosen,
                title=f"{method} {source.name} → {target.name}",
                resume_file=resume_file,
                progress=progress,
            )
        else:
            torch.manual_seed(seed)
            chosen.adapt(_adaptation(adapted, source, target))
    adapted.network.eval()
    return replace(adapted, history=(*model.history, *map(asdict, records)))


def _adaptation(model: ForceModel, source: LabelledFrames, target: LabelledFrames) -> Adaptation:
    """Return what a method without a loss adapts a model with: of the target its pictures alone."""
    target, profile = pictures_alone(target), model.profile
    return Adaptation(
        model.network,
        model.seed,
        source_pictures=partial(network_inputs, source, profile, model.device),
        target_pictures=partial(network_inputs, target, profile, model.device),
        source_labels=normalised_labels(source),
        estimate_target_statistics=partial(estimate_statistics, model.network, target, profile, model.seed),
    )


@dataclass(frozen=True)
class EpochRecord:
    """What one epoch did.

    Attributes
    ----------
    losses
        Mean of each loss.
    gradient_norm
        Median norm of the gradient.
    prediction_spread
        Standard deviation of the source predictions over that of their labels, mean over axes; near 0 the network
        predicts a constant.
    feature_rank
        Effective rank of the last source batch's features.
    skipped_steps
        Steps whose loss or gradient was not finite.
    wall_s
        Time of the epoch.
    diagnostics
        Mean of each number that the method reports, over the steps that were not skipped.
    """

    stage: str
    epoch: int
    losses: dict[str, float]
    gradient_norm: float
    prediction_spread: float
    feature_rank: float
    skipped_steps: int
    wall_s: float
    diagnostics: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        skipped = f"  {self.skipped_steps} steps skipped" if self.skipped_steps else ""
        return "  ".join(f"{name} {value:.4f}" for name, value in self.losses.items()) + skipped


def train(
    network: ForceNetwork,
    profile: Profile,
    seed: int,
    source_frames: LabelledFrames,
    target_frames: LabelledFrames | None = None,
    method: Method | None = None,
    *,
    title: str,
    resume_file: Path | None = None,
    progress: Progress = hidden_progress,
    frames_of_epoch: Callable[[int], LabelledFrames] | None = None,
) -> list[EpochRecord]:
    """Train a network in place by SGD and return what the epochs did.

    Stage 1 learns the source's labels; stage 2, where there is a method, the method's loss of both domains, too.

    Parameters
    ----------
    title
        What progress and errors call the stage.
    resume_file
        Written after every epoch, read at the start if it exists.
    frames_of_epoch
        Gives the source's frames of each epoch after the first, where they are drawn anew.
    """
    places = [name for name in source_frames.labels.names if name in ("x_mm", "y_mm")]
    if profile.shift_px and places:
        told = f"a shifted picture shows another {' and '.join(places)} than its label says"
        raise ValueError(f"shift_px = {profile.shift_px}: {told}; set shift_px to 0")
    target, final_weight = None, 0.0
    epochs, rate = profile.source_epochs, profile.source_learning_rate
    if method is not None:
        epochs, rate = profile.adapt_epochs, profile.adapt_learning_rate
        weight_set = method.settings.transfer_weight
        final_weight = profile.transfer_weight if weight_set is None else weight_set
        target = TrainingDomain(target_frames, profile, network.device, labelled=method.uses_target_labels)
        method.to(network.device)
    source = TrainingDomain(source_frames, profile, network.device, labelled=True)
    steps = steps_per_epoch(len(source), profile.batch_size)
    optimizer = _make_optimizer(network, method, profile, rate)
    average = copy.deepcopy(network).requires_grad_(False) if profile.averaging else None
    parts = {"network": network, "companion": method, "optimizer": optimizer, "average": average}
    state = {name: part for name, part in parts.items() if part is not None}
    records = _resume(resume_file, state)
    skipped_in_a_row = 0
    for epoch in range(len(records), epochs):
        log = EpochLog()
        network.train()
        torch.manual_seed(int(generator(seed, Draw.TORCH, epochs, epoch).integers(2**63)))  # of dropout
        if frames_of_epoch is not None and epoch > 0:
            drawn = frames_of_epoch(epoch)
            del source  # one domain's pictures at a time
            source = TrainingDomain(drawn, profile, network.device, labelled=True)
        for number, batches in enumerate(batches_of(epoch, source, target, profile, seed), epoch * steps):
            _set_rate(optimizer, profile, number, steps * epochs)
            optimizer.zero_grad(set_to_none=True)
            weight = final_weight * transfer_factor(number, steps * epochs, profile)
            step = Step(number, weight, generator(seed, Draw.METHOD, number))
            of_source, of_target = _activations(network, profile, seed, *batches, method, step)
            loss, losses, diagnostics = _losses(of_source, of_target, method, step, profile)
            loss.backward()
            norm = _gradient_norm(network, method)
            finite = bool(torch.isfinite(norm) & torch.isfinite(loss))
            if finite:
                optimizer.step()
                if average is not None:
                    # At first the average is short, so that it forgets where training began.
                    _move_towards(average, network, 1 - min(profile.averaging, (1 + number) / (10 + number)))
            skipped_in_a_row = 0 if finite else skipped_in_a_row + 1
            if skipped_in_a_row == MAX_SKIPPED_IN_A_ROW:
                raise _diverged(title, losses, norm)
            log.add(of_source, losses, diagnostics, norm if finite else None)
        records.append(log.record(title, epoch + 1))
        if method is not None:
            _check_collapse(records)
        _store(resume_file, state, records)
        progress(title, epoch + 1, epochs, str(records[-1]))
    if average is not None:
        network.load_state_dict(average.state_dict())
    if method is not None and profile.judges_by_own_statistics:
        estimate_statistics(network, target_frames, profile, seed)
    return records


def batches_of(
    epoch: int, source: TrainingDomain, target: TrainingDomain | None, profile: Profile, seed: int
) -> Iterator[tuple[Batch, Batch | None]]:
    """Yield the batches of an epoch, of the source and in stage 2 of the target; an epoch always has the same.

    An epoch is one pass over the source. The target is cycled, permutation after permutation.
    """
    if target is None:
        for batch in _one_pass(source, profile, seed, Draw.STAGE_1, epoch):
            yield batch, None
        return
    of_target = _cycled(target, profile, seed, epoch * steps_per_epoch(len(source), profile.batch_size))
    for batch in _one_pass(source, profile, seed, Draw.STAGE_2, epoch):
        yield batch, next(of_target)


def _one_pass(
    domain: TrainingDomain, profile: Profile, seed: int, draw: Draw, number: int, first: int = 0
) -> Iterator[Batch]:
    """Yield the batches of one pass over a domain from the first wanted one, some without markers."""
    rows = epoch_order(len(domain), profile.batch_size, seed, draw, number)
    hidden = hidden_batches(len(rows), profile.marker_hiding, seed, draw, number)
    for step in range(first, len(rows)):
        batch = domain.batch(rows[step], hidden[step])
        if INPUTS[profile.input].from_touch:
            batch = turn_dents(batch, domain.labels, generator(Draw.TURNS, seed, draw, number, step))
        yield batch


def _cycled(target: TrainingDomain, profile: Profile, seed: int, step: int) -> Iterator[Batch]:
    """Yield the target's batches from a step on, without end."""
    number, first = divmod(step, steps_per_epoch(len(target), profile.batch_size))
    while True:
        yield from _one_pass(target, profile, seed, Draw.STAGE_2_TARGET, number, first)
        number, first = number + 1, 0


def _losses(
    source: Activations, target: Activations | None, method: Method | None, step: Step, profile: Profile
) -> tuple[Tensor, dict[str, Tensor], Mapping[str, float | Tensor]]:
    """Return the loss of a step, what it is made of, and what the method reports."""
    loss = functional.mse_loss(source.prediction, source.force)
    losses = {"regression": loss}
    if method is None:
        return loss, losses, {}
    loss = profile.regression_weight * loss
    if method.uses_classifier:
        losses["classification"] = functional.cross_entropy(source.logits, source.contact_class)
        loss = loss + profile.classification_weight * losses["classification"]
    transfer = loss_of(method, source, target, step)
    if transfer is None:
        return loss, losses, {}
    losses["transfer"] = transfer.value
    return loss + transfer.weight * transfer.value, losses, transfer.diagnostics


def _activations(
    network: ForceNetwork,
    profile: Profile,
    seed: int,
    source: Batch,
    target: Batch | None,
    method: Method | None,
    step: Step,
) -> tuple[Activations, Activations | None]:
    """Return the network's output for the batches of a step, changed at random as the profile and method say."""
    key = seed, Draw.STAGE_1 if target is None else Draw.STAGE_2, step.number
    mixed = mix_colours(source.inputs, profile.colour_mixing, generator(Draw.COLOURS, *key))
    shown = [shift_pictures(mixed, profile.shift_px, generator(Draw.SHIFTS, *key))]
    if target is not None:
        rng = generator(Draw.SHIFTS, seed, Draw.STAGE_2_TARGET, step.number)
        target = target._replace(inputs=shift_pictures(target.inputs, profile.shift_px, rng))
        shown = [method.augment_source(shown[0], target.inputs, step), target.inputs]
        if not method.compares_features and profile.judges_by_own_statistics:
            shown.pop()  # what the network makes of it would change nothing
    with autocast(profile, network.device):
        if target is not None and profile.batch_statistics == "joint":
            features = network.features(torch.cat(shown)).split(list(map(len, shown)))
        else:
            features = [network.features(pictures) for pictures in shown]

    def heads(features: Tensor, batch: Batch) -> Activations:
        share, logits = profile.classification_feedback, None
        if method is not None and method.uses_classifier:
            logits = network.classifier(share * features + (1 - share) * features.detach())
        prediction = network.regressor(features)
        return Activations(features, prediction, logits, batch.force, batch.contact_class, batch.inputs)

    activations = heads(features[0].float(), source)
    return activations, None if len(shown) == 1 else heads(features[1].float(), target)


@torch.no_grad()
def _move_towards(mean: ForceNetwork, network: ForceNetwork, share: float) -> None:
    """Move the weights and statistics of a running mean towards a network's by a share of the way."""
    of_mean, of_network = [*mean.parameters(), *mean.buffers()], [*network.parameters(), *network.buffers()]
    for own, other in zip(of_mean, of_network, strict=True):
        if own.is_floating_point():
            own.lerp_(other, share)


def _set_rate(optimizer: torch.optim.SGD, profile: Profile, number: int, steps: int) -> None:
    """Set the learning rates of a step by the paper's schedule (section IV-B), and let them fall to zero at the end."""
    factor = (1 + profile.rate_decay * number) ** -profile.rate_power
    if profile.final_fall:
        factor *= min(1.0, max(0.0, 1 - number / steps) / profile.final_fall)
    for group in optimizer.param_groups:
        group["lr"] = group["initial_lr"] * factor


def _gradient_norm(network: ForceNetwork, method: Method | None) -> Tensor:
    """Return the norm of all gradients, also of what the method owns."""
    parameters = [*network.parameters(), *(() if method is None else method.parameters())]
    return nn.utils.get_total_norm([p.grad for p in parameters if p.grad is not None])


def _diverged(title: str, losses: Mapping[str, Tensor], norm: Tensor) -> TrainingDiverged:
    values = ", ".join(f"{name} = {float(x.detach()):.3g}" for name, x in losses.items())
    return TrainingDiverged(
        f"{title}: {MAX_SKIPPED_IN_A_ROW} steps in a row had a loss or gradient that is not finite ({values}, "
        f"gradient norm {float(norm):.3g}); lower the learning rate or the transfer weight"
    )


def _store(resume_file: Path | None, state: Mapping[str, Any], records: list[EpochRecord]) -> None:
    """Write what resuming needs."""
    if resume_file is None:
        return
    content = {name: part.state_dict() for name, part in state.items()}
    save_checkpoint(content | {"records": list(map(asdict, records))}, resume_file)


def _resume(resume_file: Path | None, state: Mapping[str, Any]) -> list[EpochRecord]:
    """Take the state of an interrupted training, and return the records of its epochs.

    Nothing is taken from a file that cannot be read or is of another training: training begins anew.
    """
    if resume_file is None or not resume_file.is_file():
        return []
    before = {name: copy.deepcopy(part.state_dict()) for name, part in state.items()}
    try:
        content = load_checkpoint(resume_file)
        for name, part in state.items():
            part.load_state_dict(content[name])
        return [EpochRecord(**record) for record in content["records"]]
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        for name, part in state.items():
            part.load_state_dict(before[name])
        reason = " ".join(str(error).split())[:200]
        LOG.warning("%s cannot be resumed from (%s): training begins anew", resume_file, reason)
        return []


class EpochLog:
    """Collects the steps of one epoch, on the device; `record` sums them up."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._steps: list[tuple[Mapping[str, Tensor], Mapping[str, float | Tensor], Tensor]] = []
        self._predictions: list[Tensor] = []
        self._labels: list[Tensor] = []

    def add(
        self,
        source: Activations,
        losses: Mapping[str, Tensor],
        diagnostics: Mapping[str, float | Tensor] | None,
        gradient_norm: Tensor | None,
    ) -> None:
        """Note a step; losses and diagnostics of a skipped one, which has no gradient_norm, are left out."""
        if gradient_norm is not None:
            losses = {name: loss.detach() for name, loss in losses.items()}
            self._steps.append((losses, diagnostics or {}, gradient_norm))
        self._predictions.append(source.prediction.detach().float())
        self._labels.append(source.force.detach().float())
        self._features = source.features.detach().float()

    def record(self, stage: str, epoch: int) -> EpochRecord:
        """Return what the epoch did."""
        losses, diagnostics, norms = zip(*self._steps, strict=True) if self._steps else ((), (), ())
        return EpochRecord(
            stage=stage,
            epoch=epoch,
            losses=_means(losses),
            gradient_norm=float(np.median([float(norm) for norm in norms])) if norms else math.nan,
            prediction_spread=prediction_spread(torch.cat(self._predictions), torch.cat(self._labels)),
            feature_rank=effective_rank(self._features),
            skipped_steps=len(self._predictions) - len(self._steps),
            wall_s=time.perf_counter() - self._start,
            diagnostics=_means(diagnostics),
        )


def _means(steps: tuple[Mapping[str, float | Tensor], ...]) -> dict[str, float]:
    """Return the mean of each number over the steps that have it."""
    names = dict.fromkeys(name for step in steps for name in step)
    return {name: float(np.mean([float(step[name]) for step in steps if name in step])) for name in names}


def prediction_spread(prediction: Tensor, force: Tensor) -> float:
    """Return the mean over axes of std(prediction) / std(force); axes with constant labels are left out (all: NaN)."""
    label_std = force.std(dim=0)
    varies = label_std > 1e-6
    return float((prediction.std(dim=0)[varies] / label_std[varies]).mean())


def transfer_factor(step: int, steps: int, profile: Profile) -> float:
    """Return the factor in [0, 1] on λ_t: 0 in the warm-up, then 2/(1+e^(−γp))−1 with p from 0 to 1 [1].

    [1] Ganin, Lempitsky, "Unsupervised domain adaptation by backpropagation", ICML 2015, section 4.
    """
    progress = step / max(steps - 1, 1)
    if progress < profile.transfer_warmup:
        return 0.0
    if profile.transfer_ramp == 0:
        return 1.0
    p = (progress - profile.transfer_warmup) / (1 - profile.transfer_warmup)
    return 2 / (1 + math.exp(-profile.transfer_ramp * p)) - 1


def _make_optimizer(
    network: ForceNetwork, method: Method | None, profile: Profile, rate: float
) -> torch.optim.SGD:
    """Return SGD with the backbone's learning rate scaled down; what a method owns learns like the heads."""
    heads = [network.bottleneck, network.regressor, network.classifier, *([] if method is None else [method])]
    factor = 0.0 if INPUTS[profile.input].frozen else profile.backbone_rate_factor
    of_heads = [p for module in heads for p in module.parameters()]
    groups = [
        {"params": list(network.backbone.parameters()), "initial_lr": rate * factor},
        {"params": of_heads, "initial_lr": rate},
    ]
    return torch.optim.SGD(groups, rate, profile.momentum, weight_decay=profile.weight_decay)


def _check_collapse(records: list[EpochRecord]) -> None:
    best, last = max(record.prediction_spread for record in records), records[-1]
    if best >= HEALTHY_SPREAD and last.prediction_spread < COLLAPSED_SPREAD:
        raise FeatureCollapse(
            f"{last.stage}, epoch {last.epoch}: the features collapsed: predictions spread over "
            f"{last.prediction_spread:.1%} of the labels' spread (it was {best:.0%}), effective feature rank "
            f"{last.feature_rank:.1f}; lower transfer_weight (from scratch 0.003 to 0.1, the least for DSAN) or the "
            f"learning rate"
        )
