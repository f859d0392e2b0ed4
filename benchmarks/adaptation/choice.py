"""Choosing one of several candidates for all groups by a selector without target labels, and what the choice costs.

Every group ranks its candidates by the selector's score, those that collapsed or look like constant predictors last;
the candidate with the least mean rank is chosen. Regret is the error of a choice less that of the best candidate.
"""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelgap.benchmarks.adaptation.jobs import RunRecord

SELECTOR = "reverse validation"
"""Fixed before anything was tuned, for its regret in an earlier study; the others are shown beside it, not used."""

Case = tuple[str, tuple[str, str], int]
"""Data set, group and seed."""


@dataclass(frozen=True)
class Candidates:
    """Runs of the same candidates on several cases; only cases in which every candidate was run count.

    `names` are the candidates in the order in which the first of equals is preferred, and `records` hold them by case
    and name.
    """

    names: Sequence[Hashable]
    records: dict[tuple[Case, Hashable], RunRecord]

    @cached_property
    def cases(self) -> list[Case]:
        """The cases in which every candidate was run."""
        found = dict.fromkeys(case for case, _ in self.records)
        return [case for case in found if all((case, name) in self.records for name in self.names)]

    def grid(self, case: Case) -> list[RunRecord]:
        """Return the candidates' records of a case."""
        return [self.records[case, name] for name in self.names]

    def ranks(self, selector: str = SELECTOR) -> np.ndarray:
        """Return each candidate's rank (cases, candidates), 1 the best, ties shared."""
        from scipy.stats import rankdata

        scores = [[_score(record, selector) for record in self.grid(case)] for case in self.cases]
        return rankdata(np.array(scores).reshape(len(self.cases), len(self.names)), axis=1)

    def choice(self, selector: str = SELECTOR) -> int:
        """Return the index of the candidate with the least mean rank; the first of equals.

        Raises
        ------
        ValueError
            If the selector is unknown, or no case is complete.
        """
        from gelgap.adapt import SELECTORS
        from gelgap.assets.names import unknown_name

        if selector not in SELECTORS:
            raise ValueError(unknown_name("selector", selector, SELECTORS, "known selectors"))
        if not self.cases:
            raise ValueError("no group has all candidates yet; run the rest of the grid first")
        return int(self.ranks(selector).mean(axis=0).argmin())

    @cached_property
    def errors_n(self) -> np.ndarray:
        """The test error on the target (cases, candidates), N, which no selector sees."""
        return np.array([[record.mean_mae_n for record in self.grid(case)] for case in self.cases])

    def regret_n(self, index: int) -> np.ndarray:
        """Return the regret (cases,) of one candidate for all cases, N."""
        return self.errors_n[:, index] - self.errors_n.min(axis=1)

    def own_regret_n(self, selector: str = SELECTOR) -> np.ndarray:
        """Return the regret (cases,) of a selector that chooses in every case anew, N."""
        chosen = self.ranks(selector).argmin(axis=1)
        return self.errors_n[np.arange(len(chosen)), chosen] - self.errors_n.min(axis=1)


def case_of(record: RunRecord) -> Case:
    """Return the case to which a record belongs."""
    return record.job.data, record.job.group, record.job.seed


def _score(record: RunRecord, selector: str) -> float:
    if not record.is_sound or record.scores is None or math.isnan(record.scores[selector]):
        return math.inf
    return record.scores[selector]
