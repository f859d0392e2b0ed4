"""A second configuration beside the first: how far apart source and target of a gap are."""

from dataclasses import dataclass

from gelgap.view.configuration import Configuration
from gelgap.view.pictures import PictureMaker


@dataclass(frozen=True)
class Comparison:
    """The gap from a source to a target.

    `modulus_ratio` is E of the target over E of the source; the colour differences are CIEDE2000 between the pictures
    of the undeformed membrane without markers and noise: mean, and 95th percentile over the pixels.
    """

    modulus_ratio: float
    colour_difference: float
    colour_difference_p95: float
    markers: str


def compare(source: Configuration, target: Configuration, pictures: PictureMaker) -> Comparison:
    """Return the gap between two configurations, as `gelgap.domains.domain_gap` has it for domains."""
    mean, percentile_95 = pictures.colour_difference(source, target)
    marked = (source.markers, target.markers)
    return Comparison(
        target.elastomer.young_modulus_mpa / source.elastomer.young_modulus_mpa,
        mean,
        percentile_95,
        {(False, True): "added", (True, False): "removed"}.get(marked, "equal"),
    )
