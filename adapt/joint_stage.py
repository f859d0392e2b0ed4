"""Stage 2: a network learns the source's forces while a method draws the target's features to the source's."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.batches import (
    Draw,
    TrainingDomain,
    epoch_order,
    generator,
    hidden_batches,
    steps_per_epoch,
)
from gelgap.adapt.colour_mixing import mix_batch
from gelgap.adapt.diagnosis import StepResult
from gelgap.adapt.loop import Stage
from gelgap.adapt.machine import autocast
from gelgap.adapt.methods.base import Method
from gelgap.adapt.network import Activations
from gelgap.adapt.schedules import transfer_factor
from gelgap.adapt.shifting import shift_batch
from gelgap.adapt.source_training import regression_loss


class _Batch(NamedTuple):
    """Network inputs of one domain, and which frames (B,) they are."""

    inputs: Tensor
    rows: Tensor


@dataclass(frozen=True)
class JointStage(Stage):
    """Minimise λ_r·regression + λ_c·classification + λ_t·transfer on batches of both domains.

    An epoch is one pass over the source; the target is cycled.
    """

    method: Method
    source: TrainingDomain
    target: TrainingDomain
    stops_on_collapse = True

    @property
    def companion(self) -> Method:
        return self.method

    def after_step(self) -> None:
        self.method.after_step(self.network)

    @cached_property
    def steps_per_epoch(self) -> int:
        return steps_per_epoch(len(self.source), self.profile.batch_size)

    def batches(self, epoch: int) -> Iterator[tuple[_Batch, _Batch]]:
        size = self.profile.batch_size
        of_target = self._cycled_target(epoch * self.steps_per_epoch)
        key = self.seed, Draw.STAGE_2, epoch
        order = epoch_order(len(self.source), size, *key)
        hidden = hidden_batches(len(order), self.profile.marker_hiding, *key)
        for of_source in zip(order, hidden, strict=True):
            yield _batch(self.source, *of_source), _batch(self.target, *next(of_target))

    def _cycled_target(self, first_step: int) -> Iterator[tuple[np.ndarray, bool]]:
        """Yield the indices of target batches from a step on, permutation after permutation, without end.

        Each comes with whether its markers are hidden.
        """
        n, size = len(self.target), self.profile.batch_size
        cycle, offset = divmod(first_step, steps_per_epoch(n, size))
        while True:
            key = self.seed, Draw.STAGE_2_TARGET, cycle
            order = epoch_order(n, size, *key)
            hidden = hidden_batches(len(order), self.profile.marker_hiding, *key)
            yield from zip(order[offset:], hidden[offset:], strict=True)
            cycle, offset = cycle + 1, 0

    def step(self, number: int, batch: tuple[_Batch, _Batch]) -> StepResult:
        profile, method = self.profile, self.method
        method.weight, method.rng = self._transfer_weight(number), generator(self.seed, Draw.METHOD, number)
        method.diagnostics.clear()
        source, target = self._activations(number, *batch)
        parts = {"regression": regression_loss(source)}
        loss = profile.regression_weight * parts["regression"]
        if method.uses_classifier:
            parts["classification"] = functional.cross_entropy(source.logits, source.contact_class)
            loss = loss + profile.classification_weight * parts["classification"]
        if method.weight > 0 or method.applies_weight:
            parts["transfer"] = method.transfer_loss(source, target)
            loss = loss + (1.0 if method.applies_weight else method.weight) * parts["transfer"]
        return StepResult(loss, parts, source, dict(method.diagnostics))

    def _transfer_weight(self, number: int) -> float:
        if not self.method.scheduled:
            return 1.0
        factor = transfer_factor(number, self.steps_per_epoch * self.epochs, self.profile)
        return self.method.settings.final_weight(self.profile) * factor

    def _activations(self, number: int, source: _Batch, target: _Batch) -> tuple[Activations, Activations]:
        network = self.network
        key = self.seed, Draw.STAGE_2, number
        inputs = shift_batch(mix_batch(source.inputs, self.profile, *key), self.profile, *key)
        target = target._replace(
            inputs=shift_batch(target.inputs, self.profile, self.seed, Draw.STAGE_2_TARGET, number)
        )
        shown = self.method.perturb(target.inputs)
        with autocast(self.profile, inputs.device):
            if self.profile.batch_statistics == "joint":
                together = network.features(torch.cat([inputs, shown]))
                of_source, of_target = together[: len(inputs)], together[len(inputs) :]
            else:
                of_source, of_target = network.features(inputs), network.features(shown)
        return (
            self._heads(self.source, of_source.float(), source),
            self._heads(self.target, of_target.float(), target),
        )

    def _heads(self, domain: TrainingDomain, features: Tensor, batch: _Batch) -> Activations:
        share = self.profile.classification_feedback
        logits = None
        if self.method.uses_classifier:
            logits = self.network.classifier(share * features + (1 - share) * features.detach())
        return Activations(
            features=features,
            prediction=self.network.regressor(features),
            logits=logits,
            force=None if domain.force is None else domain.force[batch.rows],
            contact_class=None if domain.contact_class is None else domain.contact_class[batch.rows],
            inputs=batch.inputs,
        )


def _batch(domain: TrainingDomain, indices: np.ndarray, hidden: bool) -> _Batch:
    rows = torch.from_numpy(indices).to(domain.pictures.images.device)
    return _Batch(domain.inputs(rows, hidden), rows)
