"""Where each press of a real sphere is, as a fit starts: place, depth, and which pixels are looked at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gelgap.calibrate.light import Light, SeenPoints, predicted_light
from gelgap.calibrate.pictures import (
    DARK,
    LEAST_USABLE,
    SATURATED,
    FarField,
    PressPicture,
    find_contact_mm,
    fit_gain,
    median_of_presses,
    press_names,
)
from gelgap.calibrate.profiles import PressProfiles
from gelgap.data.inpainting import detect_markers, inpaint_telea
from gelgap.render.flat_field import map_dots
from gelgap.render.imaging import Camera, psnr_db, srgb_decode, srgb_encode

# Pixels of each press: inside the contact, from one to two radii, and from two to REACH.
SAMPLES = (220, 260, 120)
REACH = 4.5
MODELLED_MM = 8.0
SCORED_RADII = 2.0
FEWEST_FOR_GAIN = 12
LEAST_DOTS = 0.01  # of a picture; fewer dark specks are dirt
_STEP_PX = 4
_FAR, _LOADED_BEYOND, _SOFTNESS = 3.0, 2.5, 0.5  # contact radii
_FOUND_SIGMA_MM = 0.5
_KNOWN_DEPTH_SIGMA_MM = 0.05
_MARKED_DEPTH_SIGMA = 0.1 / 3  # radii of the sphere per pixel that the mark may be off
# Where rough marks say nothing of the depth, in radii of the sphere.
_UNKNOWN_DEPTH, _UNKNOWN_DEPTH_SIGMA = 0.6, 0.4
LEAST_DEPTH_MM = 0.02
_LEAST_CHANGE = 2.0  # code values
_LEAST_SPREAD = 0.2  # of all presses, in radii of the largest mark


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
    has_dots: bool = False

    @property
    def size_px(self) -> tuple[int, int]:
        return self.reference.shape[1], self.reference.shape[0]

    @property
    def half_view_mm(self) -> float:
        return self.camera.footprint_mm(self.size_px)[0] / 2

    @property
    def mark_mm(self) -> np.ndarray:
        """(n,): radii of the marks on the flat membrane."""
        return self.radii_px * self.camera.footprint_mm(self.size_px)[0] / self.size_px[0]

    def seen_by(self, camera: Camera) -> "PlacedPresses":
        """Return the presses as another camera sees them, which shows the same of the flat membrane."""
        poses = [
            start_pose(camera, press, profiles, self.size_px)[0]
            for press, profiles in zip(self.presses, self.profiles, strict=True)
        ]
        return replace(self, camera=camera, poses_mm=np.array(poses))

    @cached_property
    def clean_reference(self) -> np.ndarray:
        """The reference without dots."""
        return inpaint_telea(self.reference, found_dots(self.reference)) if self.has_dots else self.reference

    @cached_property
    def dots(self) -> np.ndarray | None:
        """What dots leave of the light, (h, w, 3), where they are in the reference; None if it has none."""
        if not self.has_dots:
            return None
        bare = srgb_decode(self.clean_reference / 255)
        return np.clip(srgb_decode(self.reference / 255) / np.maximum(bare, 1e-4), 0, 2).astype(np.float32)

    @cached_property
    def seen_profiles(self) -> list[PressProfiles]:
        """The membranes as blurred as the camera's point spread makes them."""
        softness_mm = self.camera.point_spread_px / 320 * self.camera.footprint_mm(self.size_px)[0]
        return [replace(profiles, softness_mm=softness_mm) for profiles in self.profiles]

    @cached_property
    def untouched(self) -> FarField:
        """The field in which a press changes nothing."""
        return FarField(srgb_decode(self.clean_reference / 255), None, np.zeros((6, 3)))

    @cached_property
    def levels(self) -> np.ndarray:
        """(n, 3): by how much each picture is brighter than the reference far from its contact; 1 if nothing is far."""
        coarse = np.s_[::_STEP_PX, ::_STEP_PX]
        code = self.reference[coarse]
        good = ((code > 20) & (code < 245)).all(axis=2)
        untouched = srgb_decode(code / 255)
        levels = np.ones((len(self.presses), 3))
        for k, press in enumerate(self.presses):
            away = radii_away(self.reference, self.centers_px[k], self.radii_px[k])[coarse]
            far = good & (away > _FAR)
            if far.any():
                levels[k] = np.median(srgb_decode(press.picture[coarse][far] / 255) / untouched[far], axis=0)
        return levels

    def levelled(self, press: int) -> np.ndarray:
        """Return the linear picture of a press at the reference's level."""
        return srgb_decode(self.presses[press].picture / 255) / self.levels[press]

    def at_level(self, press: int, code: np.ndarray, field: FarField) -> np.ndarray:
        """Return code values of a picture without dots as a press changes it far away, with the reference's dots."""
        factor = self.levels[press] * (1 if field.loaded is None else field.loaded)
        return 255 * srgb_encode(srgb_decode(code / 255) * factor * (1 if self.dots is None else self.dots))

    def far_field(self, which: np.ndarray) -> FarField:
        """Return what some of the presses change where none reaches, from those parts of their pictures."""
        import cv2

        untouched = srgb_decode(self.clean_reference / 255)
        places = self.poses_mm[which, :2] / self.half_view_mm
        enough = len(which) >= FEWEST_FOR_GAIN
        gain = fit_gain(self.levels[which] - 1, places) if enough else np.zeros((6, 3))
        stack = np.empty((len(which), *self.reference.shape), np.float32)
        for layer, k in zip(stack, which, strict=True):
            layer[:] = self.levelled(k) / np.maximum(untouched, 1e-4)
            layer[radii_away(self.reference, self.centers_px[k], self.radii_px[k]) < _LOADED_BEYOND] = np.nan
        if self.has_dots:  # which move with the gel even where no light changes
            return FarField(untouched, None, gain)
        # Light is smooth. So is this then where presses drop out of the median, the fewer of which the less they count.
        share = np.isfinite(stack[..., :1]).mean(axis=0)
        loaded = 1 + share * (np.clip(median_of_presses(stack), 0.5, 2.0) - 1)
        softness_px = _SOFTNESS * float(np.median(self.radii_px[which]))
        loaded = cv2.GaussianBlur(loaded, (0, 0), softness_px)
        return FarField(untouched, loaded, gain)

    def samples(self, which: np.ndarray, field: FarField) -> tuple[np.ndarray, ...]:
        """Draw pixels of presses, the same for a press each time; those on dots are not taken.

        Return which press each is of (n,), the place that it sees on the flat membrane (n, 2) in mm, its code (n, 3),
        the untouched gel's linear light (n, 3) there, and what multiplies that while the press lasts.
        """
        parts = [self._pixels(int(press)) for press in which]
        index = np.repeat(np.arange(len(which)), [len(rows) for rows, _ in parts])
        rows, columns = (np.concatenate(values) for values in zip(*parts, strict=True))
        own = list(zip(which, parts, strict=True))
        code = np.concatenate([self.presses[k].picture[pixels] for k, pixels in own]).astype(float)
        light = [field.at(*pixels, self.levels[k]) for k, pixels in own]
        base = np.concatenate([own_base for own_base, _ in light])
        factor = np.concatenate([own_factor for _, own_factor in light])
        return index, self.camera.plane_points_mm(columns, rows, self.size_px), code, base, factor

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
        clear = self.clear_of_dots(press)[rows, columns]
        return rows[clear], columns[clear]

    def clear_of_dots(self, press: int) -> np.ndarray:
        """Return (h, w): where neither the picture of a press nor the reference has dots."""
        if not self.has_dots:
            return np.ones(self.reference.shape[:2], bool)
        return ~(found_dots(self.presses[press].picture) | found_dots(self.reference))

    @cached_property
    def _plane_mm(self) -> np.ndarray:
        return self.camera.plane_of_picture_mm(self.size_px)

    def seen(self, press: int, pose_mm: np.ndarray, pixels: np.ndarray | slice = np.s_[:]) -> SeenPoints:
        """Return what all pixels, or some of them, see of a press."""
        plane_mm, camera_mm = self._plane_mm[pixels], np.array(self.camera.position_mm)
        index, own = np.zeros(len(plane_mm), int), [self.seen_profiles[press]]
        return SeenPoints.pressed(plane_mm, index, pose_mm[None], own, camera_mm)

    def picture_of(
        self, light: Light, field: FarField, press: int, pose_mm: np.ndarray, reach_mm: float
    ) -> np.ndarray:
        """Return a press in code values (h, w, 3): modelled up to a distance, over one mm fading to untouched gel."""
        rows, columns = (values.ravel() for values in np.indices(self.reference.shape[:2]))
        base, factor = field.at(rows, columns, self.levels[press])
        share = np.clip(reach_mm + 1 - np.hypot(*(self._plane_mm - pose_mm[:2]).T), 0, 1)[:, None]
        near = share[:, 0] > 0
        pressed, flat = self.seen(press, pose_mm, near), SeenPoints.flat(self._plane_mm[near])
        lit = predicted_light(base[near], pressed.light(light), flat.light(light))
        base[near] += share[near] * (lit - base[near])
        if self.dots is not None:
            base *= self.dots.reshape(-1, 3)
            # Dots go where their points of the gel go.
            rest = self.camera.project_px(pressed.positions * (1, 1, 0), self.size_px) - 0.5
            moved = map_dots(self.dots, rest)
            base[near] *= moved / np.maximum(self.dots.reshape(-1, 3)[near], 1e-4)
        return 255 * srgb_encode(factor * base).reshape(self.reference.shape)

    def scores(self, press: int, predicted: np.ndarray) -> tuple[float, float]:
        """Return PSNR in dB inside the contact, and from one to two radii, of pixels without dots."""
        share = radii_away(predicted, self.centers_px[press], self.radii_px[press])
        real = self.presses[press].picture
        clear = self.clear_of_dots(press)
        inside, ring = clear & (share < 1), clear & (share >= 1) & (share < SCORED_RADII)
        return psnr_db(predicted[inside], real[inside]), psnr_db(predicted[ring], real[ring])


def found_dots(picture: np.ndarray) -> np.ndarray:
    """Return the mask of a real sensor's dots, which may be pale."""
    return detect_markers(picture, least_contrast=0.1)


def radii_away(picture: np.ndarray, center_px: np.ndarray, radius_px: float) -> np.ndarray:
    """Return (h, w): each pixel's distance from a contact's centre, in its radii."""
    rows, columns = np.indices(picture.shape[:2])
    return np.hypot(columns - center_px[0], rows - center_px[1]) / radius_px


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
    names, own = press_names(presses), [profiles[press.sphere_diameter_mm] for press in presses]
    all_located, poses, sigmas, centers, radii = [], [], [], [], []
    for name, given, around in zip(names, presses, own, strict=True):
        try:
            press = located(given, reference, camera)
            pose, radius_px = start_pose(camera, press, around, size_px)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        all_located.append(press)
        rim = np.array([*pose[:2], -pose[2]])
        centers.append(np.array(press.center_px or camera.project_px(rim, size_px) - 0.5))
        poses.append(pose)
        radii.append(radius_px)
        sigmas.append(_sigmas_mm(given, camera.footprint_mm(size_px)[0] / size_px[0]))
    placed = PlacedPresses(
        camera,
        reference,
        tuple(all_located),
        names,
        poses_mm=np.array(poses),
        sigma_mm=np.array(sigmas),
        centers_px=np.array(centers),
        radii_px=np.array(radii),
        profiles=own,
    )
    _check_contacts(placed)
    return replace(placed, has_dots=bool(found_dots(reference).mean() > LEAST_DOTS))


def _sigmas_mm(press: PressPicture, mm_per_px: float) -> list[float]:
    """Return how far x, y and depth may be off."""
    aside = press.marks_off_px * mm_per_px if press.has_place else _FOUND_SIGMA_MM
    if press.depth_mm is not None:
        return [aside, aside, _KNOWN_DEPTH_SIGMA_MM]
    depth = _UNKNOWN_DEPTH_SIGMA if press.has_rough_marks else _MARKED_DEPTH_SIGMA * press.marks_off_px
    return [aside, aside, depth * press.sphere_diameter_mm / 2]


def located(press: PressPicture, reference: np.ndarray, camera: Camera) -> PressPicture:
    """Return the press with the centre of its imprint, found in the picture unless it is known well."""
    if press.has_place:
        return press
    point = np.array([*find_contact_mm(press.picture, reference, camera), 0.0])
    center = camera.project_px(point, (reference.shape[1], reference.shape[0])) - 0.5
    return replace(press, center_px=tuple(center.tolist()))


def start_pose(
    camera: Camera, press: PressPicture, profiles: PressProfiles, size_px: tuple[int, int]
) -> tuple[np.ndarray, float]:
    """Return (x, y, depth) in mm and the contact's radius in pixels."""
    mm_per_px = camera.footprint_mm(size_px)[0] / size_px[0]
    radius_px = press.radius_px
    if press.depth_mm is None and not press.has_rough_marks:
        nearer = 1.0
        for _ in range(3):
            # The marked circle is the contact's edge, which stands nearer to the camera than the flat membrane.
            contact_mm = radius_px * mm_per_px * nearer
            depth = profiles.depth_mm(contact_mm)
            nearer = _nearer(camera, profiles, depth, contact_mm)
    elif press.depth_mm is not None and press.depth_mm > profiles.deepest_mm + 0.05:
        raise ValueError(
            f"depth_mm is {press.depth_mm}; the membrane around a sphere of radius {profiles.sphere_radius_mm:g} mm is "
            f"solved down to {profiles.deepest_mm:.2f} mm"
        )
    else:
        depth = press.depth_mm or min(_UNKNOWN_DEPTH * profiles.sphere_radius_mm, profiles.deepest_mm)
        contact_mm = profiles.contact_radius_mm(depth)
        nearer = _nearer(camera, profiles, depth, contact_mm)
    if press.point_mm is not None:
        point = np.array(press.point_mm, float)
    else:
        columns, rows = (np.array([value], float) for value in press.center_px)
        axis = np.array(camera.position_mm[:2])
        point = axis + nearer * (camera.plane_points_mm(columns, rows, size_px)[0] - axis)
    return np.array([*point, min(depth, profiles.deepest_mm)]), float(radius_px or contact_mm / mm_per_px)


def expected_from_mark(pose_mm: np.ndarray, marks_off: np.ndarray, profiles: PressProfiles) -> np.ndarray:
    """Return (3,) where a ball marked at x, y, depth is, by a sensor's `marks_off`."""
    unit_mm = np.array([1.0, 1.0, profiles.sphere_radius_mm])
    moved = pose_mm + unit_mm * (np.r_[1.0, pose_mm / unit_mm] @ marks_off)
    return np.array([*moved[:2], np.clip(moved[2], LEAST_DEPTH_MM, profiles.deepest_mm)])


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
    for name, press, *mark in zip(
        placed.names, placed.presses, placed.centers_px, placed.radii_px, strict=True
    ):
        picture, inside = press.picture, radii_away(press.picture, *mark) < 1
        if not inside.any():
            raise ValueError(f"{name}: its centre lies outside of the picture; no contact was found in it")
        readable = (picture[inside] > DARK) & (picture[inside] < SATURATED)
        if readable.mean() < LEAST_USABLE:
            raise ValueError(f"{name} is dark or saturated inside of its contact; expose it otherwise")
        change = np.abs(picture[inside].astype(float) - placed.reference[inside]).mean()
        if change < _LEAST_CHANGE:
            raise ValueError(f"{name} hardly differs from the reference; no contact was found in it")
