"""Presses of real spheres as a fit starts from them: where each is, how deep, and which of its pixels are looked at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gelgap.render.camera import Camera
from gelgap.render.contact_pixels import PressPicture, find_contact_mm, plane_points_mm
from gelgap.render.far_field import FarField, plain_field
from gelgap.render.imaging import srgb_encode
from gelgap.render.inpainting import detect_markers, inpaint_telea
from gelgap.render.light_fit import (
    DARK,
    SATURATED,
    Geometry,
    Light,
    Samples,
    flat_geometry,
    predicted_codes,
)
from gelgap.render.press_profiles import PressProfiles

# Pixels of each press: inside the contact, from one to two radii, and from two to REACH.
SAMPLES = (220, 260, 120)
REACH = 4.5
MODELLED_MM = 5.5
SCORED_RADII = 2.0
_FOUND_SIGMA_MM = 0.5
_KNOWN_DEPTH_SIGMA_MM = 0.05
_MARKED_DEPTH_SIGMA = 0.1 / 3  # radii of the sphere per pixel that the mark may be off
_ROUGH_PX, LARGEST_MARKS_OFF_PX = 10.0, 100.0
# Where rough marks say nothing of the depth, in radii of the sphere.
_UNKNOWN_DEPTH, _UNKNOWN_DEPTH_SIGMA = 0.6, 0.4
_LEAST_CHANGE = 2.0  # code values
_LEAST_SPREAD = 0.2  # of all presses, in radii of the largest mark
_MOST_SATURATED, _LEAST_USABLE = 0.95, 0.05  # shares of values


@dataclass(frozen=True)
class PlacedPresses:
    """Presses and their pictures with a start for each one's pose."""

    camera: Camera
    reference: np.ndarray  # uint8 (h, w, 3)
    presses: tuple[PressPicture, ...]  # each with a place
    names: tuple[str, ...]
    poses_mm: np.ndarray  # (n, 3): x, y, depth
    sigma_mm: np.ndarray  # (n, 3): how far each may be off
    centers_px: np.ndarray  # (n, 2)
    radii_px: np.ndarray  # (n,)
    profiles: list[PressProfiles]
    has_dots: bool

    @property
    def size_px(self) -> tuple[int, int]:
        return self.reference.shape[1], self.reference.shape[0]

    @cached_property
    def pictures(self) -> list[np.ndarray]:
        return [press.picture for press in self.presses]

    def seen_from(self, distance_mm: float) -> "PlacedPresses":
        """Return the presses with the camera at another distance, from which it shows the same of the flat membrane."""
        if distance_mm == -self.camera.position_mm[2]:
            return self
        camera = self.camera.seen_from(distance_mm, self.size_px)
        poses = [
            _start(camera, press, profiles, self.size_px)[0]
            for press, profiles in zip(self.presses, self.profiles, strict=True)
        ]
        return replace(self, camera=camera, poses_mm=np.array(poses))

    @cached_property
    def clean_reference(self) -> np.ndarray:
        """The reference without dots, which the renderer draws itself."""
        if not self.has_dots:
            return self.reference
        return inpaint_telea(self.reference, detect_markers(self.reference))

    @cached_property
    def seen_profiles(self) -> list[PressProfiles]:
        """The membranes as blurred as the camera's point spread makes them."""
        softness_mm = self.camera.point_spread_px / 320 * self.camera.footprint_mm(self.size_px)[0]
        return [replace(profiles, softness_mm=softness_mm) for profiles in self.profiles]

    @cached_property
    def untouched(self) -> FarField:
        return plain_field(self.clean_reference)

    def samples(self, which: np.ndarray, field: FarField, scale_mm: float) -> Samples:
        """Draw pixels of presses, the same for a press each time; those on dots are not taken."""
        parts = [self._pixels(int(press)) for press in which]
        index = np.repeat(np.arange(len(which)), [len(rows) for rows, _ in parts])
        rows, columns = (np.concatenate(values) for values in zip(*parts, strict=True))
        code = np.concatenate([self.pictures[k][own] for k, own in zip(which, parts, strict=True)]).astype(
            float
        )
        base = np.concatenate(
            [field.base(*own, self.poses_mm[k, :2] / scale_mm) for k, own in zip(which, parts, strict=True)]
        )
        return Samples(
            index, rows, columns, plane_points_mm(self.camera, columns, rows, self.size_px), code, base
        )

    def _pixels(self, press: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng([7, press])
        (x, y), radius = self.centers_px[press], self.radii_px[press]
        bounds = zip((0, 1, 2), (1, 2, REACH), SAMPLES, strict=True)
        r = np.concatenate([radius * np.sqrt(rng.uniform(low**2, high**2, n)) for low, high, n in bounds])
        angle = rng.uniform(0, 2 * np.pi, len(r))
        columns = np.round(x + r * np.cos(angle)).astype(int)
        rows = np.round(y + r * np.sin(angle)).astype(int)
        width, height = self.size_px
        seen = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        rows, columns = rows[seen], columns[seen]
        if self.has_dots:
            clear = ~(self._dots(press)[rows, columns] | self._dots(None)[rows, columns])
            rows, columns = rows[clear], columns[clear]
        return rows, columns

    def _dots(self, press: int | None) -> np.ndarray:
        return detect_markers(self.reference if press is None else self.pictures[press])

    @cached_property
    def _plane_mm(self) -> np.ndarray:
        rows, columns = (values.ravel() for values in np.indices(self.reference.shape[:2]))
        return plane_points_mm(self.camera, columns, rows, self.size_px)

    def picture_of(
        self,
        light: Light,
        field: FarField,
        press: int,
        pose_mm: np.ndarray,
        scale_mm: float,
        reach_mm: float = MODELLED_MM,
    ) -> np.ndarray:
        """Return the uint8 picture of a press: modelled around it, the untouched gel's beyond."""
        width, height = self.size_px
        rows, columns = (values.ravel() for values in np.indices((height, width)))
        base = field.base(rows, columns, pose_mm[:2] / scale_mm)
        codes = 255 * srgb_encode(base)
        plane = self._plane_mm
        near = np.hypot(*(plane - pose_mm[:2]).T) < reach_mm
        index = np.zeros(near.sum(), int)
        samples = Samples(index, rows[near], columns[near], plane[near], codes[near], base[near])
        camera_mm = np.array(self.camera.position_mm)
        pressed = Geometry(samples, pose_mm[None], [self.seen_profiles[press]], camera_mm)
        codes[near] = predicted_codes(light, samples, pressed, flat_geometry(samples).light(light))
        return np.clip(np.round(codes), 0, 255).astype(np.uint8).reshape(height, width, 3)

    def scores(self, press: int, predicted: np.ndarray) -> tuple[float, float]:
        """Return PSNR in dB inside the contact, and from one to two radii."""
        rows, columns = np.indices(predicted.shape[:2])
        distance = np.hypot(columns - self.centers_px[press, 0], rows - self.centers_px[press, 1])
        share = distance / self.radii_px[press]
        square = (predicted.astype(float) - self.pictures[press]) ** 2
        inside, ring = (
            np.mean(square[where]) for where in (share < 1, (share >= 1) & (share < SCORED_RADII))
        )
        return tuple(float(10 * np.log10(255**2 / max(value, 1e-9))) for value in (inside, ring))


def place_presses(
    camera: Camera,
    reference: np.ndarray,
    presses: Sequence[PressPicture],
    profiles: Mapping[float, PressProfiles],
) -> PlacedPresses:
    """Find where each press, already checked, is and how deep.

    Raises
    ------
    ValueError
        If no contact is found, or a sphere cannot reach its marked radius.
    """
    size_px = reference.shape[1], reference.shape[0]
    mm_per_px = camera.footprint_mm(size_px)[0] / size_px[0]
    names = _names(presses)
    located, poses, sigmas, centers, radii = [], [], [], [], []
    for name, given in zip(names, presses, strict=True):
        try:
            press = _located(given, reference, camera)
            pose, radius_px = _start(camera, press, profiles[press.sphere_diameter_mm], size_px)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        located.append(press)
        rim = np.array([*pose[:2], -pose[2]])
        center = press.center_px or camera.project_px(rim, size_px) - 0.5
        centers.append(np.array(center))
        poses.append(pose)
        radii.append(radius_px)
        sigmas.append(_sigmas_mm(given, mm_per_px))
    placed = PlacedPresses(
        camera,
        reference,
        tuple(located),
        names,
        np.array(poses),
        np.array(sigmas),
        np.array(centers),
        np.array(radii),
        [profiles[press.sphere_diameter_mm] for press in presses],
        has_dots=False,
    )
    _check_contacts(placed)
    # Few dark specks are dirt; dots are many.
    return replace(placed, has_dots=bool(detect_markers(reference).mean() > 0.01))


def rough_marks(press: PressPicture) -> bool:
    """Return whether a press's marks only say where its imprint is, not its contact's centre and edge."""
    return press.marks_off_px > _ROUGH_PX


def _sigmas_mm(press: PressPicture, mm_per_px: float) -> list[float]:
    """Return how far x, y and depth may be off."""
    rough, radius_mm = rough_marks(press), press.sphere_diameter_mm / 2
    if press.point_mm is None and (press.center_px is None or rough):
        aside = _FOUND_SIGMA_MM
    else:
        aside = press.marks_off_px * mm_per_px
    if press.depth_mm is not None:
        return [aside, aside, _KNOWN_DEPTH_SIGMA_MM]
    depth = _UNKNOWN_DEPTH_SIGMA if rough else _MARKED_DEPTH_SIGMA * press.marks_off_px
    return [aside, aside, depth * radius_mm]


def check_presses(reference: np.ndarray, presses: Sequence[PressPicture]) -> None:
    """Raise ValueError for a reference or presses that no light can be fitted to.

    That is a picture of another size, a depth, radius or sphere that cannot be, a reference that is dark or saturated.
    """
    share = (reference >= SATURATED).mean(axis=(0, 1))
    if share.max() > _MOST_SATURATED:
        channel = ("red", "green", "blue")[int(share.argmax())]
        raise ValueError(
            f"the reference is saturated in {100 * share.max():.0f} % of its {channel} channel; expose it less"
        )
    if (reference > DARK).mean() < _LEAST_USABLE:
        raise ValueError("the reference is dark; expose it more")
    for name, press in zip(_names(presses), presses, strict=True):
        _check(name, press, reference)


def _names(presses: Sequence[PressPicture]) -> tuple[str, ...]:
    return tuple(press.name or f"press {number}" for number, press in enumerate(presses, start=1))


def _check(name: str, press: PressPicture, reference: np.ndarray) -> None:
    if press.picture.shape != reference.shape:
        raise ValueError(
            f"{name} is a picture of {press.picture.shape[1]}×{press.picture.shape[0]} px, and the reference of "
            f"{reference.shape[1]}×{reference.shape[0]} px; they must come from the same camera"
        )
    if (press.depth_mm is None) == (press.radius_px is None):
        raise ValueError(f"{name} must have either depth_mm or radius_px")
    diameter_mm = press.sphere_diameter_mm
    if diameter_mm is not None and diameter_mm <= 0:
        raise ValueError(f"{name}: sphere_diameter_mm is {diameter_mm}; it must be greater than 0")
    known = press.depth_mm is not None and diameter_mm is not None
    if known and not 0 < press.depth_mm < diameter_mm / 2:
        raise ValueError(
            f"{name}: depth_mm is {press.depth_mm}; it must lie between 0 and the sphere's radius, "
            f"{diameter_mm / 2}"
        )
    if press.radius_px is not None and not 2 <= press.radius_px <= max(reference.shape):
        raise ValueError(f"{name}: radius_px is {press.radius_px}; it must lie in 2…{max(reference.shape)}")
    if not 0 < press.marks_off_px <= LARGEST_MARKS_OFF_PX:
        raise ValueError(
            f"{name}: marks_off_px is {press.marks_off_px}; it must lie in 0…{LARGEST_MARKS_OFF_PX:g}"
        )


def _located(press: PressPicture, reference: np.ndarray, camera: Camera) -> PressPicture:
    """Return the press with the centre of its imprint, found in the picture unless it is known well."""
    if press.point_mm is not None or (press.center_px is not None and not rough_marks(press)):
        return press
    point = np.array([*find_contact_mm(press.picture, reference, camera), 0.0])
    center = camera.project_px(point, (reference.shape[1], reference.shape[0])) - 0.5
    return replace(press, center_px=tuple(center.tolist()))


def _start(
    camera: Camera, press: PressPicture, profiles: PressProfiles, size_px: tuple[int, int]
) -> tuple[np.ndarray, float]:
    """Return (x, y, depth) in mm and the contact's radius in pixels."""
    mm_per_px = camera.footprint_mm(size_px)[0] / size_px[0]
    depth, nearer = press.depth_mm, 1.0
    if depth is None and rough_marks(press):
        depth = min(_UNKNOWN_DEPTH * profiles.sphere_radius_mm, profiles.deepest_mm)
    if depth is None:
        for _ in range(3):
            # The marked circle is the contact's edge, which stands nearer to the camera than the flat membrane.
            contact_mm = press.radius_px * mm_per_px * nearer
            depth = profiles.depth_mm(contact_mm)
            nearer = _nearer(camera, profiles, depth, contact_mm)
        radius_px = press.radius_px
    else:
        if depth > profiles.deepest_mm + 0.05:
            raise ValueError(
                f"depth_mm is {depth}; the membrane around a sphere of radius {profiles.sphere_radius_mm:g} mm is "
                f"solved down to {profiles.deepest_mm:.2f} mm"
            )
        contact_mm = profiles.contact_radius_mm(depth)
        nearer = _nearer(camera, profiles, depth, contact_mm)
        radius_px = press.radius_px or contact_mm / mm_per_px
    if press.point_mm is not None:
        point = np.array(press.point_mm, float)
    else:
        columns, rows = (np.array([value], float) for value in press.center_px)
        axis = np.array(camera.position_mm[:2])
        point = axis + nearer * (plane_points_mm(camera, columns, rows, size_px)[0] - axis)
    return np.array([*point, min(depth, profiles.deepest_mm)]), float(radius_px)


def _nearer(camera: Camera, profiles: PressProfiles, depth_mm: float, contact_mm: float) -> float:
    """Return the distance of a contact's edge from the camera over that of the flat membrane."""
    radius = profiles.sphere_radius_mm
    edge = depth_mm - radius + np.sqrt(max(radius**2 - min(contact_mm, 0.99 * radius) ** 2, 0))
    return 1 + edge / camera.position_mm[2]


def _check_contacts(placed: PlacedPresses) -> None:
    spread_px = np.ptp(placed.centers_px, axis=0).max()
    if spread_px < _LEAST_SPREAD * placed.radii_px.max():
        raise ValueError(
            f"all presses lie within {spread_px:.0f} px of each other; press at places spread over the view"
        )
    rows, columns = np.indices(placed.reference.shape[:2])
    for name, picture, (x, y), radius in zip(
        placed.names, placed.pictures, placed.centers_px, placed.radii_px, strict=True
    ):
        inside = np.hypot(columns - x, rows - y) < radius
        if not inside.any():
            raise ValueError(f"{name}: its centre lies outside of the picture; no contact was found in it")
        readable = (picture[inside] > DARK) & (picture[inside] < SATURATED)
        if readable.mean() < _LEAST_USABLE:
            raise ValueError(f"{name} is dark or saturated inside of its contact; expose it otherwise")
        change = np.abs(picture[inside].astype(float) - placed.reference[inside]).mean()
        if change < _LEAST_CHANGE:
            raise ValueError(f"{name} hardly differs from the reference; no contact was found in it")
