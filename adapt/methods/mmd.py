"""Match distributions by the maximum mean discrepancy (MMD): of features, with predictions, or by contact class.

DAN [1, 2] matches features by the multi-kernel MMD, in the form of the DSAN authors' code. tllib takes the U-statistic,
adds 2/(n − 1), and its mean squared distance counts every frame with itself.

JAN [3] matches the joint distribution of feature and prediction. It differs from tllib as DAN does, and has five
kernels on the prediction, whose bandwidth follows its distances, where tllib has one of σ = 0.92, chosen for class
probabilities.

DSAN [4], the paper's method, aligns the features of each contact class by the local MMD (LMMD). As in its authors'
code, a class is aligned only if some source frame has it and it is the likeliest of some target frame.

[1] Long, Cao, Wang, Jordan, "Learning transferable features with deep adaptation networks", ICML 2015.
[2] Gretton et al., "A kernel two-sample test", JMLR 13, 2012.
[3] Long, Zhu, Wang, Jordan, "Deep transfer learning with joint adaptation networks", ICML 2017.
[4] Zhu et al., "Deep subdomain adaptation network for image classification", IEEE TNNLS 2020.
"""

import math
from collections.abc import Sequence

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.methods.base import Activations, Method, MethodSettings, Step, TransferLoss

KERNEL_COUNT = 5


def pooled_kernel(source: Tensor, target: Tensor, robust: bool = False) -> Tensor:
    """Return the multi-Gaussian kernel (n + m, n + m) of two pooled samples (n, d) and (m, d), source first.

    Its bandwidth is that of their distances; see `bandwidth` for robust.
    """
    distances = squared_distances(torch.cat([source, target]))
    return multi_gaussian(distances, bandwidth(distances, robust))


def squared_distances(x: Tensor) -> Tensor:
    """Return ‖x_i − x_j‖² (n, n) of rows x (n, d); centred first, so that a common offset costs no digits."""
    x = x - x.mean(dim=0, keepdim=True)
    squares = (x * x).sum(dim=1)
    distances = (squares[:, None] + squares[None, :] - 2 * x @ x.T).clamp_min(0)
    return distances * (1 - torch.eye(len(x), dtype=x.dtype, device=x.device))


def bandwidth(distances: Tensor, robust: bool) -> Tensor:
    """Return the kernel bandwidth of a pooled sample: the mean squared distance of distinct rows, as published.

    robust takes the median instead, which one outlier does not move. No gradient flows through the bandwidth.
    """
    n = len(distances)
    pairs = distances.detach()[~torch.eye(n, dtype=torch.bool, device=distances.device)]
    return pairs.median() if robust else pairs.mean()


def multi_gaussian(distances: Tensor, base: Tensor) -> Tensor:
    """Return Σ_u exp(−d²/(b·2^(u−2))), u = 0…4 ([1], section 3.2).

    A bandwidth of 0 means equal rows: the distances are all zero and so is the exponent, with zero gradient.
    """
    base = torch.where(base > 0, base, torch.ones_like(base))
    return sum(torch.exp(-distances / (base * 2.0 ** (u - KERNEL_COUNT // 2))) for u in range(KERNEL_COUNT))


def mmd_of_kernel(kernel: Tensor, n: int, unbiased: bool = False) -> Tensor:
    """Return the squared MMD of a pooled kernel matrix (n + m, n + m) whose first n rows are the source.

    The biased V-statistic ([2], equation 5) is never negative; the unbiased U-statistic (equation 3) may be.
    """
    m = len(kernel) - n
    k_ss = kernel[:n, :n]
    k_tt = kernel[n:, n:]
    k_st = kernel[:n, n:]
    if unbiased:
        within = (k_ss.sum() - k_ss.trace()) / (n * (n - 1)) + (k_tt.sum() - k_tt.trace()) / (m * (m - 1))
        return within - 2 * k_st.mean()
    return k_ss.mean() + k_tt.mean() - 2 * k_st.mean()


def mk_mmd(source: Tensor, target: Tensor, robust: bool = False, unbiased: bool = False) -> Tensor:
    """Return the squared MMD of features (n, D) and (m, D) summed over five Gaussian kernels.

    robust takes the median instead of the mean squared distance as bandwidth. Its distances are taken in float64: one
    outlier leaves the bandwidth small, and in float32 would take the digits of all others.
    """
    rows = torch.cat([source, target])
    distances = squared_distances(rows.double() if robust else rows).to(rows.dtype)
    kernel = multi_gaussian(distances, bandwidth(distances, robust))
    return mmd_of_kernel(kernel, len(source), unbiased)


class RobustSettings(MethodSettings):
    """Settings of a method whose kernel's bandwidth may follow the median."""

    robust: bool = Field(default=False, description="median, not mean, squared distance as kernel bandwidth")


class DAN(Method):
    """Regression with MK-MMD on the transfer feature."""

    class Settings(RobustSettings):
        unbiased: bool = Field(default=False, description="U-statistic (may be negative), not V-statistic")

    settings: Settings

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        return mk_mmd(source.features, target.features, self.settings.robust, self.settings.unbiased)


def joint_mmd(source: Sequence[Tensor], target: Sequence[Tensor], robust: bool = False) -> Tensor:
    """Return the squared MMD with the product over layers of multi-Gaussian kernels ([3], equation 9).

    source and target hold the activations (n, D_l) and (m, D_l) of the same layers. With one layer this is
    MK-MMD.
    """
    kernels = (pooled_kernel(*layer, robust) for layer in zip(source, target, strict=True))
    return mmd_of_kernel(math.prod(kernels), len(source[0]))


class JAN(Method):
    """Regression with joint MMD over the transfer feature and the predicted force."""

    Settings = RobustSettings
    settings: RobustSettings

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        layers_s, layers_t = ((a.features, a.prediction) for a in (source, target))
        return joint_mmd(layers_s, layers_t, self.settings.robust)


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
        (n, C) non-negative memberships. Every column is normalised to sum 1 and detached ([4], equation 6).
    classes
        (C,) which classes count, all with weight in both domains. Without any, the loss is exactly 0.
    robust
        Take the median instead of the mean squared distance as bandwidth.

    The sum over classes is one matrix product, Σ_c w_ic w_jc, so that its cost hardly depends on C.
    """
    source_weights = source_weights.detach()
    target_weights = target_weights.detach()
    weights_s = source_weights[:, classes]
    weights_t = target_weights[:, classes]
    weights_s = weights_s / weights_s.sum(dim=0)
    weights_t = weights_t / weights_t.sum(dim=0)
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
    settings: RobustSettings
    uses_classifier = True

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss | None:
        if step.weight == 0:
            return None
        assert target.logits is not None, "class logits come with uses_classifier"
        weights_s = functional.one_hot(source.contact_class, self.n_classes).float()
        weights_t = target.logits.detach().float().softmax(dim=1)
        classes = common_classes(weights_s, weights_t)
        robust = self.settings.robust
        value = lmmd(source.features, target.features, weights_s, weights_t, classes, robust)
        count = classes.sum()
        return TransferLoss(value, step.weight, {"common_classes": count, "no_common_class": count == 0})
