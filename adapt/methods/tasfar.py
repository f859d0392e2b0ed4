"""TASFAR: source-free adaptation by pseudo-labels that are drawn to where the confident predictions lie [1].

The spread of predictions under dropout tells how sure the network is. What error a spread means is learnt on the
source once (a line through two numbers per axis, and the spread that counts as confident); then the source is not
needed. The confident target predictions give the density of the target's forces, axis by axis; an uncertain
prediction's pseudo-label is its mean under its own Gaussian times this density. The network learns the pseudo-labels,
weighted by how much density stands behind them and by how uncertain they were.

Differences: the network was not trained with dropout, which acts on the transfer feature alone; the batch
normalisations first take the target's statistics, without which no force here is near; Adam and the squared error
itself instead of SGD and its root.

[1] He, Xia, Chen, Li, Chan, "Target-agnostic source-free domain adaptation for regression tasks", ICDE 2024.
"""

import copy
from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from sklearn.linear_model import QuantileRegressor
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.methods.base import Adaptation, Method, MethodSettings, descend
from gelgap.adapt.network import ForceNetwork

_DRAWS = 20
_DROPOUT = 0.2
_WITHIN_SIGMAS = 3.0


class Calibration(NamedTuple):
    """Per label (l,), of the source: σ = intercept + slope·spread, and the spread that still counts as confident."""

    intercept: Tensor
    slope: Tensor
    confident: Tensor


def calibrate(spread: np.ndarray, error: np.ndarray, confident_share: float) -> Calibration:
    """Return what error (n, l) a spread (n, l) means: the line below which 68.27 % of the errors lie ([1], III-C)."""
    lines = []
    for axis_spread, axis_error in zip(spread.T, np.abs(error).T, strict=True):
        scale = max(float(axis_spread.mean()), np.finfo(float).tiny)
        line = QuantileRegressor(quantile=0.6827, alpha=0.0).fit(axis_spread[:, None] / scale, axis_error)
        # A line that falls would call the uncertain frames exact.
        rises = line.coef_[0] > 0
        intercept = line.intercept_ if rises else np.quantile(axis_error, 0.6827)
        lines.append((intercept, line.coef_[0] / scale if rises else 0.0))
    intercept, slope = torch.tensor(np.array(lines).T, dtype=torch.float32)
    confident = torch.from_numpy(np.quantile(spread, confident_share, axis=0).astype(np.float32))
    return Calibration(intercept, slope, confident)


def block_masses(mean: Tensor, sigma: Tensor, edges: Tensor) -> Tensor:
    """Return the mass (B, l, K) of a Gaussian (B, l) in each block between `edges` (K + 1,), cut at three sigmas."""
    standard = ((edges - mean[..., None]) / sigma[..., None]).clamp(-_WITHIN_SIGMAS, _WITHIN_SIGMAS)
    masses = torch.special.ndtr(standard).diff(dim=2)
    return masses / masses.sum(dim=2, keepdim=True).clamp_min(1e-12)


class PseudoLabels(NamedTuple):
    """Pseudo-labels (B, l) in the normalised force, and the weights (B, l) with which they are learnt."""

    force: Tensor
    weight: Tensor


def pseudo_labels(
    prediction: Tensor, spread: Tensor, density: Tensor, edges: Tensor, calibration: Calibration
) -> PseudoLabels:
    """Return the pseudo-labels of predictions (B, l) under the density (l, K) of the target's forces ([1], III-D)."""
    sigma = calibration.intercept + calibration.slope * spread
    masses = block_masses(prediction, sigma, edges)
    posterior = masses * density
    total = posterior.sum(dim=2)
    centres = (edges[1:] + edges[:-1]) / 2
    drawn = (posterior * centres).sum(dim=2) / total.clamp_min(1e-12)
    is_uncertain = (spread > calibration.confident) & (total > 1e-12)
    near = masses > 0
    local = (near * density).sum(dim=2) / near.sum(dim=2).clamp_min(1)
    credibility = torch.where(is_uncertain, local * density.shape[1], torch.ones_like(local))
    weight = credibility * spread / calibration.confident.clamp_min(1e-12)
    return PseudoLabels(torch.where(is_uncertain, drawn, prediction), weight)


class TASFAR(Method):
    """Source-free self-training with a density of the target's labels."""

    class Settings(MethodSettings):
        epochs: int = Field(default=3, ge=1, description="passes over the target")
        learning_rate: float = Field(default=1e-4, ge=0, description="Adam's learning rate")
        block: float = Field(
            default=0.05, gt=0, le=0.5, description="width of a block of the density, in the normalised force"
        )
        confident_share: float = Field(
            default=0.85,
            gt=0,
            lt=1,
            description="share of the source's frames whose spread counts as confident",
        )

    grid = ("learning_rate", (0.0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2))

    def adapt(self, adaptation: Adaptation) -> None:
        """Calibrate on the source, then train on pseudo-labels of the target's pictures alone."""
        network = adaptation.network
        network.eval()
        calibration = self._calibrated(adaptation)
        adaptation.estimate_target_statistics()
        teacher = copy.deepcopy(network).requires_grad_(False).eval()
        edges = torch.linspace(0, 1, round(1 / self.settings.block) + 1).to(teacher.regressor[0].weight)
        density = self._density(adaptation, teacher, calibration, edges)
        optimizer = torch.optim.Adam(network.parameters(), lr=self.settings.learning_rate)
        for epoch in range(1, self.settings.epochs + 1):
            for inputs in adaptation.target_batches(epoch):
                labels = pseudo_labels(*_uncertain(teacher, inputs), density, edges, calibration)
                error = functional.mse_loss(network(inputs), labels.force, reduction="none")
                descend(optimizer, (labels.weight * error).mean(), "TASFAR")

    def _calibrated(self, adaptation: Adaptation) -> Calibration:
        spreads, errors = [], []
        for inputs, force in adaptation.labelled_source_batches(0):
            prediction, spread = _uncertain(adaptation.network, inputs)
            spreads.append(spread)
            errors.append(prediction - force)
        spread, error = (torch.cat(parts).double().cpu().numpy() for parts in (spreads, errors))
        found = calibrate(spread, error, self.settings.confident_share)
        return Calibration(*(value.to(adaptation.network.regressor[0].weight) for value in found))

    def _density(
        self, adaptation: Adaptation, teacher: ForceNetwork, calibration: Calibration, edges: Tensor
    ) -> Tensor:
        """Return the density (l, K) of the confident target predictions; even on an axis that has none."""
        found = torch.zeros(teacher.n_labels, len(edges) - 1).to(edges)
        for inputs in adaptation.target_batches(0):
            prediction, spread = _uncertain(teacher, inputs)
            sigma = calibration.intercept + calibration.slope * spread
            is_confident = (spread <= calibration.confident).float()
            found += (is_confident[..., None] * block_masses(prediction, sigma, edges)).sum(dim=0)
        total = found.sum(dim=1, keepdim=True)
        even = torch.full_like(found, 1 / found.shape[1])
        return torch.where(total > 0, found / total.clamp_min(1e-12), even)


@torch.no_grad()
def _uncertain(network: ForceNetwork, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """Return predictions (B, l) and their standard deviation (B, l) over draws of dropout on the feature.

    The same draws for every batch, so that a run does not depend on what was drawn before.
    """
    features = network.features(inputs).float()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        draws = [network.regressor(functional.dropout(features, _DROPOUT)) for _ in range(_DRAWS)]
    return network.regressor(features), torch.stack(draws).std(dim=0)
