"""What a domain is: an elastomer under an illumination, with or without markers, named as in the paper.

Random numbers are keyed by the domain and by what they are for.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Literal

from gelgap.assets import list_presets
from gelgap.assets.names import closest_name, quoted

if TYPE_CHECKING:
    from numpy.random import Generator

OWN_LIGHT = "own"
OptionalColumn = Literal[
    "height_map",
    "contact_mask",
    "marker_rest_mm",
    "marker_px",
    "diagnostics",
    "indenter",
    "torque",
    "traction",
    "turn",
]
"""What a domain may hold beyond its labels and pictures."""
Purpose = Literal["sensor noise", "reference noise", "acquisition", "force noise", "contacts", "split"]


@dataclass(frozen=True)
class Domain:
    """An elastomer × an illumination × markers, by the names of their presets; illumination `own` is the sensor's."""

    elastomer: str
    illumination: str
    markers: bool

    @property
    def name(self) -> str:
        """The paper's name: `mb0i0` has markers, `wmb1i1` is without."""
        return f"{'m' if self.markers else 'wm'}{self.elastomer}{self.illumination}"

    def __str__(self) -> str:
        return self.name

    @classmethod
    def parse(cls, name: str) -> "Domain":
        """Read a name like `mb0i0` or `wmb1i1`.

        Raises
        ------
        ValueError
            If the name is not made of known presets; the message lists them.
        """
        found = {domain.name: domain for domain in known_domains()}
        if name not in found:
            raise ValueError(
                f"domain {quoted(name)} is unknown{closest_name(name, found)}; a name is m or wm (with or "
                "without markers), then an elastomer "
                f"({', '.join(list_presets('elastomers'))}), then an illumination "
                f"({', '.join(list_presets('illuminations'))}, or {OWN_LIGHT}: the sensor's own), for example mb0i0 or "
                "wmb1i1"
            )
        return found[name]


def known_domains() -> tuple[Domain, ...]:
    """Return every domain that the presets can make."""
    lights = (*list_presets("illuminations"), OWN_LIGHT)
    return tuple(Domain(*parts) for parts in product(list_presets("elastomers"), lights, (True, False)))


def random_stream(seed: int, domain: str, purpose: Purpose, frame: int = 0) -> "Generator":
    """Return the random numbers of one domain, frame and purpose, whoever draws them and whenever."""
    from numpy.random import SeedSequence, default_rng

    return default_rng(SeedSequence([seed, word(domain), word(purpose), frame]))


@lru_cache(maxsize=64)
def word(text: str) -> int:
    """Return the number that stands for a text among the seeds of random numbers."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
