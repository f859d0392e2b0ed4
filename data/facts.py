"""What readers of a generated domain know of its gel, camera and gauge: whoever made it wrote it into the manifest."""

from typing import Any

from gelgap.assets.pinhole import Pinhole
from gelgap.assets.settings import Settings
from gelgap.data.random_stream import random_stream


class DomainFacts(Settings):
    """Facts of one domain, as its manifest has them in the field `facts`.

    `mount_stiffness_n_per_mm` is None where the rig does not yield, `force_bias_n` where the force gauge is right.
    `traction_half_extent_mm` says how far from the sensor's centre the cells of the column `traction` reach along x, y.
    """

    young_modulus_mpa: float
    poisson_ratio: float
    thickness_mm: float
    friction: float
    static_friction: float | None
    mount_stiffness_n_per_mm: float | None
    shows_markers: bool
    force_bias_n: tuple[float, float, float] | None
    camera: Pinhole
    traction_half_extent_mm: tuple[float, float] | None

    @classmethod
    def of(cls, manifest: dict[str, Any]) -> "DomainFacts":
        """Return what a manifest states; one written up to gelgap 0.3.0 states it in its configuration alone.

        Raises
        ------
        KeyError, ValueError
            If it states neither.
        """
        if "facts" in manifest:
            return cls(**manifest["facts"])
        configuration = manifest["configuration"]
        gel, sensor = configuration["elastomer"], configuration["sensor"]
        bias_n = configuration["acquisition"]["force_bias_n"]
        drawn_for = configuration["inpainted_from"] or configuration["name"]
        unit = random_stream(configuration["seed"], drawn_for, "acquisition").standard_normal(8)[5:]
        return cls(
            young_modulus_mpa=gel["young_modulus_mpa"],
            poisson_ratio=gel["poisson_ratio"],
            thickness_mm=gel["thickness_mm"],
            friction=gel["friction"],
            static_friction=gel.get("static_friction"),
            mount_stiffness_n_per_mm=gel.get("mount_stiffness_n_per_mm"),
            shows_markers=configuration["markers"]
            and (sensor["markers"]["layout"] != "none" or "flat_field" in sensor),
            force_bias_n=tuple((bias_n * unit).tolist()) if bias_n else None,
            camera=Pinhole(**{name: sensor["camera"][name] for name in Pinhole.model_fields}),
            traction_half_extent_mm=None,
        )


def unseen_differences(source: str, one: DomainFacts, target: str, other: DomainFacts) -> list[str]:
    """Return what no picture shows of the gap between two domains, each by name and facts, in sentences.

    A camera sees the membrane. Two gels with the same membrane and other forces cannot be told apart by it, whatever
    the network and however it is adapted: only labels of the target can.
    """
    notes = []
    if one.young_modulus_mpa != other.young_modulus_mpa:
        ratio = other.young_modulus_mpa / one.young_modulus_mpa
        note = (
            f"modulus {one.young_modulus_mpa:g} and {other.young_modulus_mpa:g} MPa: the same dent takes × {ratio:.3g} "
            f"the force on {target}"
        )
        if {one.mount_stiffness_n_per_mm, other.mount_stiffness_n_per_mm} != {None}:
            note += "; how far the rig yields only makes its dents shallower or deeper"
        notes.append(note)
    if (one.thickness_mm, one.poisson_ratio) != (other.thickness_mm, other.poisson_ratio):
        notes.append(
            f"thickness {one.thickness_mm:g} and {other.thickness_mm:g} mm, Poisson's ratio {one.poisson_ratio:g} and "
            f"{other.poisson_ratio:g}: the same dent takes another force, and only the bulge around it looks different"
        )
    if _friction(one) != _friction(other):
        notes.append(
            f"friction {_friction(one)} and {_friction(other)}: as long as a contact sticks, no picture shows how much "
            "shear it would bear; where one gel slips and the other sticks, shear differs"
        )
    bare = [name for name, facts in ((source, one), (target, other)) if not facts.shows_markers]
    if bare:
        notes.append(
            f"no markers on {' and '.join(bare)}: a single picture shows shear only in how the dent and its shading "
            "lean; how far the dent has moved is seen from first touch on (input touch, needs trajectories)"
        )
    if other.force_bias_n:
        bias = ", ".join(f"{value:.2g}" for value in other.force_bias_n)
        notes.append(f"the force gauge of {target} is off by ({bias}) N, which no picture shows")
    return notes


def _friction(facts: DomainFacts) -> str:
    static = f" (static {facts.static_friction:g})" if facts.static_friction else ""
    return f"{facts.friction:g}{static}"
