"""How far two data sets on disk are apart: in colour, modulus, markers, force, and in what no picture shows."""

from collections import Counter

import numpy as np

from gelgap.data.facts import unseen_differences
from gelgap.data.frames.dataset import LabelledFrames
from gelgap.data.frames.splits import paired_contacts
from gelgap.data.frames.stored import GeneratedDomain
from gelgap.domains.gap import domain_gap
from gelgap.domains.recipe import DomainRecipe
from gelgap.render.imaging import picture_gap


def recipe_of(domain: GeneratedDomain) -> DomainRecipe:
    """Return the configuration that a domain was generated from."""
    return DomainRecipe(**domain.manifest["configuration"])


def gap_rows(frames: LabelledFrames, base: LabelledFrames) -> list[tuple[str, str]]:
    """Return (what, value) of the gap from `base`: colours, and, where known, modulus, markers and forces.

    Raises
    ------
    ValueError
        If their pictures have different sizes.
    """
    seen = picture_gap(base.reference, frames.reference)
    rows = [("reference pictures, CIEDE2000", _colours(seen.mean, seen.percentile_95))]
    if isinstance(frames, GeneratedDomain) and isinstance(base, GeneratedDomain):
        gap = domain_gap(recipe_of(base), recipe_of(frames))
        colours = _colours(gap.colour_difference, gap.colour_difference_p95)
        counts = Counter(field.split(".")[0] for field in gap.fields)
        fields = [f"{name} ({count})" if count > 1 else name for name, count in counts.items()]
        rows += [
            ("the same without markers and noise", colours),
            ("modulus", f"× {gap.modulus_ratio:.4g}"),
            ("markers", gap.markers),
            ("fields that differ", ", ".join(fields) or "none"),
        ]
        mine, theirs = paired_contacts(frames, base)
        if len(mine):
            change = np.abs(frames.force_n[mine] - base.force_n[theirs]).mean(axis=0)
            text = ", ".join(f"F{axis} {value:.4f}" for axis, value in zip("xyz", change, strict=True))
            rows.append((f"mean force difference of {len(mine)} paired contacts, N", text))
        rows += [
            ("no picture shows", note)
            for note in unseen_differences(base.name, base.facts, frames.name, frames.facts)
        ]
    return rows


def _colours(mean: float, percentile_95: float) -> str:
    return f"mean {mean:.2f}, 95th percentile {percentile_95:.2f}"
