"""DARE-GRAM: align angle and scale of the pseudo-inverse Gram matrices of the features [1].

Deviations from the authors' code: the pseudo-inverse is cut in a gap of both spectra, at most two from where they
cut, exactly on a singular value, so that rounding decides (at their rank the value is theirs: see
`tests/adapt/test_losses.py`); the cut never lies below rounding; the B×B dual matrix is inverted instead of
the (D+1)×(D+1) one; the gradient of the inverse is exact; a column that is zero in both domains counts as aligned;
float64.

[1] Nejjar, Wang, Fink, "DARE-GRAM: unsupervised domain adaptation regression by aligning inverse Gram matrices", CVPR
2023.
"""

import torch
from pydantic import Field
from torch import Tensor

from gelgap.adapt.methods.base import Activations, Method, MethodSettings


def daregram(
    source: Tensor, target: Tensor, angle: float, scale: float, threshold: float, rank: int | None = None
) -> Tensor:
    """Return angle·mean_j|1 − cos_j| + scale·‖λ_s − λ_t‖/k for features (B, D) and (B', D), in float64.

    cos_j is the cosine between the j-th columns of the two pseudo-inverses (AᵀA)⁺ = AᵀK⁻²A, A = [1, f], K =
    AAᵀ, cut after the k leading eigenvalues λ. A column that is zero in both domains (a dead unit) counts
    as aligned. k is `rank`, or by default where the cumulative spectrum reaches the threshold, moved by at most two to
    the widest gap in both spectra.
    """
    a_s, a_t = _with_ones(source).double(), _with_ones(target).double()
    k_s = a_s @ a_s.T
    k_t = a_t @ a_t.T
    values_s, values_t = torch.linalg.eigvalsh(k_s).flip(0), torch.linalg.eigvalsh(k_t).flip(0)
    if rank is None:
        rank = _rank_in_gap(values_s.detach(), values_t.detach(), threshold)
    x_s, x_t = _InverseSquare.apply(k_s, rank) @ a_s, _InverseSquare.apply(k_t, rank) @ a_t
    inner = (x_s * (a_s @ a_t.T @ x_t)).sum(dim=0)
    square_s = (x_s * (k_s @ x_s)).sum(dim=0)
    square_t = (x_t * (k_t @ x_t)).sum(dim=0)
    loss = angle * (1 - _cosine(inner, square_s, square_t)).abs().mean()
    return (loss + scale * _norm(values_s[:rank] - values_t[:rank]) / rank).to(source.dtype)


def _with_ones(features: Tensor) -> Tensor:
    return torch.cat([features.new_ones(len(features), 1), features], dim=1)


def _kept(spectrum: Tensor, threshold: float) -> int:
    """Return the number of eigenvalues (descending) that the authors keep.

    It is one fewer than have a cumulative share up to the threshold, which is at least the first two's share.
    """
    shares = spectrum.cumsum(dim=0) / spectrum.sum()
    return max(int((shares <= shares[:2].max().clamp_min(threshold)).sum()) - 1, 1)


def _rank_in_gap(values_s: Tensor, values_t: Tensor, threshold: float) -> int:
    """Return the rank of the cut: near the threshold, where both spectra fall most; never below rounding."""

    def numerical_rank(values: Tensor) -> int:
        return int((values > 1e-11 * values[0]).sum())

    def fall(values: Tensor, k: int) -> float:
        return float(values[k - 1] / values[k].clamp_min(1e-12 * values[0])) if k < len(values) else 1e12

    rank = max(_kept(values_s.clamp_min(0), threshold), _kept(values_t.clamp_min(0), threshold))
    limit = min(numerical_rank(values_s), numerical_rank(values_t))
    candidates = [k for k in range(rank - 2, rank + 3) if 1 <= k <= limit] or [limit]
    return max(candidates, key=lambda k: min(fall(values_s, k), fall(values_t, k)))


def _cosine(inner: Tensor, square_a: Tensor, square_b: Tensor) -> Tensor:
    """Cosines of columns: 1 where both are zero, 0 (with zero gradient) where one is."""
    both_empty = (square_a <= 0) & (square_b <= 0)
    product = square_a * square_b
    defined = product > 1e-40 * product.max()
    cosine = inner.where(defined, 0.0) / product.where(defined, torch.ones_like(product)).sqrt()
    return torch.where(both_empty, torch.ones_like(cosine), cosine)


def _norm(x: Tensor) -> Tensor:
    """Euclidean norm whose gradient at 0 is 0."""
    square = x.square().sum()
    return torch.where(square > 0, square.where(square > 0, torch.ones_like(square)).sqrt(), 0 * square)


class _InverseSquare(torch.autograd.Function):
    """K ↦ Σ_{i ≤ rank} λ_i⁻² u_i u_iᵀ for a symmetric K.

    The derivative is that of the spectral function (Daleckii and Krein 1965): with g(λ) = λ⁻² on the kept
    part and 0 on the rest, U (L ∘ UᵀdK U) Uᵀ with divided differences L_ij = (g(λ_i) − g(λ_j))/(λ_i − λ_j).
    Repeated eigenvalues within the kept part are harmless; differentiating the eigenvectors themselves
    would give 0/0 there.
    """

    @staticmethod
    def forward(ctx, dual: Tensor, rank: int) -> Tensor:
        values, vectors = torch.linalg.eigh(dual)
        values = values.flip(0)
        vectors = vectors.flip(1)
        ctx.save_for_backward(values, vectors)
        ctx.rank = rank
        return vectors[:, :rank] / values[:rank].square() @ vectors[:, :rank].T

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, None]:
        values, vectors = ctx.saved_tensors
        rank = ctx.rank
        kept = values[:rank, None]
        dropped = values[None, rank:]
        differences = torch.zeros_like(gradient)
        differences[:rank, :rank] = -(kept + kept.T) / (kept * kept.T).square()
        differences[:rank, rank:] = 1 / (kept.square() * (kept - dropped))
        differences[rank:, :rank] = differences[:rank, rank:].T
        inner = vectors.T @ ((gradient + gradient.T) / 2) @ vectors
        return vectors @ (differences * inner) @ vectors.T, None


class DAREGRAM(Method):
    """Regression with DARE-GRAM, its cut in a gap of the spectrum."""

    class Settings(MethodSettings):
        angle: float = Field(default=0.05, ge=0, description="weight of the angle's part")
        scale: float = Field(default=0.001, ge=0, description="weight of the scale's part")
        threshold: float = Field(
            default=0.9, gt=0, lt=1, description="share of the spectrum that the pseudo-inverse keeps"
        )

    settings: Settings

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        weights = self.settings.angle, self.settings.scale
        return daregram(source.features, target.features, *weights, self.settings.threshold)
