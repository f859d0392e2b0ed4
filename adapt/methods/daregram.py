"""DARE-GRAM: align angle and scale of the pseudo-inverse Gram matrices of the features [1], in three forms.

`daregram` uses the B×B dual matrix, cuts in a gap of the spectrum and has the exact gradient. `daregram_published` is
the authors' form, which inverts a (D+1)×(D+1) matrix and cuts exactly on a singular value; it is kept for comparison.
`daregram_tikhonov` has a ridge in place of the cut.

Deviations of `daregram` from the authors' code: the cut is moved by at most two to a gap of both spectra and never lies
below rounding; the gradient of the inverse is exact; a column that is zero in both domains counts as aligned; float64.

[1] Nejjar, Wang, Fink, "DARE-GRAM: unsupervised domain adaptation regression by aligning inverse Gram matrices", CVPR
2023.
"""

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.methods.base import Method, MethodSettings
from gelgap.adapt.network import Activations


def daregram_published(
    source: Tensor, target: Tensor, angle: float, scale: float, threshold: float
) -> Tensor:
    """Return the loss as its authors compute it, for features (B, D); B frames in both domains.

    Each pseudo-inverse is cut exactly at the first singular value that it should drop, so that rounding decides whether
    it is kept: the loss jumps between processors.
    """
    spectra = gram_spectra(source, target)
    rank = published_rank(*spectra, threshold)
    cuts = [(values[rank] / values[0]).detach() for values in spectra]
    return daregram_cut_at(source, target, angle, scale, rank, *cuts)


def daregram_cut_at(
    source: Tensor, target: Tensor, angle: float, scale: float, rank: int, cut_s: Tensor, cut_t: Tensor
) -> Tensor:
    """Return the published loss with each domain's pseudo-inverse cut at a share of its largest singular value."""
    a_s, a_t = _with_ones(source), _with_ones(target)
    inverse_s, inverse_t = (torch.linalg.pinv(a.T @ a, rtol=cut) for a, cut in ((a_s, cut_s), (a_t, cut_t)))
    cosines = functional.cosine_similarity(inverse_s, inverse_t, dim=0, eps=1e-6)
    values_s, values_t = gram_spectra(source, target)
    return angle * (1 - cosines).abs().mean() + scale * torch.dist(values_s[:rank], values_t[:rank]) / rank


def gram_spectra(source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Return the singular values (D + 1,), descending, of both domains' Gram matrices of [1, features]."""
    a_s, a_t = _with_ones(source), _with_ones(target)
    return torch.linalg.svdvals(a_s.T @ a_s), torch.linalg.svdvals(a_t.T @ a_t)


def published_rank(values_s: Tensor, values_t: Tensor, threshold: float) -> int:
    """Return how many singular values the authors mean to keep in both domains."""
    return max(_kept(values_s.detach(), threshold), _kept(values_t.detach(), threshold))


def daregram(source: Tensor, target: Tensor, angle: float, scale: float, threshold: float) -> Tensor:
    """Return angle·mean_j|1 − cos_j| + scale·‖λ_s − λ_t‖/k for features (B, D) and (B', D), in float64.

    cos_j is the cosine between the j-th columns of the two pseudo-inverses (AᵀA)⁺ = AᵀK⁻²A, A = [1, f], K =
    AAᵀ, cut after the k leading eigenvalues λ. A column that is zero in both domains (a dead unit) counts
    as aligned. k is where the cumulative spectrum reaches the threshold, moved by at most two to the widest
    gap in both spectra.
    """
    a_s, a_t = _with_ones(source).double(), _with_ones(target).double()
    k_s, k_t = a_s @ a_s.T, a_t @ a_t.T
    values_s, values_t = torch.linalg.eigvalsh(k_s).flip(0), torch.linalg.eigvalsh(k_t).flip(0)
    rank = _rank_in_gap(values_s.detach(), values_t.detach(), threshold)
    x_s, x_t = _InverseSquare.apply(k_s, rank) @ a_s, _InverseSquare.apply(k_t, rank) @ a_t
    inner = (x_s * (a_s @ a_t.T @ x_t)).sum(dim=0)
    square_s, square_t = (x_s * (k_s @ x_s)).sum(dim=0), (x_t * (k_t @ x_t)).sum(dim=0)
    loss = angle * (1 - _cosine(inner, square_s, square_t)).abs().mean()
    return (loss + scale * _norm(values_s[:rank] - values_t[:rank]) / rank).to(source.dtype)


def daregram_tikhonov(source: Tensor, target: Tensor, angle: float, scale: float, ridge: float) -> Tensor:
    """Return what `daregram` returns, with (AᵀA + εI)⁻¹ in place of the cut pseudo-inverse.

    ε is `ridge` times the mean of the leading B eigenvalues of both domains, so that both inverses have the same scale.
    No eigenvalue is ever cut.
    """
    a_s, a_t = _with_ones(source).double(), _with_ones(target).double()
    k_s, k_t = a_s @ a_s.T, a_t @ a_t.T
    epsilon = ridge * (k_s.diagonal().mean() + k_t.diagonal().mean()) / 2

    def inverse(a: Tensor, dual: Tensor) -> Tensor:
        # ε(AᵀA + εI)⁻¹ = I − Aᵀ(K + εI)⁻¹A (Woodbury)
        inner = torch.linalg.solve(dual + epsilon * torch.eye(len(a)).to(a), a)
        return torch.eye(a.shape[1]).to(a) - a.T @ inner

    x_s, x_t = inverse(a_s, k_s), inverse(a_t, k_t)
    cosine = _cosine((x_s * x_t).sum(dim=0), x_s.square().sum(dim=0), x_t.square().sum(dim=0))
    rank = min(len(k_s), len(k_t))
    values_s, values_t = torch.linalg.eigvalsh(k_s).flip(0)[:rank], torch.linalg.eigvalsh(k_t).flip(0)[:rank]
    return (angle * (1 - cosine).abs().mean() + scale * _norm(values_s - values_t) / rank).to(source.dtype)


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
    both_empty, product = (square_a <= 0) & (square_b <= 0), square_a * square_b
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
        values, vectors = values.flip(0), vectors.flip(1)
        ctx.save_for_backward(values, vectors)
        ctx.rank = rank
        return vectors[:, :rank] / values[:rank].square() @ vectors[:, :rank].T

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, None]:
        values, vectors = ctx.saved_tensors
        rank = ctx.rank
        kept, dropped = values[:rank, None], values[None, rank:]
        differences = torch.zeros_like(gradient)
        differences[:rank, :rank] = -(kept + kept.T) / (kept * kept.T).square()
        differences[:rank, rank:] = 1 / (kept.square() * (kept - dropped))
        differences[rank:, :rank] = differences[:rank, rank:].T
        inner = vectors.T @ ((gradient + gradient.T) / 2) @ vectors
        return vectors @ (differences * inner) @ vectors.T, None


class _Settings(MethodSettings):
    angle: float = Field(default=0.05, ge=0, description="weight of the angle's part")
    scale: float = Field(default=0.001, ge=0, description="weight of the scale's part")


class _CutSettings(_Settings):
    threshold: float = Field(
        default=0.9, gt=0, lt=1, description="share of the spectrum that the pseudo-inverse keeps"
    )


class DAREGRAM(Method):
    """Regression with DARE-GRAM in its stable form."""

    Settings = _CutSettings
    form = staticmethod(daregram)

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        own = self.settings.model_dump(exclude={"transfer_weight"})
        return self.form(source.features, target.features, **own)


class PublishedDAREGRAM(DAREGRAM):
    """Regression with DARE-GRAM as published."""

    form = staticmethod(daregram_published)


class TikhonovDAREGRAM(DAREGRAM):
    """Regression with DARE-GRAM on Tikhonov-regularised inverses."""

    class Settings(_Settings):
        ridge: float = Field(default=0.01, gt=0, description="regularisation over the mean eigenvalue")

    form = staticmethod(daregram_tikhonov)
