"""Choosing among adapted models without target labels.

[1] Sugiyama, Krauledat, Müller, "Covariate shift adaptation by importance weighted cross validation", JMLR 8, 2007.
[2] You, Wang, Long, Jordan, "Towards accurate model selection in deep unsupervised domain adaptation" (DEV), ICML 2019.
[3] Ben-David et al., "Analysis of representations for domain adaptation", NIPS 2006.
[4] Zhong, Fan, Yang, Verscheure, Ren, "Cross validation framework to choose amongst models and datasets for transfer
    learning", ECML 2010; the reverse model here is a nearest-neighbour regression in the feature space.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.methods.mmd import mk_mmd

if TYPE_CHECKING:
    from sklearn.pipeline import Pipeline

ALARM_SPREAD = 0.3
ALARM_RANK = 0.3
# A spread of predictions that is rounding.
_CONSTANT = 1e-6
_NEIGHBOURS = 5
_FOLDS = 3


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

    @property
    def source_error(self) -> np.ndarray:
        """Squared errors (n,) of the source frames, each axis over the variance of its force, mean over the axes."""
        return _relative_error(self.source_prediction_n, self.source_force_n)


def source_risk(candidate: Candidate) -> float:
    """Return the mean squared error on held-out source frames."""
    return float(candidate.source_error.mean())


def importance_weighted_risk(candidate: Candidate) -> float:
    """Return IWCV [1]: the source risk weighted by the density ratio of target to source features."""
    return float((_density_ratio(candidate) * candidate.source_error).mean())


def deep_embedded_validation(candidate: Candidate) -> float:
    """Return DEV [2]: IWCV with the control variate η(w − 1), η = −Cov(wℓ, w)/Var(w)."""
    weight = _density_ratio(candidate)
    loss = weight * candidate.source_error
    variance = weight.var(ddof=1)
    eta = -np.cov(loss, weight)[0, 1] / variance if variance > 0 else 0.0
    return float(loss.mean() + eta * (weight.mean() - 1))


def feature_mmd(candidate: Candidate) -> float:
    """Return the MK-MMD between source and target features, with the median bandwidth."""
    features, domain = map(torch.from_numpy, _features_and_domain(candidate))
    return float(mk_mmd(features[domain == 0], features[domain == 1], robust=True))


def proxy_a_distance(candidate: Candidate) -> float:
    """Return 2(1 − 2ε) with ε the cross-validated error of a linear domain classifier [3]; 0 when it can only guess.

    ε is the mean of both domains' errors and the domains weigh the same in the fit, so that unequal numbers of frames
    tell nothing. At least 2 frames of each domain are needed.
    """
    from sklearn.model_selection import cross_val_score

    features, domain = _features_and_domain(candidate)
    classifier, folds = _classifier(class_weight="balanced"), min(_FOLDS, *np.bincount(domain))
    accuracy = cross_val_score(classifier, features, domain, cv=folds, scoring="balanced_accuracy").mean()
    return float(2 * (1 - 2 * min(1 - accuracy, 0.5)))


def reverse_validation(candidate: Candidate) -> float:
    """Return the error on the source of a model that learnt from the target's predictions alone [4].

    Aligned features with right predictions lead back to the source's forces.
    """
    from sklearn.neighbors import KNeighborsRegressor

    neighbours = min(_NEIGHBOURS, len(candidate.target_features))
    reverse = KNeighborsRegressor(neighbours, weights="distance")
    reverse.fit(candidate.target_features, candidate.target_prediction_n)
    return float(_relative_error(reverse.predict(candidate.source_features), candidate.source_force_n).mean())


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


SELECTORS = {
    "source risk": source_risk,
    "IWCV": importance_weighted_risk,
    "DEV": deep_embedded_validation,
    "feature MMD": feature_mmd,
    "A-distance": proxy_a_distance,
    "reverse validation": reverse_validation,
}


def find_selector(name: str) -> str:
    """Return a selector's name in `SELECTORS`, also of reverse-validation; a ValueError if there is none."""
    known = {known.lower().replace(" ", "-"): known for known in SELECTORS}
    if (plain := name.lower().replace(" ", "-")) not in known:
        raise ValueError(f"selector {name!r} is unknown; known selectors: {', '.join(SELECTORS)}")
    return known[plain]


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


def _relative_error(prediction_n: np.ndarray, force_n: np.ndarray) -> np.ndarray:
    variance = np.maximum(force_n.var(axis=0), 1e-12)
    return ((prediction_n - force_n) ** 2 / variance).mean(axis=1)


def _features_and_domain(candidate: Candidate) -> tuple[np.ndarray, np.ndarray]:
    parts = candidate.source_features, candidate.target_features
    return np.concatenate(parts).astype(np.float64), np.repeat([0, 1], [len(part) for part in parts])


def _classifier(class_weight: str | None = None) -> "Pipeline":
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return make_pipeline(StandardScaler(), LogisticRegression(C=0.1, max_iter=300, class_weight=class_weight))


def _density_ratio(candidate: Candidate) -> np.ndarray:
    """Return p_target/p_source at the source features, from a probabilistic domain classifier."""
    features, domain = _features_and_domain(candidate)
    n, m = len(candidate.source_features), len(candidate.target_features)
    probability = _classifier().fit(features, domain).predict_proba(features[:n])
    return n / m * probability[:, 1] / np.maximum(probability[:, 0], 1e-6)
