"""The statistics of the batch normalisations, estimated again on the pictures of a domain."""

import copy
from dataclasses import replace

import torch
from torch import nn

from gelgap.adapt.batches import Draw, epoch_order, network_inputs
from gelgap.adapt.model import ForceModel
from gelgap.domains import LabelledFrames, PairedFrames

_BATCH = 64


def with_statistics_of(model: ForceModel, frames: LabelledFrames) -> ForceModel:
    """Return a copy of a model whose batch normalisations have the statistics of these frames' pictures."""
    network = copy.deepcopy(model.network)
    estimate_statistics(network, network_inputs(frames, model.profile, model.device), model.seed)
    return replace(model, network=network)


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
