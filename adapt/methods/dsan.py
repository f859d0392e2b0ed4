"""DSAN, the paper's method: align the features of each contact class by the local MMD (LMMD) [1].

As in the authors' code, a class is aligned only if some source frame has it and it is the likeliest of some target
frame.

[1] Zhu et al., "Deep subdomain adaptation network for image classification", IEEE TNNLS 2020.
"""

import torch
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.methods.base import Method, Step, TransferLoss
from gelgap.adapt.methods.dan import RobustSettings, pooled_kernel
from gelgap.adapt.network import Activations


def lmmd(
    source: Tensor,
    target: Tensor,
    source_weights: Tensor,
    target_weights: Tensor,
    classes: Tensor,
    robust: bool = False,
) -> Tensor:
    """Return the local MMD between features (n_s, D) and (n_t, D), averaged over the classes.

    Parameters
    ----------
    source_weights, target_weights
        (n, C) non-negative memberships. Every column is normalised to sum 1 and detached ([1], equation 6).
    classes
        (C,) which classes count, all with weight in both domains. Without any, the loss is exactly 0.
    robust
        Take the median instead of the mean squared distance as bandwidth.

    The sum over classes is one matrix product, Σ_c w_ic w_jc, so that its cost hardly depends on C.
    """
    source_weights, target_weights = source_weights.detach(), target_weights.detach()
    weights_s, weights_t = source_weights[:, classes], target_weights[:, classes]
    weights_s, weights_t = weights_s / weights_s.sum(dim=0), weights_t / weights_t.sum(dim=0)
    signed = torch.cat([weights_s, -weights_t])
    kernel = pooled_kernel(source, target, robust)
    return ((signed @ signed.T) * kernel).sum() / max(signed.shape[1], 1)


def common_classes(source_weights: Tensor, target_weights: Tensor) -> Tensor:
    """Return which classes (C,) are the likeliest of some source frame and of some target frame (the authors' mask)."""
    common = torch.zeros(2, source_weights.shape[1], dtype=torch.bool, device=source_weights.device)
    common[0, source_weights.argmax(dim=1)] = True
    common[1, target_weights.argmax(dim=1)] = True
    return common.all(dim=0)


class DSAN(Method):
    """Regression with LMMD; every contact class is a subdomain (the paper).

    Its records have `common_classes`, the number of classes that the loss aligns, and `no_common_class`, the share of
    steps with none, whose loss is 0; both are means over an epoch.
    """

    Settings = RobustSettings
    uses_classifier = True

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss | None:
        if step.weight == 0:
            return None
        weights_s = functional.one_hot(source.contact_class, self.n_classes).float()
        weights_t = target.logits.detach().float().softmax(dim=1)
        classes = common_classes(weights_s, weights_t)
        robust = self.settings.robust
        value = lmmd(source.features, target.features, weights_s, weights_t, classes, robust)
        count = classes.sum()
        return TransferLoss(value, step.weight, {"common_classes": count, "no_common_class": count == 0})
