"""Gaussian kernels on features, as maximum mean discrepancies need them."""

import torch
from torch import Tensor

KERNEL_COUNT = 5
KERNEL_RATIO = 2.0


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


def multi_gaussian(
    distances: Tensor, base: Tensor, count: int = KERNEL_COUNT, ratio: float = KERNEL_RATIO
) -> Tensor:
    """Return Σ_u exp(−d²/(b·ratio^(u−⌊count/2⌋))), u = 0…count−1 (Long et al. 2015, section 3.2).

    A bandwidth of 0 means equal rows: the distances are all zero and so is the exponent, with zero gradient.
    """
    base = torch.where(base > 0, base, torch.ones_like(base))
    return sum(torch.exp(-distances / (base * ratio ** (u - count // 2))) for u in range(count))
