"""Adapting a source-trained model to a target domain with a method."""

import copy
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.batches import Draw, TrainingDomain, network_inputs, normalised_labels, one_pass
from gelgap.adapt.diagnosis import EpochRecord
from gelgap.adapt.joint_stage import JointStage
from gelgap.adapt.loop import train
from gelgap.adapt.machine import torch_threads
from gelgap.adapt.methods.base import Adaptation, Method
from gelgap.adapt.methods.registry import make_method
from gelgap.adapt.model import ForceModel
from gelgap.adapt.network import ForceNetwork
from gelgap.adapt.normalisation import estimate_statistics, input_statistics
from gelgap.adapt.profile import Profile
from gelgap.adapt.progress import Progress, silent
from gelgap.adapt.splits import check_classes
from gelgap.domains import LabelledFrames, with_labels


def adapt(
    model: ForceModel,
    source: LabelledFrames,
    target: LabelledFrames,
    method: str,
    profile: Profile | None = None,
    seed: int | None = None,
    *,
    resume_file: Path | None = None,
    progress: Progress = silent,
    watch: Callable[[int, ForceModel], None] | None = None,
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
        State after each epoch of stage 2; a run that finds it goes on from there.
    watch
        Called after each epoch with its number and the model that stopping there would give.

    Raises
    ------
    ValueError
        If the method is unknown, a used label is absent or outside the model's range, or a class-aware method is asked
        for on data without contact classes.
    FeatureCollapse
        If the network becomes a constant predictor.
    """
    profile = model.profile if profile is None else profile
    seed = model.seed if seed is None else seed
    chosen = make_method(method, profile, model.n_classes)
    source = with_labels(source, model.labels)
    if chosen.uses_target_labels:
        target = with_labels(target, model.labels)
    _check_frames(chosen, method, source, target)
    network = copy.deepcopy(model.network)
    adapted = replace(
        model,
        network=network,
        profile=profile,
        seed=seed,
        target=target.name,
        method=method,
        input_statistics=input_statistics(target, profile, model.device),
    )
    workbench = _Workbench(network, profile, method, source, target, seed, resume_file, progress)
    if watch is not None:
        workbench.watch = lambda epoch: watch(epoch, _as_if_stopped(adapted, target, chosen))
    with torch_threads(profile.threads):
        chosen.adapt(workbench)
    network.eval()
    return replace(adapted, history=(*model.history, *(asdict(record) for record in workbench.records)))


def _check_frames(method: Method, name: str, source: LabelledFrames, target: LabelledFrames) -> None:
    source.check_labels()
    if method.uses_target_labels:
        target.check_labels()
    check_classes(name, method, source)


def _as_if_stopped(model: ForceModel, target: LabelledFrames, method: Method) -> ForceModel:
    """Return a copy of a model in training, as the end of stage 2 would leave it."""
    network = copy.deepcopy(model.network)
    _end_stage_2(network, method, target, model.profile, model.seed)
    network.eval()
    return replace(model, network=network)


def _end_stage_2(
    network: ForceNetwork, method: Method, target: LabelledFrames, profile: Profile, seed: int
) -> None:
    """Turn a network in training into the result, under the target's statistics where domains have their own."""
    method.finish(network)
    if profile.judges_by_own_statistics:
        device = next(network.parameters()).device
        estimate_statistics(network, network_inputs(target, profile, device), seed)


@dataclass
class _Workbench(Adaptation):
    """An adaptation in progress."""

    network: ForceNetwork
    profile: Profile
    method_name: str
    source: LabelledFrames
    target: LabelledFrames
    seed: int
    resume_file: Path | None
    progress: Progress
    watch: Callable[[int], None] | None = None
    records: list[EpochRecord] = field(default_factory=list)

    @property
    def device(self) -> torch.device:
        return next(self.network.parameters()).device

    def train(self, method: Method) -> None:
        if min(len(self.source), len(self.target)) < 2:
            raise ValueError(
                f"adaptation needs at least 2 frames per domain; source has {len(self.source)}, "
                f"target {len(self.target)}"
            )
        target = TrainingDomain.labelled if method.uses_target_labels else TrainingDomain.unlabelled
        stage = JointStage(
            title=f"{self.method_name} {self.source.name} → {self.target.name}",
            network=self.network,
            profile=self.profile,
            seed=self.seed,
            epochs=self.profile.adapt_epochs,
            learning_rate=self.profile.adapt_learning_rate,
            method=method.to(self.device),
            source=TrainingDomain.labelled(self.source, self.profile, self.device),
            target=target(self.target, self.profile, self.device),
        )
        method.begin(self.network)
        self.records += train(stage, self.progress, self.resume_file, self.watch)
        _end_stage_2(self.network, method, self.target, self.profile, self.seed)

    def estimate_target_statistics(self) -> None:
        pictures = network_inputs(self.target, self.profile, self.device)
        estimate_statistics(self.network, pictures, self.seed)

    def source_mean(self) -> np.ndarray:
        return normalised_labels(self.source).mean(axis=0)

    def source_batches(self, epoch: int) -> Iterator[Tensor]:
        return (inputs for _, inputs in self._one_pass(self.source, Draw.SOURCE_PASS, epoch))

    def labelled_source_batches(self, epoch: int) -> Iterator[tuple[Tensor, Tensor]]:
        force = torch.from_numpy(normalised_labels(self.source)).to(self.device)
        for rows, inputs in self._one_pass(self.source, Draw.SOURCE_PASS, epoch):
            yield inputs, force[torch.from_numpy(rows)]

    def target_batches(self, epoch: int) -> Iterator[Tensor]:
        return (inputs for _, inputs in self._one_pass(self.target, Draw.TARGET_PASS, epoch))

    def _one_pass(
        self, frames: LabelledFrames, draw: Draw, epoch: int
    ) -> Iterator[tuple[np.ndarray, Tensor]]:
        return one_pass(frames, self.profile, self.device, self.seed, draw, epoch)
