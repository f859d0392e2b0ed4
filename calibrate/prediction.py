"""Marked presses drawn with a fitted sensor, of balls and of other bodies, beside their pictures where there are some.

A ball's membrane is that of the calibration, another body's is solved. Nothing of a press's picture is used but the
place of a contact that is not marked.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gelgap import sim
from gelgap.assets.image_file import read_image
from gelgap.calibrate.light import SeenPoints
from gelgap.calibrate.membranes import CALIBRATION_GEL, sphere_profiles
from gelgap.calibrate.pictures import (
    ListedPress,
    PressList,
    PressPicture,
    check_press,
    read_press_list,
)
from gelgap.calibrate.poses import (
    LEAST_DOTS,
    SCORED_RADII,
    expected_from_mark,
    found_dots,
    located,
    radii_away,
    start_pose,
)
from gelgap.calibrate.profiles import PressProfiles
from gelgap.calibrate.residual import holds_for, residual_around
from gelgap.render import MembraneRenderer, Sensor
from gelgap.render.flat_field import load_maps
from gelgap.render.imaging import psnr_db, srgb_encode
from gelgap.render.normal_table import NormalTable
from gelgap.sim.indenter import Indenter

_BEYOND_VIEW = 1.3
Levels = tuple[float, float]
Membrane = tuple[np.ndarray, np.ndarray, np.ndarray]  # x_mm, y_mm, displacement_mm


@dataclass(frozen=True)
class PredictedPress:
    """A press as drawn, uint8 (h, w, 3); its real picture and PSNR in dB inside the contact and around it, if known.

    `table` is what the fit's table of normals predicts of the same membrane. Another ball than the fit's, or another
    body, is drawn without the sensor's `ball_residual`.

    Around a ball's contact is from one to two radii; around another body's as far as a disc of its area has radius.
    """

    name: str
    picture: np.ndarray = field(repr=False)
    real: np.ndarray | None = field(repr=False)
    predicted: Levels | None
    table: Levels | None  # of normals, if the fit has one
    unchanged: Levels | None
    has_residual: bool = False


def predict_presses(
    sensor: Sensor, path: Path, reference: Path | None = None, quality: str = "draft"
) -> list[PredictedPress]:
    """Draw the presses of a list in TOML, with a `reference` or the list's to be scored against, else the sensor's own.

    A press has `sphere_diameter_mm` as in a calibration, or `indenter` (what `load_indenter` takes; files beside the
    list) with `depth_mm`, a place and perhaps `turn_deg` and `shear_mm`. Balls marked by centre and radius are moved by
    the sensor's `marks_off`.

    Raises
    ------
    FileNotFoundError
        If a file does not exist.
    ValueError
        If the list has no presses, a picture another size than the fit, a body is unknown, or a press cannot be.
    RuntimeError
        If a contact does not converge.
    """
    if sensor.illumination is None:
        raise ValueError(f"sensor {sensor.name!r} has no LEDs of its own: to predict, give a fitted one")
    listed = read_press_list(path)
    untouched, presses = _pictures(sensor, listed, path.parent, reference)
    renderer = MembraneRenderer(sensor, sensor.illumination, untouched.shape[1::-1], quality)
    untouched = renderer.reference() if not untouched.any() else untouched
    bodies = [
        _body(press, own, path.parent, quality) for press, own in zip(listed.presses, presses, strict=True)
    ]
    diameters = {own.sphere_diameter_mm for own, body in zip(presses, bodies, strict=True) if body is None}
    profiles = sphere_profiles(diameters, quality=quality)
    found = []
    for listed_press, press, body in zip(listed.presses, presses, bodies, strict=True):
        try:
            if body is None:
                drawn = _of_ball(renderer, press, profiles[press.sphere_diameter_mm], untouched)
            else:
                drawn = _of_body(renderer, listed_press, press, body, quality)
            real = press.picture if listed_press.picture else None
            found.append(_scored(renderer, press.name, *drawn, real, untouched))
        except ValueError as error:
            raise ValueError(f"{path}: {press.name}: {error}") from None
    return found


def _pictures(
    sensor: Sensor, listed: PressList, folder: Path, reference: Path | None
) -> tuple[np.ndarray, list[PressPicture]]:
    """Return the untouched picture (black if none is given) and the presses, black without a picture, of one size."""
    reference = reference or (folder / listed.reference if listed.reference else None)
    files = [folder / press.picture if press.picture else None for press in listed.presses]
    pictures = {file: read_image(file) for file in (reference, *files) if file is not None}
    fitted = None if sensor.flat_field is None else load_maps(sensor.flat_field).ratio.shape
    if fitted is None and not pictures:
        raise ValueError(
            f"sensor {sensor.name!r} has no flat field, which would say how large its pictures are: give --reference"
        )
    shape = fitted or next(iter(pictures.values())).shape
    for file, picture in pictures.items():
        if picture.shape != shape:
            raise ValueError(
                f"{file} is a picture of {picture.shape[1]}×{picture.shape[0]} px, and the fit is of "
                f"{shape[1]}×{shape[0]} px; they must come from the same camera"
            )
    black = np.zeros(shape, np.uint8)
    presses = [
        press.as_picture(black if file is None else pictures[file], f"press {number} ({press.label})")
        for number, (press, file) in enumerate(zip(listed.presses, files, strict=True), start=1)
    ]
    return pictures.get(reference, black), presses


def _body(listed: ListedPress, press: PressPicture, folder: Path, quality: str) -> Indenter | None:
    """Return a press's body, None for a ball, once the press is known to be one that can be."""
    ball, name = press.sphere_diameter_mm is not None, press.name
    if ball == (listed.indenter is not None):
        raise ValueError(f"{name} must have either sphere_diameter_mm or indenter")
    if ball and any(listed.turn_deg + listed.shear_mm):
        raise ValueError(f'{name}: turn_deg and shear_mm are for an indenter, as one of shape = "sphere"')
    has_place = press.has_place or (ball and listed.picture is not None)
    if not has_place or press.has_rough_marks:
        raise ValueError(f"{name} must have point_mm, or center_px with marks_off_px of at most 10")
    if ball:
        check_press(press.picture.shape, name, press)
        return None
    if press.depth_mm is None or press.radius_px is not None:
        raise ValueError(f"{name} must have depth_mm, and no radius_px, which only a ball leaves")
    try:
        file = str(folder / listed.indenter) if "." in listed.indenter else listed.indenter
        body = sim.load_indenter(file)
        sim.plan_solves(CALIBRATION_GEL, body, sim.PosePath("press", (_pose(listed, (0.0, 0.0)),)), quality)
    except (ValueError, FileNotFoundError) as error:
        raise type(error)(f"{name}: {error}") from None
    return body


def _pose(listed: ListedPress, point_mm: Sequence[float]) -> sim.Pose:
    roll_x_deg, roll_y_deg, twist_deg = listed.turn_deg
    (x_mm, y_mm), (shear_x_mm, shear_y_mm) = map(float, point_mm), listed.shear_mm
    return sim.Pose(
        listed.depth_mm,
        shear_x_mm,
        shear_y_mm,
        point_x_mm=x_mm,
        point_y_mm=y_mm,
        roll_deg=(roll_x_deg, roll_y_deg),
        twist_deg=twist_deg,
    )


def _of_ball(
    renderer: MembraneRenderer, press: PressPicture, profiles: PressProfiles, untouched: np.ndarray
) -> tuple[Membrane, np.ndarray, np.ndarray | None]:
    """Return the membrane around a ball, by the sensor's habit, where its mark says it touches, and what fits leave."""
    camera, size_px, residual = renderer.sensor.camera, renderer.size_px, renderer.sensor.ball_residual
    press = located(press, untouched, camera)
    pose, radius_px = start_pose(camera, press, profiles, size_px)
    center_px = press.center_px or camera.project_px(np.array([*pose[:2], -pose[2]]), size_px) - 0.5
    if press.radius_px is not None and (off := renderer.sensor.marks_off) is not None:
        pose = expected_from_mark(pose, np.array(off), profiles)
    half_mm = _BEYOND_VIEW / 2 * np.array(camera.footprint_mm(size_px))
    membrane = profiles.membrane(tuple(pose[:2]), float(pose[2]), tuple(half_mm))
    radius_mm, left = profiles.contact_radius_mm(pose[2]), None
    if residual is not None and holds_for(residual, press.sphere_diameter_mm, radius_mm):
        plane_mm, camera_mm = camera.plane_of_picture_mm(size_px), np.array(camera.position_mm)
        seen = SeenPoints.pressed(plane_mm, np.zeros(len(plane_mm), int), pose[None], [profiles], camera_mm)
        contact = np.array([*pose[:2] / (camera.footprint_mm(size_px)[0] / 2), radius_mm])
        left = residual_around(residual, (seen.positions[:, :2] - pose[:2]) / radius_mm, contact)
    return membrane, radii_away(untouched, center_px, radius_px) < 1, left


def _of_body(
    renderer: MembraneRenderer, listed: ListedPress, press: PressPicture, body: Indenter, quality: str
) -> tuple[Membrane, np.ndarray, None]:
    """Return the membrane around a body, where it touches (h, w), and None for what fits leave around balls."""
    camera = renderer.sensor.camera
    point_mm = press.point_mm
    if point_mm is None:
        column, row = (np.array([value], float) for value in press.center_px)
        axis_mm = np.array(camera.position_mm[:2])
        nearer = 1 + press.depth_mm / camera.position_mm[2]  # the face stands nearer than the flat membrane
        point_mm = axis_mm + nearer * (camera.plane_points_mm(column, row, renderer.size_px)[0] - axis_mm)
    state = sim.solve_pose(CALIBRATION_GEL, body, _pose(listed, point_mm), quality)
    if not state.converged:
        raise RuntimeError(
            f"{press.name}: the contact does not converge; try another --quality, or less depth"
        )
    membrane = state.x_mm, state.y_mm, state.displacement_mm
    return membrane, renderer.contact_mask(*membrane, state.contact), None


def _scored(
    renderer: MembraneRenderer,
    name: str,
    membrane: Membrane,
    inside: np.ndarray,
    left: np.ndarray | None,
    real: np.ndarray | None,
    untouched: np.ndarray,
) -> PredictedPress:
    from scipy.ndimage import distance_transform_edt

    sensor, has_residual = renderer.sensor, left is not None
    code = 255 * srgb_encode(renderer.linear(*membrane))
    code += left.reshape(code.shape) if has_residual else 0.0
    picture = np.clip(np.round(code), 0, 255).astype(np.uint8)
    if real is None:
        return PredictedPress(name, picture, None, None, None, None, has_residual)
    if not inside.any():
        raise ValueError("the contact lies outside of the picture")
    away_px = distance_transform_edt(~inside)
    ring = ~inside & (away_px <= (SCORED_RADII - 1) * np.sqrt(inside.sum() / np.pi))
    dots = found_dots(untouched)
    clear = ~(dots | found_dots(real)) if dots.mean() > LEAST_DOTS else np.ones_like(inside)

    def levels(own: np.ndarray) -> Levels:
        return psnr_db(own, real, inside & clear), psnr_db(own, real, ring & clear)

    table = None
    if sensor.normal_table is not None:
        half_view_mm = sensor.camera.footprint_mm(renderer.size_px)[0] / 2
        own = NormalTable(np.array(sensor.normal_table), half_view_mm)
        table = levels(own.picture(untouched, renderer.normal_map(*membrane), sensor.camera))
    return PredictedPress(name, picture, real, levels(picture), table, levels(untouched), has_residual)
