"""Reference pictures by Mitsuba 3 (`pip install gelgap[benchmark]`): the same membrane, emitters, coat and camera.

`python -m gelgap.benchmarks.render.path_tracer` renders the small pictures of `assets/reference/render` anew.
"""

from pathlib import Path

import numpy as np

from gelgap.assets import asset_path
from gelgap.benchmarks.render.scenes import STORED_SCENES, RenderScene, triangle_mesh
from gelgap.render import Coating, Emitter

STORED_SAMPLES = 1024
STORED_SIZE_PX = (128, 96)


def trace(scene: RenderScene, size_px: tuple[int, int], samples_per_pixel: int, seed: int = 0) -> np.ndarray:
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
    camera, light = scene.sensor().camera, scene.light()
    x, y, _ = camera.position_mm
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
            "to_world": mi.ScalarTransform4f().look_at(
                origin=list(camera.position_mm), target=[x, y, 0], up=[0, -1, 0]
            ),
            "film": {"type": "hdrfilm", "width": size_px[0], "height": size_px[1], **_FILM},
            "sampler": {"type": "multijitter", "sample_count": samples_per_pixel, "seed": seed},
        },
    }
    for index, emitter in enumerate(light.emitters(camera)):
        description[f"led_{index}"] = _emitter(mi, emitter)
    return np.array(mi.render(mi.load_dict(description), spp=samples_per_pixel, seed=seed))


_FILM = {"rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32"}


def _mesh(mi, scene: RenderScene):
    points, faces = triangle_mesh(scene.membrane())
    normals = -np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(scene.sensor().coating))
    mesh = mi.Mesh("membrane", points[..., 0].size, len(faces), has_vertex_normals=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.reshape(-1).astype(np.float32)
    parameters["vertex_normals"] = normals.reshape(-1).astype(np.float32)
    parameters["faces"] = faces.reshape(-1).astype(np.uint32)
    parameters.update()
    return mesh


def _bsdf(coating: Coating) -> dict:
    albedo = {"type": "rgb", "value": list(coating.albedo)}
    matt = {"type": "diffuse", "reflectance": albedo}
    glossy = {
        "type": "roughplastic",
        "distribution": "beckmann",
        "alpha": coating.roughness,
        "diffuse_reflectance": albedo,
    }
    mixed = {"type": "blendbsdf", "weight": coating.specular, "matt": matt, "glossy": glossy}
    return {"type": "twosided", "coat": {0.0: matt, 1.0: glossy}.get(coating.specular, mixed)}


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


def store_references() -> None:
    """Render every stored scene, as half-precision floats."""
    for scene in STORED_SCENES:
        linear = trace(scene, STORED_SIZE_PX, STORED_SAMPLES)
        np.savez_compressed(_stored_file(scene), linear=linear.astype(np.float16))
        print(f"wrote {_stored_file(scene)}")


def _stored_file(scene: RenderScene) -> Path:
    return asset_path("reference", "render", scene.name.replace(" ", "_") + ".npz")


if __name__ == "__main__":
    store_references()
