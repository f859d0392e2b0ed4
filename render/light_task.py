"""One fit's task: what fits of all presses or of a part of them have in common, and what they predict of others."""

from dataclasses import dataclass, replace

import numpy as np

from gelgap.render.far_field import FarField, far_field
from gelgap.render.flat_field import LOADED_BOUNDS, RATIO_BOUNDS, FlatFieldMaps
from gelgap.render.illumination import Illumination
from gelgap.render.imaging import srgb_decode
from gelgap.render.light_fit import CameraRange, LightFit
from gelgap.render.light_options import LightOptions
from gelgap.render.press_light import Bars
from gelgap.render.press_poses import SCORED_RADII, PlacedPresses
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.scattered import LARGEST, Scattered
from gelgap.render.sensor import Sensor

NEAREST_CAMERA_MM = 15.0
_MARGIN_MM = 0.5


@dataclass(frozen=True)
class HeldOut:
    """How a press that the fit had not seen was predicted, PSNR in dB: inside its contact, and from one to two radii.

    `marked` takes the press where it was marked or found; `corrected` moves it as the fitted presses were moved, and
    uses nothing of its picture either; `refined` moves its centre and depth in its own picture.
    """

    name: str
    unchanged: tuple[float, float]
    marked: tuple[float, float]
    corrected: tuple[float, float]
    refined: tuple[float, float]
    picture: np.ndarray  # uint8 (h, w, 3), predicted, refined


@dataclass(frozen=True)
class LightTask:
    """What every fit has in common, of all presses or of a part of them."""

    sensor: Sensor
    placed: PlacedPresses
    order: int
    degree: int
    far: bool
    shadows: bool
    keep_camera: bool = False

    @property
    def half_view_mm(self) -> float:
        return self.sensor.camera.footprint_mm(self.placed.size_px)[0] / 2

    @property
    def scale_mm(self) -> float:
        """The unit of places: how far apart the presses are, half of the view at most."""
        box_mm = np.ptp(self.placed.poses_mm[:, :2], axis=0).max() + 2 * _MARGIN_MM
        return min(self.half_view_mm, float(box_mm))

    def fit(self, which: np.ndarray, rounds: int = 3) -> tuple[LightFit, FarField]:
        """Fit the presses of the indices `which`."""
        placed, scale = self.placed, self.scale_mm
        poses = placed.poses_mm[which]
        field = placed.untouched
        if self.far:
            field = far_field(
                placed.reference,
                [placed.pictures[k] for k in which],
                placed.centers_px[which],
                placed.radii_px[which],
                poses[:, :2] / scale,
            )
        (x0, y0), (x1, y1) = poses[:, :2].min(0) - _MARGIN_MM, poses[:, :2].max(0) + _MARGIN_MM
        nearest_mm = 1.05 * self.half_view_mm
        options = LightOptions(
            self.order, self.degree, True, self.shadows, scale, (x0, x1, y0, y1), nearest_mm
        )
        fit = LightFit(
            options,
            placed.samples(which, field, scale),
            poses,
            [placed.seen_profiles[k] for k in which],
            placed.sigma_mm[which],
            Bars.of(self.sensor.illumination.leds, nearest_mm),
            np.array(self.sensor.camera.position_mm),
            None if self.keep_camera else self._camera_range(which),
        )
        fit.run(rounds)
        return fit, field

    def _camera_range(self, which: np.ndarray) -> CameraRange:
        """Return from where the camera may look: as near as it was given, or nearer than most, to nearly parallel."""
        camera = self.sensor.camera
        nearest_mm = min(NEAREST_CAMERA_MM, -camera.position_mm[2])
        bounds = 1 / camera.farthest_mm(self.placed.size_px), 1 / nearest_mm
        return CameraRange(bounds, lambda distance_mm: self.placed.seen_from(distance_mm).poses_mm[which])

    def seen_as(self, fit: LightFit) -> "LightTask":
        """Return the task with the camera where a fit has put it, as predictions of the fit need it."""
        placed = self.placed.seen_from(fit.distance_mm)
        return replace(self, sensor=self.sensor.model_copy(update={"camera": placed.camera}), placed=placed)

    def predicted(self, fit: LightFit, field: FarField, fitted: np.ndarray, press: int) -> HeldOut:
        """Predict a press under a light that was fitted to the presses of the indices `fitted`."""
        placed, scale = self.placed, self.scale_mm
        scored_mm = SCORED_RADII * placed.radii_px[press] * 2 * self.half_view_mm / placed.size_px[0]
        reach_mm = scored_mm + _MARGIN_MM
        corrected_mm = corrected_poses(placed.poses_mm, fitted, fit.presses)
        unseen = [
            placed.picture_of(fit.light, field, press, poses_mm[press], scale, reach_mm)
            for poses_mm in (placed.poses_mm, corrected_mm)
        ]
        refined = placed.picture_of(fit.light, field, press, self.refined_pose(fit, field, press), scale)
        scores = [placed.scores(press, picture) for picture in (placed.reference, *unseen, refined)]
        return HeldOut(placed.names[press], *scores, picture=refined)

    def unexplained(self, fit: LightFit, field: FarField, presses: np.ndarray) -> np.ndarray:
        """Return those presses that a light fitted without them leaves far out: one bad press can spoil others."""
        most = most_error(np.sqrt(fit.press_errors()))
        seen = self.seen_as(fit)
        errors = [seen.refined(fit, field, int(press)).rms_against_picture() for press in presses]
        return presses[np.array(errors) > most]

    def refined_pose(self, fit: LightFit, field: FarField, press: int) -> np.ndarray:
        """Return (3,): x, y and depth at which a fitted light explains a press's own picture best."""
        return self.refined(fit, field, press).presses[0]

    def refined(self, fit: LightFit, field: FarField, press: int) -> LightFit:
        """Return a fitted light with a press that is moved to where the light explains its picture best."""
        placed, which = self.placed, np.array([press])
        samples = placed.samples(which, field, self.scale_mm)
        start, sigma, profiles = placed.poses_mm[which], placed.sigma_mm[which], [placed.seen_profiles[press]]
        own = LightFit(fit.options, samples, start, profiles, sigma, fit.bars, fit.camera_mm)
        own.theta = fit.theta
        own.refine_presses(4)
        return own

    def lit_sensor(self, fit: LightFit) -> Sensor:
        """Return the start sensor under a fitted light, matt and without lens losses, which the flat field holds."""
        light, coating = fit.light, self.sensor.coating.model_copy(update={"specular": 0.0})
        camera = self.placed.seen_from(fit.distance_mm).camera.model_copy(update={"vignetting": 0.0})
        count, options, own = len(light.bars.azimuth), light.options, self.sensor.illumination
        linear = np.clip(light.theta[count:] / camera.exposure, -LARGEST, LARGEST)
        ambient, scattered = np.split(linear, [options.ambient_columns])
        ambient = np.pad(ambient, ((0, 3 - len(ambient)), (0, 0)))
        names = tuple(led.name for led in own.leds)
        leds = light.bars.leds(names, light.theta[:count], np.array(coating.albedo), camera.exposure)
        illumination = Illumination(
            name=own.name,
            leds=leds,
            scattered=Scattered(
                order=options.order,
                degree=options.degree if options.order else 0,
                coefficients=tuple(map(tuple, scattered.T.tolist())),
                ambient=tuple(map(tuple, ambient.T.tolist())),
                span_mm=tuple(map(float, options.span_mm)),
                scale_mm=options.scale_mm,
            ),
        )
        update = {"camera": camera, "coating": coating, "illumination": illumination, "flat_field": None}
        return self.sensor.model_copy(update=update)


def flat_field_maps(sensor: Sensor, placed: PlacedPresses, field: FarField) -> FlatFieldMaps:
    """Return what the real reference is, in units of the rendered one."""
    renderer = MembraneRenderer(sensor, sensor.illumination, placed.size_px)
    real = srgb_decode(placed.clean_reference / 255)
    rendered = renderer.reference_linear(markers=False)
    ratio = np.clip(real / np.maximum(rendered, np.maximum(0.2 * real, 1e-6)), *RATIO_BOUNDS)
    loaded = None if field.loaded is None else np.clip(field.loaded, *LOADED_BOUNDS).astype(np.float32)
    return FlatFieldMaps(ratio.astype(np.float32), loaded)


def corrected_poses(marked_mm: np.ndarray, fitted: np.ndarray, refined_mm: np.ndarray) -> np.ndarray:
    """Return marked poses (n, 3) moved as those of the fitted presses were: centres on average, depths by regression.

    Marked radii are so uncertain that most of their spread is not the depths'.
    """
    own = marked_mm[fitted]
    poses = marked_mm + (refined_mm - own).mean(axis=0)
    marked, refined = own[:, 2] - own[:, 2].mean(), refined_mm[:, 2] - refined_mm[:, 2].mean()
    slope = np.clip(marked @ refined / max(marked @ marked, 1e-9), 0, 1)
    poses[:, 2] = refined_mm[:, 2].mean() + slope * (marked_mm[:, 2] - own[:, 2].mean())
    return poses


def most_error(errors: np.ndarray) -> float:
    """Return the rms error above which a press stands far out of the others."""
    middle = np.median(errors)
    return float(max(middle + 6 * np.median(np.abs(errors - middle)), 2.5 * middle))
