"""The statistics of a domain's pictures: of the network's input, and of its batch normalisations estimated again."""

import copy
from dataclasses import replace

import torch
from torch import nn

from gelgap.adapt.batches import Draw, epoch_order, network_inputs
from gelgap.adapt.methods.registry import find_method
from gelgap.adapt.model import ForceModel
from gelgap.adapt.profile import Profile
from gelgap.domains import ChannelStatistics, LabelledFrames, PairedFrames

_BATCH = 64


def with_statistics_of(model: ForceModel, frames: LabelledFrames) -> ForceModel:
    """Return a copy of a model whose input and batch normalisations have the statistics of these frames' pictures."""
    network = copy.deepcopy(model.network)
    pictures = network_inputs(frames, model.profile, model.device)
    estimate_statistics(network, pictures, model.seed)
    return replace(model, network=network, input_statistics=pictures.statistics)


def as_judged_on_source(model: ForceModel, source_train: LabelledFrames) -> ForceModel:
    """Return an adapted model as it is judged on the source: under its statistics, where each domain has its own.

    source_train holds the source's training frames.
    """
    if model.profile.judges_by_own_statistics and find_method(model.method).uses_target:
        return with_statistics_of(model, source_train)
    if model.profile.input_standardisation == "none":
        return model
    return replace(model, input_statistics=input_statistics(source_train, model.profile, model.device))


def input_statistics(
    frames: LabelledFrames, profile: Profile, device: torch.device
) -> ChannelStatistics | None:
    """Return the statistics by which the profile standardises a domain's inputs, None where it does not."""
    if profile.input_standardisation == "none":
        return None
    return network_inputs(frames, profile, device).statistics


@torch.no_grad()
def estimate_statistics(network: nn.Module, pictures: PairedFrames, seed: int) -> None:
    """Set every batch normalisation's mean and variance to their averages over one pass of shuffled batches."""
    norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    momenta = [norm.momentum for norm in norms]
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None
    network.train()
    for indices in epoch_order(len(pictures), _BATCH, seed, Draw.STATISTICS):
        network.features(pictures.inputs(indices))
    network.eval()
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
