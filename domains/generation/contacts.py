"""The contacts of frames where a library of poses serves them: which poses it does, and which are solved."""

from dataclasses import dataclass, replace

from gelgap.domains.library import LibraryPlan, PoseLibrary, PoseRanges
from gelgap.sim import (
    ContactPath,
    Elastomer,
    Indenter,
    MembraneState,
    Pose,
    PosePath,
    Solution,
    Solve,
    SolvePlan,
    is_interior,
    plan_solves,
)


@dataclass(frozen=True)
class LibraryPoses:
    """Poses that a library serves, and those that it does not reach, by solves of their own: as a `SolvePlan`."""

    library: LibraryPlan
    own: SolvePlan
    poses: tuple[Pose, ...]

    @classmethod
    def of(
        cls, gel: Elastomer, indenter: Indenter, path: ContactPath | PosePath, quality: str
    ) -> "LibraryPoses | SolvePlan":
        """Return the contacts of a path: a solve plan if a library serves none of them."""
        served = [
            p.depth_mm > 0 and p.trajectory is None and not any(p.turn_deg) and is_interior(gel, p)
            for p in path.poses
        ]
        of_library = [pose for pose, is_served in zip(path.poses, served, strict=True) if is_served]
        left = [
            replace(pose, depth_mm=0.0) if is_served else pose
            for pose, is_served in zip(path.poses, served, strict=True)
        ]
        own = plan_solves(gel, indenter, PosePath(path.name, tuple(left)), quality)
        if not of_library:
            return own
        library = LibraryPlan(gel, indenter, PoseRanges.of(of_library), quality)
        return cls(library, own, path.poses)

    @property
    def solves(self) -> tuple[Solve, ...]:
        return (*self.library.solves, *self.own.solves)

    def solve_key(self, pose_index: int) -> str:
        """Return the key of the solve, or of the library, that serves a pose."""
        is_own = self.own.placements[pose_index] is not None
        return self.own.solve_key(pose_index) if is_own else self.library.key

    def state(
        self, pose_index: int, source: PoseLibrary | Solution, half_extent_mm: tuple[float, float]
    ) -> MembraneState:
        """Return the membrane of a pose from what `solve_key` names."""
        if self.own.placements[pose_index] is not None:
            return self.own.state(pose_index, source, half_extent_mm)
        return source.state(self.own.elastomer, self.poses[pose_index], half_extent_mm)


def part_of(contacts: LibraryPoses | SolvePlan, start: int, stop: int) -> LibraryPoses | SolvePlan:
    """Return the contacts of some frames."""
    if isinstance(contacts, LibraryPoses):
        return replace(contacts, own=part_of(contacts.own, start, stop), poses=contacts.poses[start:stop])
    return replace(contacts, poses=contacts.poses[start:stop], placements=contacts.placements[start:stop])
