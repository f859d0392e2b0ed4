"""Scenes for judging pictures, and their true pictures by Mitsuba 3: the same membrane, emitters, coat and camera.

A scene is a dent in closed form, so that no solver is needed to see the renderer's error. The path tracer comes with
`pip install gelgap[benchmark]`; `python -m gelgap.benchmarks.render.scenes` renders the small pictures of
`assets/reference/render` anew.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.assets import asset_path
from gelgap.render import Coating, Illumination, Sensor, Variation, vary_illumination, vary_sensor
from gelgap.render.light.leds import Emitter

Membrane = tuple[np.ndarray, np.ndarray, np.ndarray]
STORED_SAMPLES, STORED_SIZE_PX = 1024, (128, 96)
_DRAWS = Variation(led_position_mm=0.8, led_angle_deg=8.0, led_drive=0.2, albedo=0.2, yellowing=0.3)


def sphere_dent(
    depth_mm: float = 0.6,
    shear_mm: tuple[float, float] = (0.0, 0.0),
    point_mm: tuple[float, float] = (0.0, 0.0),
    half_extent_mm: tuple[float, float] = (7.0, 5.5),
    spacing_mm: float = 0.1,
    radius_mm: float = 1.5,
) -> Membrane:
    """Return x_mm, y_mm, displacement_mm: a spherical cap with an exponential flank, dragged by a smooth field."""
    x, y = (np.linspace(-half, half, round(2 * half / spacing_mm) + 1) for half in half_extent_mm)
    r = np.hypot(*np.meshgrid(x - point_mm[0], y - point_mm[1]))
    contact = min(np.sqrt(depth_mm * radius_mm), 0.9 * radius_mm)
    rim = np.sqrt(radius_mm**2 - contact**2)
    rim_depth = depth_mm - radius_mm + rim
    decay = contact / rim / rim_depth
    cap = depth_mm - radius_mm + np.sqrt(np.maximum(radius_mm**2 - r**2, 0))
    depth = np.where(r <= contact, cap, rim_depth * np.exp(-decay * np.maximum(r - contact, 0)))
    drag = np.exp(-((r / 1.8) ** 2))
    return x, y, np.stack([shear_mm[0] * drag, shear_mm[1] * drag, -depth], axis=-1)


@dataclass(frozen=True)
class RenderScene:
    """One press under one illumination, without markers and lens errors, which the path tracer does not know.

    With `drawn`, LEDs and coat are a draw of that seed around the presets. Illumination `own` is the sensor's.
    """

    illumination: str
    depth_mm: float
    shear_mm: tuple[float, float] = (0.0, 0.0)
    roughness: float | None = None  # none: the sensor's own coat
    point_mm: tuple[float, float] = (0.0, 0.0)
    drawn: int | None = None
    sensor_name: str = "paper"

    @property
    def name(self) -> str:
        """The scene in words; also the name of its stored picture."""
        words = {
            "d": self.depth_mm,
            "shear": f"{np.hypot(*self.shear_mm):.1f}" if any(self.shear_mm) else None,
            "at": "{:.1f} {:.1f}".format(*self.point_mm) if any(self.point_mm) else None,
            "gloss": self.roughness,
            "drawn": self.drawn,
        }
        light = self.sensor_name if self.illumination == "own" else self.illumination
        return " ".join([light, *(f"{word} {value}" for word, value in words.items() if value is not None)])

    @property
    def matt(self) -> bool:
        return self.sensor().coating.specular == 0

    def membrane(self) -> Membrane:
        x_mm, y_mm = self.sensor().camera.footprint_mm((4, 3))
        half_extent_mm = max(7.0, np.ceil(x_mm / 2 + 1)), max(5.5, np.ceil(y_mm / 2 + 1))
        return sphere_dent(self.depth_mm, self.shear_mm, self.point_mm, half_extent_mm)

    def light(self) -> Illumination:
        if self.illumination == "own":
            own = Sensor.preset(self.sensor_name).illumination
            if own is None:
                raise ValueError(f"sensor {self.sensor_name} has no light of its own")
            return own
        preset = Illumination.preset(self.illumination)
        if self.drawn is None:
            return preset
        return vary_illumination(preset, _DRAWS, np.random.default_rng(self.drawn))

    def sensor(self) -> Sensor:
        sensor = Sensor.preset(self.sensor_name)
        perfect = {"radial_distortion": (0.0, 0.0), "vignetting": 0.0, "point_spread_px": 0.0}
        sensor = sensor.model_copy(update={"camera": sensor.camera.model_copy(update=perfect)})
        if self.drawn is not None:
            sensor = vary_sensor(sensor, _DRAWS, np.random.default_rng(self.drawn + 1000))
        if self.roughness is None:
            return sensor
        coating = Coating(albedo=sensor.coating.albedo, specular=1.0, roughness=self.roughness)
        return sensor.model_copy(update={"coating": coating})


def drawn_scene(seed: int) -> RenderScene:
    """Return a scene that was not used for tuning: press, place, drag, LEDs and coat drawn; every third glossy."""
    rng = np.random.default_rng([seed, 5])
    depth_mm, angle = round(rng.uniform(0.15, 1.1), 2), rng.uniform(0, 2 * np.pi)
    drag_mm = rng.uniform(0, 0.55) * depth_mm
    return RenderScene(
        illumination=f"i{rng.integers(3)}",
        depth_mm=depth_mm,
        shear_mm=(float(drag_mm * np.cos(angle)), float(drag_mm * np.sin(angle))),
        roughness=round(rng.uniform(0.2, 0.4), 2) if seed % 3 == 2 else None,
        point_mm=(round(rng.uniform(-3.75, 3.75), 1), round(rng.uniform(-2.6, 2.6), 1)),
        drawn=seed,
    )


PAPER_LIGHTS = ("i0", "i1", "i2")
OWN_LIT_SENSORS = ("gelsight-mini-like", "digit-like", "gelsight-2014-like")
GLOSSY_SCENE = RenderScene("i1", 1.0, (0.4, 0.0), roughness=0.3)
ALL_SCENES = (
    *(
        RenderScene(light, depth, shear)
        for light in PAPER_LIGHTS
        for depth in (0.2, 0.6, 1.0)
        for shear in ((0.0, 0.0), (0.5 * depth, 0.2 * depth))
    ),
    RenderScene("i0", 0.6, roughness=0.2),
    GLOSSY_SCENE,
    RenderScene("i2", 0.6, roughness=0.4),
    *map(drawn_scene, range(9)),
    *(RenderScene("own", 0.7, (0.3, 0.1), None, (1.5, -1.0), sensor_name=name) for name in OWN_LIT_SENSORS),
)
# Kept as small pictures in assets/reference/render, so that a check needs no path tracer.
STORED_SCENES = (
    RenderScene("i0", 0.6),
    RenderScene("i0", 1.0, (0.5, 0.2)),
    RenderScene("i1", 0.2),
    RenderScene("i1", 1.0),
    RenderScene("i2", 0.6, (0.3, 0.12)),
    RenderScene("i2", 1.0, (0.5, 0.2)),
    GLOSSY_SCENE,
)


def trace(scene: RenderScene, size_px: tuple[int, int], samples_per_pixel: int) -> np.ndarray:
    """Return the float32 (h, w, 3) linear picture of a scene, with interreflection.

    Raises
    ------
    RuntimeError
        If Mitsuba is not installed.
    """
    try:
        import mitsuba as mi
    except ImportError as error:
        raise RuntimeError(
            "the path tracer needs Mitsuba 3; install it with: pip install 'gelgap[benchmark]'"
        ) from error
    mi.set_variant("scalar_rgb")
    camera, (width, height) = scene.sensor().camera, size_px
    x, y, _ = camera.position_mm
    view = mi.ScalarTransform4f().look_at(origin=list(camera.position_mm), target=[x, y, 0], up=[0, -1, 0])
    film = {"rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32"}
    description = {
        "type": "scene",
        "integrator": {"type": "path"},
        "membrane": _mesh(mi, scene),
        "sensor": {
            "type": "perspective",
            "fov": camera.horizontal_field_of_view_deg,
            "fov_axis": "x",
            "near_clip": 1.0,
            "far_clip": 500.0,
            "to_world": view,
            "film": {"type": "hdrfilm", "width": width, "height": height, **film},
            "sampler": {"type": "multijitter", "sample_count": samples_per_pixel},
        },
    }
    for index, emitter in enumerate(scene.light().emitters(camera)):
        description[f"led_{index}"] = _emitter(mi, emitter)
    return np.array(mi.render(mi.load_dict(description), spp=samples_per_pixel))


def _mesh(mi, scene: RenderScene):
    x, y, displacement = scene.membrane()
    points = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1) + displacement
    index = np.arange(len(y) * len(x)).reshape(len(y), len(x))
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([a, c, b, a, d, c], axis=-1).reshape(-1, 3)
    normals = -np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    coating = scene.sensor().coating
    albedo = {"type": "rgb", "value": list(coating.albedo)}
    matt = {"type": "diffuse", "reflectance": albedo}
    gloss = {"type": "roughplastic", "distribution": "beckmann", "alpha": coating.roughness}
    glossy = gloss | {"diffuse_reflectance": albedo}
    mixed = {"type": "blendbsdf", "weight": coating.specular, "matt": matt, "glossy": glossy}
    coat = {0.0: matt, 1.0: glossy}.get(coating.specular, mixed)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "coat": coat})
    mesh = mi.Mesh("membrane", points[..., 0].size, len(faces), has_vertex_normals=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.reshape(-1).astype(np.float32)
    parameters["vertex_normals"] = normals.reshape(-1).astype(np.float32)
    parameters["faces"] = faces.reshape(-1).astype(np.uint32)
    parameters.update()
    return mesh


def _emitter(mi, emitter: Emitter) -> dict:
    radiance = {"type": "rgb", "value": emitter.radiance_rgb.tolist()}
    if emitter.kind == "point":
        return {"type": "point", "position": emitter.center_mm.tolist(), "intensity": radiance}
    to_world = np.eye(4)
    to_world[:3, :3] = np.stack([emitter.half_u_mm, emitter.half_v_mm, emitter.normal], axis=1)
    to_world[:3, 3] = emitter.center_mm
    if np.linalg.det(to_world) < 0:
        to_world[:3, 0] *= -1
    return {
        "type": {"bar": "rectangle", "disc": "disk"}[emitter.kind],
        "to_world": mi.ScalarTransform4f(to_world),
        "black": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
        "light": {"type": "area", "radiance": radiance},
    }


def stored_reference(scene: RenderScene) -> np.ndarray:
    """Return the float32 (h, w, 3) linear picture of a scene that ships with the package."""
    with np.load(_stored_file(scene)) as file:
        return file["linear"].astype(np.float32)


def _stored_file(scene: RenderScene) -> Path:
    return asset_path("reference", "render", scene.name.replace(" ", "_") + ".npz")


if __name__ == "__main__":
    for stored in STORED_SCENES:
        linear = trace(stored, STORED_SIZE_PX, STORED_SAMPLES)
        np.savez_compressed(_stored_file(stored), linear=linear.astype(np.float16))
        print(f"wrote {_stored_file(stored)}")
