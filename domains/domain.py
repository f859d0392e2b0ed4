"""What a domain is: an elastomer under an illumination, with or without markers, named as in the paper."""

from dataclasses import dataclass
from itertools import product

from gelgap.assets import list_presets
from gelgap.assets.names import closest_name, quoted

OWN_LIGHT = "own"


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
        by_name = {domain.name: domain for domain in known_domains()}
        if name not in by_name:
            raise ValueError(
                f"domain {quoted(name)} is unknown{closest_name(name, by_name)}; a name is m or wm (with or "
                "without markers), then an elastomer "
                f"({', '.join(list_presets('elastomers'))}), then an illumination "
                f"({', '.join(list_presets('illuminations'))}, or {OWN_LIGHT}: the sensor's own), for example mb0i0 or "
                "wmb1i1"
            )
        return by_name[name]


def known_domains() -> tuple[Domain, ...]:
    """Return every domain that the presets can make."""
    lights = (*list_presets("illuminations"), OWN_LIGHT)
    return tuple(Domain(*parts) for parts in product(list_presets("elastomers"), lights, (True, False)))
