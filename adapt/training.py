"""Two-stage training: stage 1 learns the source's forces, stage 2 adapts that network to unlabelled target
pictures."""

import copy
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gelgap.adapt.frames import Frames, check_same_size
from gelgap.adapt.methods.base import Method
from gelgap.adapt.methods.registry import make_method, transfer_weight
from gelgap.adapt.model import ForceModel
from gelgap.adapt.network import Activations, ForceNetwork, make_network
from gelgap.adapt.pictures import Pictures, mix_colours
from gelgap.adapt.profile import Profile
from gelgap.adapt.progress import Progress, silent
from gelgap.adapt.resnet import load_imagenet_weights
from gelgap.adapt.schedules import transfer_factor
from gelgap.adapt.stage import EpochRecord, StepResult, run_stage, torch_threads

_STATISTICS_BATCH = 64


def best_device() -> torch.device:
    """Return the GPU if there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def regression_loss(prediction: Tensor, force: Tensor) -> Tensor:
    """Return the mean over frames and axes of the squared error of normalised forces (the authors'
    reduction; the paper's ‖F̂ − F‖² is three times that)."""
    return functional.mse_loss(prediction, force)


def normalised_force(frames: Frames) -> np.ndarray:
    """Return forces (n, 3) float32, min-max normalised with the declared range to [0, 1]."""
    low, high = np.asarray(frames.force_range_n, float).T
    return ((frames.force_n - low) / (high - low)).astype(np.float32)


@dataclass(frozen=True)
class _Domain:
    """One domain on the device: pictures always, labels only if they may be used."""

    pictures: Pictures
    force: Tensor | None = None
    contact_class: Tensor | None = None

    @classmethod
    def of(cls, frames: Frames, profile: Profile, device: torch.device, labels: bool) -> "_Domain":
        pictures = Pictures(frames, profile, device)
        if not labels:
            return cls(pictures)
        return cls(
            pictures,
            torch.from_numpy(normalised_force(frames)).to(device),
            torch.from_numpy(frames.contact_class.astype(np.int64)).to(device),
        )


def epoch_order(n: int, batch_size: int, *key: int) -> np.ndarray:
    """Return a permutation of n frames cut into full batches (batches, batch_size), a function of the key
    alone.

    The incomplete last batch is left out: its batch statistics would be noisier than the others'.
    """
    order = np.random.default_rng(np.random.SeedSequence(list(key))).permutation(n)
    size = min(batch_size, n)
    return order[: n // size * size].reshape(-1, size)


def train_source(
    source: Frames,
    profile: Profile,
    seed: int = 0,
    weights: str | Path | None = None,
    resume_file: Path | None = None,
    progress: Progress = silent,
) -> ForceModel:
    """Stage 1: train a network on the source's forces alone.

    Parameters
    ----------
    source
        Training frames; hold some out before (`split_source`).
    weights
        A gelgap checkpoint to start from, or a torchvision ResNet state dictionary for the backbone.
    resume_file
        State after each epoch; a run that finds it goes on from there.

    Raises
    ------
    ValueError
        If a label lies outside the source's declared force range or there are fewer than two frames.
    """
    source.check_labels()
    if len(source) < 2:
        raise ValueError(f"source {source.name} has {len(source)} frames; training needs at least 2")
    device = best_device()
    network = make_network(profile, source.n_classes, seed).to(device)
    if weights is not None:
        _load_start(network, Path(weights))
    with torch_threads(profile.threads):
        domain = _Domain.of(source, profile, device, labels=True)

        def batches(epoch: int) -> Iterator[tuple[Tensor, np.ndarray]]:
            for indices in epoch_order(len(source), profile.batch_size, seed, 1, epoch):
                yield domain.pictures.batch(indices), indices

        def step(number: int, batch: tuple[Tensor, np.ndarray]) -> StepResult:
            pictures, indices = batch
            pictures = _mixed(pictures, profile, seed, 1, number)
            with _autocast(profile, device):
                features = network.features(pictures)
            features = features.float()
            prediction = network.regressor(features)
            force = domain.force[torch.from_numpy(indices).to(device)]
            loss = regression_loss(prediction, force)
            return StepResult(loss, {"regression": loss}, features, prediction, force)

        records = run_stage(
            title=f"source {source.name}",
            network=network,
            extra=None,
            epochs=profile.source_epochs,
            rate=profile.source_learning_rate,
            profile=profile,
            batches=batches,
            step=step,
            diagnostics=dict,
            progress=progress,
            resume_file=resume_file,
            watch_collapse=False,
        )
        if profile.colour_mixing:
            estimate_statistics(network, domain.pictures, seed)
    return ForceModel(
        network=network.eval(),
        profile=profile,
        force_range_n=np.asarray(source.force_range_n, float),
        n_classes=source.n_classes,
        seed=seed,
        source=source.name,
        history=tuple(asdict(record) for record in records),
    )


def adapt(
    model: ForceModel,
    source: Frames,
    target: Frames,
    method: str,
    profile: Profile | None = None,
    seed: int | None = None,
    resume_file: Path | None = None,
    progress: Progress = silent,
    watch: Callable[[int, ForceModel], None] | None = None,
) -> ForceModel:
    """Stage 2: return a copy of a stage-1 model adapted to the target's pictures; its labels stay unused.

    Parameters
    ----------
    source, target
        Training frames of both domains. Only a method that declares `uses_target_labels` reads target labels.
    profile, seed
        Those of the stage-1 model unless given; the network's part of the profile must be the same.
    watch
        Called after each epoch with its number and the model that stopping there would give.

    Raises
    ------
    ValueError
        If the method is unknown, picture sizes differ, a used label is outside the declared range, or a
        class-aware method is asked for on data without contact classes.
    FeatureCollapse
        If the network becomes a constant predictor.
    """
    profile = model.profile if profile is None else profile
    seed = model.seed if seed is None else seed
    chosen = make_method(method, profile, model.n_classes)
    network = copy.deepcopy(model.network)
    adaptation = Adaptation(network, profile, method, source, target, seed, resume_file, progress)
    if watch is not None:

        def show(epoch: int) -> None:
            now = replace(model, network=network, profile=profile, seed=seed, method=method)
            per_domain = profile.batch_statistics == "per_domain"
            stopped = with_statistics_of(now, target) if per_domain else copy.deepcopy(now)
            stopped.network.eval()
            watch(epoch, stopped)

        adaptation.watch = show
    if chosen.uses_target:
        check_same_size(source, target)
    source.check_labels()
    if chosen.uses_target_labels:
        target.check_labels()
    if chosen.uses_classifier and not source.has_classes:
        raise ValueError(
            f"method {method} needs contact classes; source {source.name} has frames without one"
        )
    with torch_threads(profile.threads):
        chosen.adapt(adaptation)
    return replace(
        model,
        network=network.eval(),
        profile=profile,
        seed=seed,
        target=target.name,
        method=method,
        history=(*model.history, *(asdict(record) for record in adaptation.records)),
    )


@dataclass
class Adaptation:
    """What a method may work with while it adapts `network` in place."""

    network: ForceNetwork
    profile: Profile
    method_name: str
    source: Frames
    target: Frames
    seed: int
    resume_file: Path | None = None
    progress: Progress = silent
    watch: Callable[[int], None] | None = None
    records: list[EpochRecord] = field(default_factory=list)

    @property
    def device(self) -> torch.device:
        return next(self.network.parameters()).device

    def estimate_target_statistics(self) -> None:
        """Replace the batch-normalisation statistics by the target's: the mean over one pass of its
        pictures."""
        estimate_statistics(self.network, Pictures(self.target, self.profile, self.device), self.seed)

    def source_mean(self) -> np.ndarray:
        """Return the mean normalised force (3,) of the source's frames."""
        return normalised_force(self.source).mean(axis=0)

    def source_batches(self, epoch: int) -> Iterator[Tensor]:
        """Yield the source's pictures in shuffled batches, one pass."""
        return self._one_pass(self.source, 5, epoch)

    def target_batches(self, epoch: int) -> Iterator[Tensor]:
        """Yield the target's pictures in shuffled batches, one pass."""
        return self._one_pass(self.target, 6, epoch)

    def _one_pass(self, frames: Frames, purpose: int, epoch: int) -> Iterator[Tensor]:
        pictures = Pictures(frames, self.profile, self.device)
        for indices in epoch_order(len(frames), self.profile.batch_size, self.seed, purpose, epoch):
            yield pictures.batch(indices)

    def train(self, method: Method) -> None:
        """Stage 2: minimise λ_r·regression + λ_c·classification + λ_t·transfer."""
        profile, device, network = self.profile, self.device, self.network
        n, m = len(self.source), len(self.target)
        if m < 2 or n < 2:
            raise ValueError(f"adaptation needs at least 2 frames a domain; source has {n}, target {m}")
        source = _Domain.of(self.source, profile, device, labels=True)
        target = _Domain.of(self.target, profile, device, labels=method.uses_target_labels)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            extra = method.to(device)
        steps_per_epoch = len(epoch_order(n, profile.batch_size, 0))
        steps = steps_per_epoch * profile.adapt_epochs
        weight = transfer_weight(self.method_name, profile)

        def batches(epoch: int) -> Iterator[tuple[Tensor, Tensor, np.ndarray, np.ndarray]]:
            target_batches = self._cycled_target(epoch * steps_per_epoch)
            for indices in epoch_order(n, profile.batch_size, self.seed, 2, epoch):
                of_target = next(target_batches)
                yield source.pictures.batch(indices), target.pictures.batch(of_target), indices, of_target

        def step(number: int, batch: tuple[Tensor, Tensor, np.ndarray, np.ndarray]) -> StepResult:
            pictures_s, pictures_t, indices_s, indices_t = batch
            pictures_s = _mixed(pictures_s, profile, self.seed, 2, number)
            with _autocast(profile, device):
                if profile.batch_statistics == "joint":
                    features = network.features(torch.cat([pictures_s, pictures_t]))
                    features_s, features_t = features[: len(pictures_s)], features[len(pictures_s) :]
                else:
                    features_s, features_t = network.features(pictures_s), network.features(pictures_t)
            activations_s = self._activations(method, source, features_s.float(), indices_s)
            activations_t = self._activations(method, target, features_t.float(), indices_t)
            regression = regression_loss(activations_s.prediction, activations_s.force)
            parts = {"regression": regression}
            loss = profile.regression_weight * regression
            if method.uses_classifier:
                parts["classification"] = functional.cross_entropy(
                    activations_s.logits, activations_s.contact_class
                )
                loss = loss + profile.classification_weight * parts["classification"]
            factor = weight * transfer_factor(number, steps, profile) if method.scheduled else 1.0
            if factor > 0:
                parts["transfer"] = method.transfer_loss(activations_s, activations_t)
                loss = loss + factor * parts["transfer"]
            return StepResult(
                loss, parts, activations_s.features, activations_s.prediction, activations_s.force
            )

        self.records += run_stage(
            title=f"{self.method_name} {self.source.name} → {self.target.name}",
            network=network,
            extra=extra,
            epochs=profile.adapt_epochs,
            rate=profile.adapt_learning_rate,
            profile=profile,
            batches=batches,
            step=step,
            diagnostics=lambda: dict(method.diagnostics),
            progress=self.progress,
            resume_file=self.resume_file,
            watch_collapse=True,
            watch=self.watch,
        )
        if profile.batch_statistics == "per_domain":
            self.estimate_target_statistics()

    def _activations(
        self, method: Method, domain: _Domain, features: Tensor, indices: np.ndarray
    ) -> Activations:
        rows = torch.from_numpy(indices).to(features.device)
        share = self.profile.classification_feedback
        logits = None
        if method.uses_classifier:
            logits = self.network.classifier(share * features + (1 - share) * features.detach())
        return Activations(
            features=features,
            prediction=self.network.regressor(features),
            logits=logits,
            force=None if domain.force is None else domain.force[rows],
            contact_class=None if domain.contact_class is None else domain.contact_class[rows],
        )

    def _cycled_target(self, first_step: int) -> Iterator[np.ndarray]:
        """Yield target batches for ever, from a step on: permutation after permutation of the target."""
        size, m = self.profile.batch_size, len(self.target)
        per_cycle = len(epoch_order(m, size, 0))
        cycle, offset = divmod(first_step, per_cycle)
        while True:
            yield from epoch_order(m, size, self.seed, 3, cycle)[offset:]
            cycle, offset = cycle + 1, 0


def with_statistics_of(model: ForceModel, frames: Frames) -> ForceModel:
    """Return a copy of a model whose batch normalisation has the statistics of these frames' pictures."""
    network = copy.deepcopy(model.network)
    estimate_statistics(network, Pictures(frames, model.profile, model.device), model.seed)
    return replace(model, network=network)


@torch.no_grad()
def estimate_statistics(network: nn.Module, pictures: Pictures, seed: int) -> None:
    """Set every batch normalisation's mean and variance to the average over batches of one shuffled pass."""
    norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    momenta = [norm.momentum for norm in norms]
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None
    network.train()
    for indices in epoch_order(len(pictures), _STATISTICS_BATCH, seed, 4):
        network.features(pictures.batch(indices))
    network.eval()
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum


def _mixed(pictures: Tensor, profile: Profile, *key: int) -> Tensor:
    """Return a source batch with the profile's share of colours mixed, a function of the key alone."""
    if profile.colour_mixing == 0:
        return pictures
    return mix_colours(
        pictures, profile.colour_mixing, np.random.default_rng(np.random.SeedSequence([7, *key]))
    )


def _autocast(profile: Profile, device: torch.device) -> torch.autocast:
    return torch.autocast(device.type, torch.bfloat16, enabled=profile.precision == "bfloat16")


def _load_start(network: ForceNetwork, path: Path) -> None:
    """Start from a gelgap checkpoint, or load ImageNet weights into the backbone."""
    if not path.is_file():
        raise FileNotFoundError(f"weights file {path} does not exist")
    content = torch.load(path, map_location="cpu", weights_only=True)
    if "state" not in content:
        load_imagenet_weights(network.backbone, path)
        return
    checkpoint = ForceModel.load(path)
    try:
        network.load_state_dict(checkpoint.network.state_dict())
    except RuntimeError as error:
        raise ValueError(
            f"checkpoint {path} was trained with another network ({checkpoint.profile.backbone}, width "
            f"{checkpoint.profile.width:g}, {checkpoint.profile.pairing}); use the same profile"
        ) from error
