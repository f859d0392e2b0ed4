"""DSAN, the paper's method: align the features of each contact class by the local MMD (LMMD) [1].

Subdomains are the contact classes, groups of neighbouring classes (two batches of 32 frames have only 2.6 of 361
classes in common), or soft: every source force of the batch is the centre of a subdomain, to which frames belong by a
Gaussian of their (predicted) force. As in the authors' code, a class is aligned
only if some source frame has it and it is the likeliest of some target frame. Soft subdomains are unaffected: each has
its centre in the source batch.

[1] Zhu et al., "Deep subdomain adaptation network for image classification", IEEE TNNLS 2020.
"""

import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.methods.base import Method, Step, TransferLoss
from gelgap.adapt.methods.dan import RobustSettings, pooled_kernel
from gelgap.adapt.network import Activations

_RADII = 6
_ANGLES = 12


def lmmd(
    source: Tensor,
    target: Tensor,
    source_weights: Tensor,
    target_weights: Tensor,
    classes: Tensor | None = None,
    robust: bool = False,
) -> Tensor:
    """Return the local MMD between features (n_s, D) and (n_t, D), averaged over the classes.

    Parameters
    ----------
    source_weights, target_weights
        (n, C) non-negative memberships. Every column is normalised to sum 1 and detached ([1], equation 6).
    classes
        (C,) which classes count, all with weight in both domains; by default every such class. Without any, the loss
        is exactly 0.
    robust
        Take the median instead of the mean squared distance as bandwidth.

    The sum over classes is one matrix product, Σ_c w_ic w_jc, so that its cost hardly depends on C.
    """
    source_weights, target_weights = source_weights.detach(), target_weights.detach()
    common = weighted_classes(source_weights, target_weights) if classes is None else classes
    weights_s, weights_t = source_weights[:, common], target_weights[:, common]
    weights_s, weights_t = weights_s / weights_s.sum(dim=0), weights_t / weights_t.sum(dim=0)
    signed = torch.cat([weights_s, -weights_t])
    kernel = pooled_kernel(source, target, robust)
    return ((signed @ signed.T) * kernel).sum() / max(signed.shape[1], 1)


def weighted_classes(source_weights: Tensor, target_weights: Tensor) -> Tensor:
    """Return which classes (C,) have weight in both domains; memberships are (n, C).

    A softmax is positive everywhere: in the target every class has.
    """
    return (source_weights.sum(dim=0) > 0) & (target_weights.sum(dim=0) > 0)


def common_classes(source_weights: Tensor, target_weights: Tensor) -> Tensor:
    """Return which classes (C,) are the likeliest of some source frame and of some target frame (the authors' mask)."""
    common = torch.zeros(2, source_weights.shape[1], dtype=torch.bool, device=source_weights.device)
    common[0, source_weights.argmax(dim=1)] = True
    common[1, target_weights.argmax(dim=1)] = True
    return common.all(dim=0)


def coarse_classes(n_classes: int, radius_groups: int, angle_groups: int) -> np.ndarray:
    """Return the group (n_classes,) of each contact class.

    Class 0 (no contact) is alone; the others are grouped by depth, by `radius_groups` ranges of how far and
    `angle_groups` sectors, centred on the axes, of where the indenter travelled.
    """
    index = np.arange(n_classes - 1)
    depth, radius, angle = index // (_RADII * _ANGLES), index // _ANGLES % _RADII, index % _ANGLES
    sector = ((angle * angle_groups * 2 + _ANGLES) // (2 * _ANGLES)) % angle_groups
    group = (depth * radius_groups + radius * radius_groups // _RADII) * angle_groups + sector
    return np.concatenate([[0], 1 + group])


class DSANSettings(RobustSettings):
    """Settings of all three forms."""

    radius_groups: int = Field(default=1, ge=1, le=6, description="ranges of travel of a coarse class")
    angle_groups: int = Field(default=4, ge=1, le=12, description="directions of travel of a coarse class")
    force_width: float = Field(
        default=0.1, gt=0, le=1, description="Gaussian width of a soft subdomain, in the normalised force"
    )


class DSAN(Method):
    """Regression with LMMD; every contact class is a subdomain (the paper).

    Its records have `common_classes`, the number of classes that the loss aligns, and `no_common_class`, the share of
    steps with none, whose loss is 0; both are means over an epoch.
    """

    Settings = DSANSettings
    uses_classifier = True
    aligned = staticmethod(common_classes)
    """Which subdomains (C,) the loss aligns, of memberships (n, C)."""

    def __init__(self, settings: DSANSettings, feature_dim: int, n_classes: int, n_labels: int = 3) -> None:
        super().__init__(settings, feature_dim, n_classes, n_labels)
        membership = functional.one_hot(torch.from_numpy(self.groups())).float()
        self.register_buffer("membership", membership, persistent=False)

    def groups(self) -> np.ndarray:
        """Return the subdomain (n_classes,) of each contact class."""
        return np.arange(self.n_classes)

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss | None:
        if step.weight == 0:
            return None
        weights_s = self.membership[source.contact_class]
        weights_t = target.logits.detach().float().softmax(dim=1) @ self.membership
        classes = self.aligned(weights_s, weights_t)
        robust = self.settings.robust
        value = lmmd(source.features, target.features, weights_s, weights_t, classes, robust)
        count = classes.sum()
        return TransferLoss(value, step.weight, {"common_classes": count, "no_common_class": count == 0})


class UnmaskedDSAN(DSAN):
    """Regression with LMMD on all classes of the source batch, also those that no target frame is taken for."""

    aligned = staticmethod(weighted_classes)


class CoarseDSAN(DSAN):
    """Regression with LMMD on groups of neighbouring contact classes; the classifier knows all classes.

    The mask is that of groups: a target frame's likeliest group has the largest sum of its classes' probabilities.
    """

    def groups(self) -> np.ndarray:
        return coarse_classes(self.n_classes, self.settings.radius_groups, self.settings.angle_groups)


class SoftDSAN(Method):
    """Regression with LMMD on soft subdomains around the forces of the source batch; needs no classifier."""

    Settings = DSANSettings

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        scale = -0.5 / self.settings.force_width**2
        centres = source.force
        source_weights = torch.exp(scale * torch.cdist(source.force, centres).square())
        target_weights = torch.exp(scale * torch.cdist(target.prediction.detach(), centres).square())
        robust = self.settings.robust
        return lmmd(source.features, target.features, source_weights, target_weights, robust=robust)
