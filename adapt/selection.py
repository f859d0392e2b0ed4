"""Choosing among adapted models without target labels, and the signs of a model that has collapsed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.methods.mmd import mk_mmd
from gelgap.assets.names import left

ALARM_SPREAD = 0.3
ALARM_RANK = 0.3
# A spread of predictions that is rounding.
_CONSTANT = 1e-6
_LEFT = ("a-distance", "dev", "iwcv", "reverse-validation")


@dataclass(frozen=True)
class Candidate:
    """What a selector sees of an adapted model.

    Of held-out source frames features (n, D), forces and predictions (n, 3) in N; of target frames features (m, D) and
    predictions (m, 3) alone.
    """

    source_features: np.ndarray
    source_force_n: np.ndarray
    source_prediction_n: np.ndarray
    target_features: np.ndarray
    target_prediction_n: np.ndarray

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> "Candidate":
        """Return what a selector sees of a run's arrays (`load_predictions`): the frames whose features are kept."""
        source, target = (arrays[f"{domain}_features"].astype(np.float32) for domain in ("source", "target"))
        return cls(
            source_features=source,
            source_force_n=arrays["source_true_n"][: len(source)],
            source_prediction_n=arrays["source_predicted_n"][: len(source)],
            target_features=target,
            target_prediction_n=arrays["target_predicted_n"][: len(target)],
        )


def source_risk(candidate: Candidate) -> float:
    """Return the mean squared error on held-out source frames, each axis over the variance of its force."""
    error_n = candidate.source_prediction_n - candidate.source_force_n
    variance = np.maximum(candidate.source_force_n.var(axis=0), 1e-12)
    return float((error_n**2 / variance).mean())


def feature_mmd(candidate: Candidate) -> float:
    """Return the MK-MMD between source and target features, with the median bandwidth."""
    features = candidate.source_features, candidate.target_features
    source, target = (torch.from_numpy(of_domain.astype(np.float64)) for of_domain in features)
    return float(mk_mmd(source, target, robust=True))


def effective_rank(features: Tensor) -> float:
    """Return exp(−Σ p ln p), p the normalised singular values of the centred features (n, D) [1].

    [1] Roy, Vetterli, "The effective rank: a measure of effective dimensionality", EUSIPCO 2007.
    """
    values = torch.linalg.svdvals((features - features.mean(dim=0)).double())
    total = values.sum()
    if total == 0:
        return 0.0
    shares = values[values > 0] / total
    return float(torch.exp(-(shares * shares.log()).sum()))


def rank_alarm(candidate: Candidate) -> bool:
    """Return whether the target features' effective rank is below 30 % of the source features'."""
    source, target = candidate.source_features, candidate.target_features
    return effective_rank(torch.from_numpy(target)) < ALARM_RANK * effective_rank(torch.from_numpy(source))


SELECTORS = {"source-risk": source_risk, "feature-mmd": feature_mmd}


def find_selector(name: str) -> str:
    """Return a selector's name; a ValueError if there is none, or says in which version it was."""
    if name in _LEFT:
        raise ValueError(left("selector", name, f"known selectors: {', '.join(SELECTORS)}"))
    if name not in SELECTORS:
        raise ValueError(f"selector {name!r} is unknown; known selectors: {', '.join(SELECTORS)}")
    return name


def scores(candidate: Candidate) -> dict[str, float]:
    """Return every selector's score of a candidate; lower is better."""
    return {name: score(candidate) for name, score in SELECTORS.items()}


def alarm(candidate: Candidate) -> bool:
    """Return whether the candidate looks like a constant predictor or has lost its features.

    Its target predictions spread over less than 30 % of the source predictions' deviation, or `rank_alarm` says so.
    """
    source, target = candidate.source_prediction_n.std(axis=0), candidate.target_prediction_n.std(axis=0)
    return bool((target < ALARM_SPREAD * source + _CONSTANT).any()) or rank_alarm(candidate)


@dataclass(frozen=True)
class LabelFree:
    """What is known of a model on a target without labels.

    `scores` are the selectors', the lower the better, and `scores_before` those of stage 1, if the method starts from
    it. `quantiles` of the predicted labels are by name, at 5, 50 and 95 %; `alarm` is what `alarm` says.
    """

    scores: dict[str, float]
    scores_before: dict[str, float]
    quantiles: dict[str, tuple[float, ...]]
    alarm: bool


def select(candidates: Sequence[Candidate], selector: str) -> int:
    """Return the index of the candidate of lowest score, among those without an alarm unless all have one.

    Raises
    ------
    ValueError
        If there is no such selector, or there are no candidates.
    """
    score = SELECTORS[find_selector(selector)]
    if not candidates:
        raise ValueError("there are no candidates to select from")
    values = np.array([score(candidate) for candidate in candidates])
    alarmed = np.array([alarm(candidate) for candidate in candidates])
    return int(np.argmin(np.where(np.isnan(values) | (alarmed & ~alarmed.all()), np.inf, values)))
