"""A simulated sensor in a loop: the indenter's place in, picture and force out, each step from a library of poses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.assets.names import one_line
from gelgap.data.formats.pictures import encode_png
from gelgap.render import Illumination, MembraneRenderer, Sensor
from gelgap.sim import Elastomer, LibraryPlan, MembraneState, Pose, PoseLibrary, PoseRanges, Sphere
from gelgap.sim.indenter import Indenter
from gelgap.sim.library import solve_all
from gelgap.sim.problem import QualityName

# A contact slides as a whole where a longer drag would raise its sideways force by less than this share.
_SLIDES_WITHIN = 0.03


@dataclass(frozen=True, eq=False)
class Reading:
    """What a step gives.

    `picture` is uint8 (h, w, 3), None if the membrane folds, so that no camera sees it as it is. `force_n` (3,) is that
    of the indenter on the sensor, `force_error_n` (3,) estimates of its error, as standard deviations. `state` is the
    membrane with its contact. `flags` are words: `slides` (the contact as a whole), `extrapolated` (less deep than the
    library), `coarse`, `folded`, `not converged`.
    """

    picture: NDArray[np.uint8] | None
    force_n: NDArray[np.float64]
    force_error_n: NDArray[np.float64]
    state: MembraneState
    flags: tuple[str, ...]

    def __repr__(self) -> str:
        pairs = zip(self.force_n, self.force_error_n, strict=True)
        force = ", ".join(f"{value:+.3f} ± {error:.3f}" for value, error in pairs)
        return f"Reading(force ({force}) N{''.join(f', {flag}' for flag in self.flags)})"

    def _repr_png_(self) -> bytes | None:
        """Return the picture, which notebooks show."""
        return None if self.picture is None else encode_png(self.picture)


class TactileSensor:
    """A gel, an indenter and a camera: `step` moves the indenter and returns a `Reading`, in some milliseconds.

    The first use of a gel solves its library of poses, once: a few solves, which are cached.

    Friction remembers where the indenter touched the gel: the anchor. A reading is that of a straight drag from the
    anchor to where the indenter is. Where that drag slides as a whole, the anchor is dragged along; where the indenter
    leaves the gel, it is forgotten. So sticking, sliding at μ times the pressure, and the loop of a reversed drag
    are honoured; what is not is the partial slip before a reversal, and what a press sideways and deeper at once leaves
    in the gel (docs/data.md has the errors on loops).

    Parameters
    ----------
    elastomer, indenter
        What is pressed, and by what: a body of revolution.
    sensor, illumination
        What looks, by name, file or as settings; by default its own LEDs light it, or i0.
    deepest_mm, farthest_mm
        How deep, and how far from the anchor, the indenter can go.
    size_px, quality
        Width and height of pictures; quality of physics and pictures.
    markers
        Whether the sensor's markers are there.
    noise_seed
        Seed of the camera's noise; none: no noise.

    Raises
    ------
    ValueError
        If a setting is unknown, the body not one of revolution, or the gel cannot be pressed so deep or dragged so far.
    """

    def __init__(
        self,
        elastomer: Elastomer | str,
        indenter: Indenter | None = None,
        sensor: Sensor | str = "paper",
        illumination: Illumination | str | None = None,
        *,
        deepest_mm: float = 1.0,
        farthest_mm: float = 0.6,
        size_px: tuple[int, int] = (320, 240),
        quality: QualityName = "draft",
        markers: bool = True,
        noise_seed: int | None = None,
    ) -> None:
        self.elastomer = Elastomer.named(elastomer)
        sensor = Sensor.named(sensor)
        light = sensor.lit_by(illumination)
        sensor.markers.check_on_pad(self.elastomer.pad_size_mm)
        ranges = PoseRanges(deepest_mm / 8, deepest_mm, farthest_mm)
        plan = LibraryPlan(self.elastomer, indenter or Sphere(), ranges, quality)
        self.library: PoseLibrary = plan.served_by(solve_all(plan.solves))
        self.renderer = MembraneRenderer(sensor, light, size_px, quality)
        self.markers = markers
        self._rng = None if noise_seed is None else np.random.default_rng(noise_seed)
        self._slides_from_mm = _sliding_travels(self.library)
        self.reset()

    __repr__ = one_line

    def reset(self) -> None:
        """Lift the indenter off the gel, which forgets the contact."""
        self._anchor_mm: NDArray[np.float64] | None = None

    def step(
        self, depth_mm: float, shear_mm: Sequence[float] = (0.0, 0.0), point_mm: Sequence[float] = (0.0, 0.0)
    ) -> Reading:
        """Move the indenter to `depth_mm` at `point_mm` + `shear_mm`; where there was no contact, down at `point_mm`.

        Raises
        ------
        ValueError
            If the library does not reach the place: too deep, too far from the anchor without sliding, or too near
            the pad's edge. The sensor stays as it was.
        """
        if np.shape(shear_mm) != (2,) or np.shape(point_mm) != (2,):
            raise ValueError(f"shear_mm = {shear_mm}, point_mm = {point_mm}: each must be (x, y) in mm")
        place_mm = np.asarray(point_mm, float) + np.asarray(shear_mm, float)
        anchor_mm = np.array(point_mm, float) if self._anchor_mm is None else self._anchor_mm
        drag_mm = place_mm - anchor_mm
        flags = []
        length_mm = math.hypot(*drag_mm)
        shallowest_mm = self.library.depths_mm[0]
        reaches_mm = float(np.interp(depth_mm, self.library.depths_mm, self._slides_from_mm))
        reaches_mm *= min(depth_mm / shallowest_mm, 1.0)
        if depth_mm > 0 and length_mm > reaches_mm:
            flags.append("slides")
            drag_mm = drag_mm * (reaches_mm / length_mm)
            anchor_mm = place_mm - drag_mm
        pose = Pose(depth_mm, *(drag_mm if depth_mm > 0 else (0.0, 0.0)), *anchor_mm)
        lattice = self.renderer.lattice
        state = self.library.state(self.elastomer, pose, axes_mm=(lattice.x_mm, lattice.y_mm))
        self._anchor_mm = anchor_mm if depth_mm > 0 else None
        diagnostics = state.diagnostics
        told = {
            "extrapolated": 0 < depth_mm < shallowest_mm,
            "coarse": diagnostics.coarse,
            "folded": diagnostics.folded,
            "not converged": not state.converged and not diagnostics.folded,
        }
        flags += [word for word, applies in told.items() if applies]
        membrane = state.x_mm, state.y_mm, state.displacement_mm
        picture = None if diagnostics.folded else self.renderer.picture(*membrane, self.markers, self._rng)
        return Reading(picture, state.force_n, np.array(diagnostics.force_error_n), state, tuple(flags))


def _sliding_travels(library: PoseLibrary) -> NDArray[np.float64]:
    """Return at each depth from which travel on the contact slides as a whole; infinite if it never does."""
    travels = []
    for depth, sideways_n in zip(library.depths_mm, library.numbers["force_n"][..., 0], strict=True):
        solved_mm = library.plan.travels_mm(depth)
        steps = np.linspace(0, solved_mm[-1], 200)
        force_n = np.interp(steps, solved_mm, np.abs(sideways_n))
        within = force_n >= (1 - _SLIDES_WITHIN) * force_n[-1]
        first = float(steps[np.argmax(within)])
        # A force that still rises at the end of the range is that of a contact that sticks.
        travels.append(first if first < 0.9 * solved_mm[-1] else math.inf)
    return np.array(travels)
