"""Stage 1: a network learns the forces of the source domain."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.batches import Draw, TrainingDomain, epoch_order, hidden_batches
from gelgap.adapt.checkpoint import load_checkpoint
from gelgap.adapt.colour_mixing import mix_batch
from gelgap.adapt.diagnosis import StepResult
from gelgap.adapt.loop import Stage, train
from gelgap.adapt.machine import autocast, best_device, torch_threads
from gelgap.adapt.model import ForceModel
from gelgap.adapt.network import Activations, ForceNetwork, make_network
from gelgap.adapt.normalisation import estimate_statistics
from gelgap.adapt.profile import Profile
from gelgap.adapt.progress import Progress, silent
from gelgap.adapt.resnet import load_imagenet_weights
from gelgap.adapt.shifting import shift_batch
from gelgap.domains import ChannelStatistics, LabelledFrames


def train_source(
    source: LabelledFrames,
    profile: Profile,
    seed: int = 0,
    *,
    weights: str | Path | None = None,
    resume_file: Path | None = None,
    progress: Progress = silent,
) -> ForceModel:
    """Train a network on the source's labels alone: its forces, or which `with_labels` gave it.

    Parameters
    ----------
    source
        Its training frames.
    weights
        A gelgap checkpoint to start from, or a torchvision ResNet state dictionary for the backbone.
    resume_file
        State after each epoch; a run that finds it goes on from there.

    Raises
    ------
    ValueError
        If a label lies outside its range or there are fewer than two frames.
    """
    source.check_labels()
    if len(source) < 2:
        raise ValueError(f"source {source.name} has {len(source)} frames; training needs at least 2")
    device = best_device()
    network = make_network(profile, source.n_classes, seed, len(source.labels)).to(device)
    if weights is not None:
        _load_start(network, Path(weights), source.labels.names)
    with torch_threads(profile.threads):
        domain = TrainingDomain.labelled(source, profile, device)
        stage = SourceStage(
            title=f"source {source.name}",
            network=network,
            profile=profile,
            seed=seed,
            epochs=profile.source_epochs,
            learning_rate=profile.source_learning_rate,
            source=domain,
        )
        records = train(stage, progress, resume_file)
        if profile.colour_mixing or profile.marker_hiding or profile.shift_px:
            estimate_statistics(network, domain.pictures, seed)
    history = tuple(asdict(record) for record in records)
    return _model(network, source, profile, seed, history, domain.pictures.statistics)


def untrained(source: LabelledFrames, profile: Profile, seed: int = 0) -> ForceModel:
    """Return the network as stage 1 begins with it, for methods that do not need its training."""
    network = make_network(profile, source.n_classes, seed, len(source.labels)).to(best_device())
    return _model(network, source, profile, seed, (), None)


def _model(
    network: ForceNetwork,
    source: LabelledFrames,
    profile: Profile,
    seed: int,
    history: tuple[dict, ...],
    input_statistics: ChannelStatistics | None,
) -> ForceModel:
    return ForceModel(
        network=network.eval(),
        profile=profile,
        labels=source.labels,
        n_classes=source.n_classes,
        seed=seed,
        source=source.name,
        history=history,
        input_statistics=input_statistics,
    )


@dataclass(frozen=True)
class SourceStage(Stage):
    """Regression on batches of the source."""

    source: TrainingDomain

    def batches(self, epoch: int) -> Iterator[tuple[Tensor, Tensor]]:
        key = self.seed, Draw.STAGE_1, epoch
        order = epoch_order(len(self.source), self.profile.batch_size, *key)
        hidden = hidden_batches(len(order), self.profile.marker_hiding, *key)
        for indices, is_hidden in zip(order, hidden, strict=True):
            rows = torch.from_numpy(indices).to(self.source.force.device)
            yield self.source.inputs(rows, is_hidden), self.source.force[rows]

    def step(self, number: int, batch: tuple[Tensor, Tensor]) -> StepResult:
        inputs, force = batch
        key = self.seed, Draw.STAGE_1, number
        inputs = shift_batch(mix_batch(inputs, self.profile, *key), self.profile, *key)
        with autocast(self.profile, inputs.device):
            features = self.network.features(inputs)
        features = features.float()
        source = Activations(features, self.network.regressor(features), force=force)
        loss = regression_loss(source)
        return StepResult(loss, {"regression": loss}, source)


def regression_loss(activations: Activations) -> Tensor:
    """Return the mean over frames and axes of the squared error of normalised forces.

    This is the authors' reduction; the paper's ‖F̂ − F‖² is three times that.
    """
    return functional.mse_loss(activations.prediction, activations.force)


def _load_start(network: ForceNetwork, path: Path, labels: tuple[str, ...]) -> None:
    """Start from a gelgap checkpoint, or load ImageNet weights into the backbone.

    Of a checkpoint with other labels or classes the outputs for those in common are taken; the others start anew.
    """
    if "state" not in load_checkpoint(path):
        load_imagenet_weights(network.backbone, path)
        return
    checkpoint = ForceModel.load(path)
    state, own = checkpoint.network.state_dict(), network.state_dict()
    if checkpoint.labels.names != labels:
        pairs = [
            (to, checkpoint.labels.names.index(name))
            for to, name in enumerate(labels)
            if name in checkpoint.labels.names
        ]
        for key in ("regressor.0.weight", "regressor.0.bias"):
            known, state[key] = state[key], own[key].clone()
            for to, at in pairs:
                state[key][to] = known[at]
    if checkpoint.n_classes != network.classifier.out_features:
        state |= {key: own[key] for key in ("classifier.weight", "classifier.bias")}
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(
            f"checkpoint {path} was trained with another network ({checkpoint.profile.backbone}, width "
            f"{checkpoint.profile.width:g}, {checkpoint.profile.pairing}); use the same profile"
        ) from error
