"""How far two domains are apart: in colour, modulus, markers, force, and in what no picture shows."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from gelgap.data.facts import unseen_differences
from gelgap.data.frames.dataset import LabelledFrames
from gelgap.data.frames.splits import paired_contacts
from gelgap.data.frames.stored import GeneratedDomain
from gelgap.domains.generation.shard import renderer_of
from gelgap.domains.recipe import DomainRecipe, differences, recipe_of, shown_markers
from gelgap.render import Markers
from gelgap.render.imaging import picture_gap
from gelgap.render.renderer import reference_gap


@dataclass(frozen=True)
class DomainGap:
    """The gap from a base domain to another.

    `modulus_ratio` is E over the base's E; `colour_difference` the mean CIEDE2000 between the two reference pictures
    without markers and noise, `colour_difference_p95` its 95th percentile over the pixels; `markers` says whether they
    are `equal`, `added`, `removed` or `changed`, `fields` which fields of the configuration differ.
    """

    modulus_ratio: float
    colour_difference: float
    colour_difference_p95: float
    markers: str
    fields: tuple[str, ...]


def domain_gap(base: DomainRecipe, other: DomainRecipe) -> DomainGap:
    """Return the gap from `base` to `other`, from their recipes alone."""
    colours = reference_gap(renderer_of(base), renderer_of(other))
    return DomainGap(
        modulus_ratio=round(other.elastomer.young_modulus_mpa / base.elastomer.young_modulus_mpa, 6),
        colour_difference=round(colours.mean, 3),
        colour_difference_p95=round(colours.percentile_95, 3),
        markers=markers_gap(*(shown_markers(own.sensor, own.markers) for own in (base, other))),
        fields=tuple(name for name, _, _ in differences(base.configuration(), other.configuration())),
    )


def markers_gap(before: Markers | None, after: Markers | None) -> str:
    """Return whether markers are `equal`, `added`, `removed` or `changed`."""
    if before == after:
        return "equal"
    return "added" if before is None else "removed" if after is None else "changed"


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
