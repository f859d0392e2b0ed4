"""A scene: an elastomer under an indenter, how finely it is solved, and which poses may share a solution."""

from dataclasses import dataclass

from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.base import Indenter
from gelgap.sim.material import Moduli
from gelgap.sim.path import Pose
from gelgap.sim.problem import ContactProblem, PadEdges, Waypoint
from gelgap.sim.quality import quality_named

# A gel of this modulus is solved for all: at fixed friction, geometry and mount over modulus, forces scale with it.
_SHARED_MODULUS_MPA = 0.3
_DEEPEST_THICKNESSES = 0.6


@dataclass(frozen=True)
class Sharing:
    """Which poses may share a solution; each kind of sharing can be switched off.

    `modulus`: one solve serves every Young's modulus. `translation`: interior points share theirs; under a body of
    revolution directions are then rotations of each other, and half the gel is enough. `reflection`: on a small pad,
    mirrored points and directions share theirs. `path`: poses at one point share descents, off which drags branch at
    their depths. `cache`: solutions are kept on disk.
    """

    modulus: bool = True
    translation: bool = True
    reflection: bool = True
    path: bool = True
    cache: bool = True


@dataclass(frozen=True)
class Scene:
    """What all poses of a plan have in common."""

    elastomer: Elastomer
    indenter: Indenter
    quality: str
    sharing: Sharing

    def check(self, pose: Pose) -> None:
        """Raise ValueError if a pose lies off the pad, or deeper or further sideways than can be solved."""
        gel, indenter = self.elastomer, self.indenter
        for name, size in zip(("point_x_mm", "point_y_mm"), gel.pad_size_mm, strict=True):
            value, half = getattr(pose, name), size / 2
            if abs(value) > half:
                raise ValueError(f"{name} = {value:g}: lies off the pad, must be in [{-half:g}, {half:g}] mm")
        deepest = min(_DEEPEST_THICKNESSES * gel.thickness_mm, indenter.deepest_mm)
        if pose.depth_mm > deepest:
            raise ValueError(
                f"depth_mm = {pose.depth_mm:g}: must be in [0, {deepest:g}] mm, at most {_DEEPEST_THICKNESSES:g} of "
                f"the pad's thickness and {indenter.deepest_mm:g} mm for the indenter ({indenter.label})"
            )
        if pose.radius_mm > gel.thickness_mm:
            raise ValueError(
                f"shear = {pose.radius_mm:g} mm: must be at most the pad's thickness, {gel.thickness_mm:g} mm"
            )

    def problem(
        self, pad_mm: PadEdges | None, waypoints_mm: tuple[Waypoint, ...], parents: tuple[int, ...]
    ) -> ContactProblem:
        """Return the problem of waypoints, at the modulus that elastomers share; arguments as its fields."""
        gel, moduli = self.elastomer, self.elastomer.mujoco_moduli
        scale = _SHARED_MODULUS_MPA / gel.young_modulus_mpa if self.sharing.modulus else 1.0
        mount = gel.mount_stiffness_n_per_mm
        return ContactProblem(
            moduli=Moduli(round(moduli.young_modulus_mpa * scale, 12), moduli.poisson_ratio),
            friction=gel.friction,
            thickness_mm=gel.thickness_mm,
            indenter=self.indenter,
            mount_stiffness_n_per_mm=None if mount is None else round(mount * scale, 9),
            pad_mm=pad_mm,
            # Adding 0 turns −0, which would have another key, into 0.
            waypoints_mm=tuple(tuple(float(c) + 0.0 for c in point) for point in waypoints_mm),
            parents=parents,
            quality=quality_named(self.quality),
        )
