"""What can be asked of the solving process, and what it answers."""

from dataclasses import dataclass
from typing import Self

from gelgap.sim import Elastomer, Pose, QualityName, SolvedPath, SolvedPose, Sphere
from gelgap.view.configuration import Configuration, path_keys


@dataclass(frozen=True)
class PathRequest:
    """The path of a gel, from which all its poses are interpolated."""

    elastomer: Elastomer
    indenter: Sphere

    def keys(self) -> tuple[str, ...]:
        """Return the names of the solves that it is made of."""
        return path_keys(self.elastomer, self.indenter)


@dataclass(frozen=True)
class PoseRequest:
    """One pose, solved by itself."""

    elastomer: Elastomer
    indenter: Sphere
    pose: Pose
    quality: QualityName

    @classmethod
    def of(cls, configuration: Configuration) -> Self:
        """Return the request for the pose of a configuration."""
        return cls(configuration.elastomer, configuration.indenter, configuration.pose, configuration.quality)


Request = PathRequest | PoseRequest


@dataclass(frozen=True)
class Progress:
    """How many load steps of a request are done."""

    request: Request
    done: int
    total: int


@dataclass(frozen=True)
class Solved:
    """What came out."""

    request: Request
    result: SolvedPath | SolvedPose


@dataclass(frozen=True)
class Failed:
    """Why nothing came out, in one sentence."""

    request: Request
    reason: str


Answer = Progress | Solved | Failed
