"""Displacement from markers: error against the membrane's own, lost markers and time, by pattern, beside dense flow.

Pictures are those of the paper's sensor with another pattern, with noise. What a camera sees of a displacement is not
all along x and y: where the membrane gives way it looks as if it had moved outwards. The error of what is seen is that
of the markers and of interpolating between them; the error has both. Dense flow is Farnebäck's, of pictures less the
same with their markers inpainted, at 160 px.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.assets import list_presets
from gelgap.benchmarks.common import processor_s, rms, show, write_json
from gelgap.benchmarks.render.scenes import Membrane, sphere_dent
from gelgap.domains.formats.pictures import resized, without_markers
from gelgap.domains.frames.marker_motion import MarkerTracker, ThinPlate
from gelgap.render import Camera, Illumination, MembraneRenderer, Sensor

SIZE, SPAN_MM = (64, 48), (12.0, 9.0)
PICTURE_PX, FLOW_PX = (320, 240), (160, 120)
LIGHTS = ("i0", "i1", "i2")
QUICK = ("array-3", "circle-3")
PRESSES = (
    (0.3, 0.0, 0.0, (0.0, 0.0)),
    (0.6, 0.3, 30.0, (1.0, -0.7)),
    (1.0, 0.6, 100.0, (-2.0, 1.2)),
    (0.8, 0.6, 200.0, (2.5, 1.5)),
    (0.5, 0.45, 300.0, (-1.0, -2.2)),
    (1.0, 0.3, 10.0, (3.2, -1.0)),
)
"""Depth and drag, mm, the drag's direction in degrees, and where on the gel."""
WRONG_MM = 0.1
"""A marker that is further off is taken for another one."""


def run(quick: bool, out_dir: Path) -> None:
    """Measure, print the table and write it to `out_dir`; `quick` takes two patterns and dents in closed form."""
    membranes = [sphere_dent(0.5, (0.3, 0.1)), sphere_dent(0.8, (-0.2, 0.4))] if quick else solved_membranes()
    rows = [
        row for name in (QUICK if quick else list_presets("markers")) for row in measured(name, membranes)
    ]
    note = (
        f"over {len(membranes)} membranes, whose displacement is {1000 * _true_mm(membranes):.0f} µm rms, in lights "
        f"{', '.join(LIGHTS)}; ms of processor time a frame of 320×240 px"
    )
    show("Displacement from markers, rms µm along an axis", table := pd.DataFrame(rows), note)
    write_json(out_dir / "markers.json", table)


def solved_membranes() -> list[Membrane]:
    """Return the membranes of the presses and drags on gel b0, at draft."""
    from gelgap.sim import Elastomer, Pose, Sphere, solve_pose

    membranes = []
    for depth_mm, drag_mm, angle_deg, (x_mm, y_mm) in PRESSES:
        drag = drag_mm * np.exp(1j * np.radians(angle_deg))
        pose = Pose(
            depth_mm=depth_mm,
            shear_x_mm=drag.real.item(),
            shear_y_mm=drag.imag.item(),
            point_x_mm=x_mm,
            point_y_mm=y_mm,
        )
        state = solve_pose(Elastomer.preset("b0"), Sphere(), pose, "draft")
        membranes.append((state.x_mm, state.y_mm, state.displacement_mm))
    return membranes


def measured(name: str, membranes: list[Membrane]) -> list[dict[str, object]]:
    """Return the rows of a pattern: markers matched and interpolated, and dense flow."""
    sensor = Sensor.preset("paper").model_copy(update={"markers": Sensor(markers=name).markers})
    errors = {
        way: {"error": [], "of what is seen": [], "of a marker": []} for way in ("markers", "dense flow")
    }
    lost, wrong, seconds = [], 0, {"markers": [], "dense flow": []}
    for light in LIGHTS:
        render = MembraneRenderer(sensor, Illumination.preset(light), PICTURE_PX, "draft")
        reference = render.reference(rng=np.random.default_rng(0))
        tracker = MarkerTracker(reference, sensor.camera)
        plate, flow = ThinPlate(tracker.rest_mm, SIZE, SPAN_MM), DenseFlow(reference)
        for number, membrane in enumerate(membranes):
            picture = render.picture(*membrane, rng=np.random.default_rng(1 + number))
            moved_mm = tracker.displacement_mm(picture)
            true_mm = _displaced(membrane, _grid_mm())[..., :2]
            seen_mm = _as_seen(membrane, _grid_mm(), sensor.camera)
            for way, found_mm in (("markers", plate(moved_mm)), ("dense flow", flow(picture))):
                errors[way]["error"].append(found_mm - true_mm)
                errors[way]["of what is seen"].append(found_mm - seen_mm)
            off_mm = moved_mm - _as_seen(membrane, tracker.rest_mm, sensor.camera)
            far_mm = np.linalg.norm(off_mm, axis=1)
            lost.append(np.isnan(far_mm).mean())
            wrong += np.count_nonzero(far_mm > WRONG_MM)
            errors["markers"]["of a marker"].append(off_mm[far_mm <= WRONG_MM])
            seconds["markers"].append(processor_s(lambda: plate(tracker.displacement_mm(picture)), 1))  # noqa: B023
            seconds["dense flow"].append(processor_s(lambda: flow(picture), 1))  # noqa: B023
    shares = {"lost %": 100 * np.mean(lost), "wrong": wrong}
    rows = []
    for way, own in errors.items():
        um = {what: 1000 * rms(np.concatenate(values)) for what, values in own.items() if values}
        row = {"pattern": name, "way": way, "markers": len(tracker.rest_mm)} | um
        rows.append(row | (shares if way == "markers" else {}) | {"ms": 1000 * np.median(seconds[way])})
    return rows


class DenseFlow:
    """Farnebäck's flow of the markers alone, from a reference to pictures of it: (rows, columns, 2) mm on the grid."""

    def __init__(self, reference: np.ndarray) -> None:
        self._reference = self._only_markers(reference)

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        import cv2

        only = self._only_markers(picture)
        flow = cv2.calcOpticalFlowFarneback(self._reference, only, None, 0.5, 3, 21, 3, 7, 1.5, 0)
        return cv2.resize(flow, SIZE, interpolation=cv2.INTER_AREA) * (SPAN_MM[0] / FLOW_PX[0])

    @staticmethod
    def _only_markers(picture: np.ndarray) -> np.ndarray:
        with_them, without = (resized(image, FLOW_PX) for image in (picture, without_markers(picture)))
        return np.minimum(2 * np.abs(with_them.astype(np.int16) - without).max(axis=2), 255).astype(np.uint8)


def _grid_mm() -> np.ndarray:
    axes = (((np.arange(n) + 0.5) / n - 0.5) * span for n, span in zip(SIZE, SPAN_MM, strict=True))
    return np.stack(np.meshgrid(*axes), axis=-1)


def _displaced(membrane: Membrane, places_mm: np.ndarray) -> np.ndarray:
    from scipy.interpolate import RegularGridInterpolator

    x_mm, y_mm, displacement_mm = membrane
    return RegularGridInterpolator((y_mm, x_mm), displacement_mm)(places_mm[..., ::-1])


def _as_seen(membrane: Membrane, places_mm: np.ndarray, camera: Camera) -> np.ndarray:
    """Return how far places (…, 2) seem to move in the plane of the undeformed membrane."""
    at_rest = np.concatenate([places_mm, np.zeros((*places_mm.shape[:-1], 1))], axis=-1)
    pixels = camera.project_px(at_rest + _displaced(membrane, places_mm), PICTURE_PX).reshape(-1, 2) - 0.5
    return camera.plane_points_mm(*pixels.T, PICTURE_PX).reshape(places_mm.shape) - places_mm


def _true_mm(membranes: list[Membrane]) -> float:
    return rms([_displaced(membrane, _grid_mm())[..., :2] for membrane in membranes])
