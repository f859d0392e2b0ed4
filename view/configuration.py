"""What is shown: one press of one gel, seen by one sensor under one illumination; and what a change of it needs."""

from dataclasses import dataclass, field
from enum import Flag, auto
from functools import lru_cache

from gelgap.render import Illumination, Sensor
from gelgap.sim import PATH_DEPTHS_MM, PATH_TRAVELS_MM, Elastomer, Pose, QualityName, Sphere, plan_path

DEEPEST_MM, FARTHEST_MM = PATH_DEPTHS_MM[-1], PATH_TRAVELS_MM[-1]


@dataclass(frozen=True)
class Configuration:
    """Everything that a picture and a force depend on.

    `quality` is that of the picture, and of the physics where a pose is solved by itself.
    """

    elastomer: Elastomer
    sensor: Sensor
    illumination: Illumination
    pose: Pose = field(default_factory=lambda: Pose(depth_mm=0.6))
    indenter: Sphere = field(default_factory=Sphere)
    markers: bool = True
    noise: bool = False
    quality: QualityName = "standard"

    def path_keys(self) -> tuple[str, ...]:
        """Return the names of the solves that its path is made of; gels with the same ones share the path.

        Raises
        ------
        ValueError
            If the gel is too thin for the path.
        """
        return path_keys(self.elastomer, self.indenter)


class Work(Flag):
    """What has to be done for a new configuration; where nothing is named, what is there stays as it is."""

    NOTHING = 0
    FORCE = auto()
    PICTURE = auto()
    LIGHT = auto()
    MEMBRANE = auto()
    SOLVE = auto()


ALL_WORK = Work.FORCE | Work.PICTURE | Work.LIGHT | Work.MEMBRANE | Work.SOLVE


def needed_work(old: Configuration, new: Configuration) -> Work:
    """Return the work that leads from what is shown of one configuration to another."""
    work = Work.NOTHING
    if old.path_keys() != new.path_keys():
        return ALL_WORK
    if old.elastomer != new.elastomer:
        work |= Work.FORCE
    if (old.pose, old.indenter) != (new.pose, new.indenter):
        work |= Work.FORCE | Work.MEMBRANE | Work.PICTURE
    if any(getattr(old, part) != getattr(new, part) for part in ("sensor", "illumination", "quality")):
        work |= Work.LIGHT | Work.PICTURE
    if (old.markers, old.noise) != (new.markers, new.noise):
        work |= Work.PICTURE
    return work


@lru_cache(maxsize=256)
def path_keys(elastomer: Elastomer, indenter: Sphere) -> tuple[str, ...]:
    """Return the names of the solves that a gel's path is made of."""
    return tuple(solve.key for solve in plan_path(elastomer, indenter).solves)
