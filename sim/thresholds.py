"""The thresholds of the quasi-static solution, and the reasons for them."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """Numbers that control the iteration and decide what counts as converged; shares have no unit."""

    # The first load step onto the gel, in which every contact is new, stops at these shares of itself on its way.
    first_contact_shares: tuple[float, float] = (0.2, 0.5)
    # A load step that takes longer, or in which a vertex runs away, is undone and repeated in two halves; a half is
    # left as it is after its number of iterations.
    iterations_per_step: int = 30
    iterations_per_half_step: int = 60
    # Settled vertices that carry force lie on the indenter to this distance.
    largest_gap_mm: float = 2e-3
    # MuJoCo's contact forces of a settled step exceed Coulomb's bound by no more than this share of it.
    settled_coulomb_excess: float = 5e-4
    # Contacts with less than this share of the largest normal force are noise that says nothing about friction.
    negligible_load_share: float = 1e-2
    # Extrapolation moves no vertex further at a time than this share of the indenter's feature size, so that one that
    # slowly slides off the indenter stays near it.
    extrapolation_share: float = 0.02
    # A vertex runs away if it slides this many times as far as the indenter moves in a load step: near the limit of
    # friction too long a step ends on another equilibrium than shorter ones agree on.
    runaway_ratio: float = 1.6
    # If vertices with this share of the load run away all the same, the contact has snapped: where it comes to rest
    # is dynamics, which statics does not determine.
    snapped_load_share: float = 0.25
    # A vertex sticks if its friction is below this share of Coulomb's bound.
    sticking_share: float = 0.99
    # MuJoCo's solver takes a start as solved that leaves at most this share of all forces unbalanced.
    largest_gradient: float = 1e-9
    # A state is converged only if the audit's residual, imbalance and tension are below `largest_error` and its Coulomb
    # excess is at most `largest_coulomb_excess`; a settled state gets up to `polishing_iterations` more to get there.
    largest_error: float = 1e-2
    largest_coulomb_excess: float = 1e-3
    polishing_iterations: int = 40


THRESHOLDS = Thresholds()
