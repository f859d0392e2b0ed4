"""What the demo finds: errors by predictor and domain, predictions, a force curve, and what each stage took."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gelgap.cli.workflows.stages import Stage

if TYPE_CHECKING:
    from gelgap.adapt import Evaluation

SOURCE = "mb0i0"
TARGET = "wmb1i1"


@dataclass(frozen=True)
class Row:
    """One line of the demo's table: a predictor and its error on held-out frames of one domain."""

    predictor: str
    domain: str
    evaluation: "Evaluation"


@dataclass(frozen=True)
class ForceCurve:
    """Fz against depth of a 0.3 MPa gel, ν = 0.49, 3 mm thick, friction 0.8, in N; all arrays (n,)."""

    depth_mm: np.ndarray
    force_n: np.ndarray
    hertz_n: np.ndarray
    bonded_layer_n: np.ndarray
    reference_n: np.ndarray
    seconds_per_pose: float


@dataclass(frozen=True)
class DemoResult:
    """What the demo found; forces are (n, 3) in N, on the target's test frames."""

    rows: tuple[Row, ...]
    stages: tuple[Stage, ...]
    true_n: np.ndarray
    predicted_n: dict[str, np.ndarray]
    curve: ForceCurve

    def row(self, predictor: str, domain: str) -> Row:
        """Return the row of one predictor on one domain."""
        return next(row for row in self.rows if (row.predictor, row.domain) == (predictor, domain))

    @property
    def learned(self) -> bool:
        """Whether source-only has less than half the constant mean's error on held-out source frames."""
        network = self.row("source-only", SOURCE).evaluation.mean_mae_n
        return network < 0.5 * self.row("constant mean", SOURCE).evaluation.mean_mae_n

    @property
    def headline(self) -> str:
        """The report's first line: whether the networks learned and whether adaptation helped."""
        plain, adapted = (self.row(name, TARGET).evaluation.mean_mae_n for name in ("source-only", "dsan"))
        change = f"{adapted:.3f} N against {plain:.3f} N ({100 * (adapted / plain - 1):+.0f} %)"
        verdict = "DSAN beats source-only" if adapted < plain else "DSAN does NOT beat source-only"
        learned = (
            ""
            if self.learned
            else " Source-only did NOT learn: its error on the source is over half the mean's."
        )
        return f"{verdict} on the target: mean error {change}.{learned}"
