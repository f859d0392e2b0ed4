"""Training: stage 1 learns the source's forces, stage 2 goes on while a method adapts the network to the target.

Both stages are one loop, `train`, which can be resumed after each epoch. What tells methods apart is the loss that they
add to a step.
"""

import copy
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

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
from gelgap.adapt.epochs import EpochLog, EpochRecord, check_collapse
from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.methods.base import (
    Activations,
    Adaptation,
    Method,
    Step,
    TrainingDiverged,
    loss_of,
)
from gelgap.adapt.methods.registry import make_method, use_method
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
from gelgap.assets.progress import Progress, hidden_progress
from gelgap.data import LabelledFrames, Labels, with_labels
from gelgap.data.frames.dataset import pictures_alone

LOG = logging.getLogger(__name__)
MAX_SKIPPED_IN_A_ROW = 20


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
        LOG.warning(
            "input %s: %s: no training frame is without contact, and the network reads a force where there is none; "
            "add some",
            profile.input,
            source.name,
        )


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
    method
        Its name, or `FILE.py:CLASS` of your own.
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
    method = use_method(method)
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
    target = pictures_alone(target)
    profile = model.profile
    return Adaptation(
        model.network,
        model.seed,
        source_pictures=partial(network_inputs, source, profile, model.device),
        target_pictures=partial(network_inputs, target, profile, model.device),
        source_labels=normalised_labels(source),
        estimate_target_statistics=partial(estimate_statistics, model.network, target, profile, model.seed),
    )


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
    _check_shifts(source_frames.labels, profile)
    target = None
    if method is not None and target_frames is not None:
        target = TrainingDomain(target_frames, profile, network.device, labelled=method.uses_target_labels)
        method.to(network.device)
    source = TrainingDomain(source_frames, profile, network.device, labelled=True)
    steps = steps_per_epoch(len(source), profile.batch_size)
    training = Training(network, method, profile, seed, title, steps)
    records = _resume(resume_file, training.state)
    for epoch in range(len(records), training.epochs):
        log = EpochLog()
        network.train()
        torch.manual_seed(
            int(generator(seed, Draw.TORCH, training.epochs, epoch).integers(2**63))
        )  # of dropout
        if frames_of_epoch is not None and epoch > 0:
            drawn = frames_of_epoch(epoch)
            del source  # one domain's pictures at a time
            source = TrainingDomain(drawn, profile, network.device, labelled=True)
        for number, batches in enumerate(batches_of(epoch, source, target, profile, seed), epoch * steps):
            training.step(number, *batches, log)
        records.append(log.record(title, epoch + 1))
        if method is not None:
            check_collapse(records)
        _store(resume_file, training.state, records)
        progress(title, epoch + 1, training.epochs, str(records[-1]))
    if training.average is not None:
        network.load_state_dict(training.average.state_dict())
    if method is not None and target_frames is not None and profile.judges_by_own_statistics:
        estimate_statistics(network, target_frames, profile, seed)
    return records


def _check_shifts(labels: Labels, profile: Profile) -> None:
    """Check that no label says where in the picture a contact is, if pictures are shifted."""
    places = [name for name in labels.names if name in ("x_mm", "y_mm")]
    if profile.shift_px and places:
        raise ValueError(
            f"shift_px = {profile.shift_px}: a shifted picture shows another {' and '.join(places)} than its label "
            "says; set shift_px to 0"
        )


class Training:
    """All that changes while a network is trained: its weights, a method's own, the optimiser and the averaged weights.

    Without a method it is stage 1. `epochs` are the stage's, `steps_per_epoch` of each are taken.
    """

    def __init__(
        self,
        network: ForceNetwork,
        method: Method | None,
        profile: Profile,
        seed: int,
        title: str,
        steps_per_epoch: int,
    ) -> None:
        self.network = network
        self.method = method
        self.profile = profile
        self.seed = seed
        self.title = title
        self.epochs = profile.source_epochs
        self._transfer_weight = 0.0
        rate = profile.source_learning_rate
        if method is not None:
            self.epochs = profile.adapt_epochs
            weight = method.settings.transfer_weight
            self._transfer_weight = profile.transfer_weight if weight is None else weight
            rate = profile.adapt_learning_rate
        self._steps = steps_per_epoch * self.epochs
        self._optimizer = _make_optimizer(network, method, profile, rate)
        self.average = copy.deepcopy(network).requires_grad_(False) if profile.averaging else None
        self._skipped_in_a_row = 0

    @property
    def state(self) -> dict[str, Any]:
        """What is stored after an epoch, each with a `state_dict`, by name."""
        parts = {
            "network": self.network,
            "companion": self.method,
            "optimizer": self._optimizer,
            "average": self.average,
        }
        return {name: part for name, part in parts.items() if part is not None}

    def step(self, number: int, source: Batch, target: Batch | None, log: EpochLog) -> None:
        """Take one step on batches of both domains, or none where its loss or gradient is not finite; note it.

        Raises
        ------
        TrainingDiverged
            If it is the twentieth in a row that was not taken.
        """
        _set_rate(self._optimizer, self.profile, number, self._steps)
        self._optimizer.zero_grad(set_to_none=True)
        weight = self._transfer_weight * transfer_factor(number, self._steps, self.profile)
        step = Step(number, weight, generator(self.seed, Draw.METHOD, number))
        of_source, of_target = _activations(
            self.network, self.profile, self.seed, source, target, self.method, step
        )
        loss, losses, diagnostics = _losses(of_source, of_target, self.method, step, self.profile)
        loss.backward()
        norm = _gradient_norm(self.network, self.method)
        is_finite = bool(torch.isfinite(norm) & torch.isfinite(loss))
        if is_finite:
            self._optimizer.step()
            self._skipped_in_a_row = 0
            if self.average is not None:
                # At first the average is short, so that it forgets where training began.
                kept = min(self.profile.averaging, (1 + number) / (10 + number))
                _move_towards(self.average, self.network, 1 - kept)
        else:
            self._skipped_in_a_row += 1
        if self._skipped_in_a_row == MAX_SKIPPED_IN_A_ROW:
            raise _diverged(self.title, losses, norm)
        log.add(of_source, losses, diagnostics, norm if is_finite else None)


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
        number = number + 1
        first = 0


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
    if target is not None and method is not None:
        rng = generator(Draw.SHIFTS, seed, Draw.STAGE_2_TARGET, step.number)
        target = target._replace(inputs=shift_pictures(target.inputs, profile.shift_px, rng))
        shown.append(target.inputs)
        if not method.compares_features and profile.judges_by_own_statistics:
            shown.pop()  # what the network makes of it would change nothing
    with autocast(profile, network.device):
        if target is not None and profile.batch_statistics == "joint":
            features = network.features(torch.cat(shown)).split(list(map(len, shown)))
        else:
            features = [network.features(pictures) for pictures in shown]

    def heads(features: Tensor, batch: Batch) -> Activations:
        share = profile.classification_feedback
        logits = None
        if method is not None and method.uses_classifier:
            logits = network.classifier(share * features + (1 - share) * features.detach())
        prediction = network.regressor(features)
        return Activations(features, prediction, logits, batch.force, batch.contact_class, batch.inputs)

    activations = heads(features[0].float(), source)
    if target is None or len(shown) == 1:
        return activations, None
    return activations, heads(features[1].float(), target)


@torch.no_grad()
def _move_towards(mean: ForceNetwork, network: ForceNetwork, share: float) -> None:
    """Move the weights and statistics of a running mean towards a network's by a share of the way."""
    of_mean = [*mean.parameters(), *mean.buffers()]
    of_network = [*network.parameters(), *network.buffers()]
    for value, newest in zip(of_mean, of_network, strict=True):
        if value.is_floating_point():
            value.lerp_(newest, share)


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
