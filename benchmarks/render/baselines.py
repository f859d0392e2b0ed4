"""Baselines without our light: stock pyrender, and area LEDs without shadows."""

import numpy as np

from gelgap.benchmarks.render.scenes import Membrane, RenderScene, triangle_mesh
from gelgap.render import MembraneRenderer
from gelgap.render.light.irradiance import direct_light
from gelgap.render.surface import Membrane as RestMembrane


def without_shadows(renderer: MembraneRenderer, membrane: Membrane) -> np.ndarray:
    """Render with the LEDs' area and cosines but as if nothing stood in their way."""
    surface = renderer._surface(RestMembrane(*membrane))
    level = surface._replace(height_mm=np.zeros_like(surface.height_mm))
    light = direct_light(level, renderer._leds, renderer._shadows, None).irradiance
    return renderer._gather(renderer._geometry(surface), light @ renderer._lambert_to_linear)


class StockPyrender:
    """pyrender as it comes: its own shader and 8-bit output, and a point light for each LED (it takes four)."""

    def __init__(self, scene: RenderScene, size_px: tuple[int, int]) -> None:
        from gelgap.render.rasterizer import import_pyrender

        pyrender, _ = import_pyrender()
        import trimesh

        points, faces = triangle_mesh(scene.membrane())
        material = pyrender.MetallicRoughnessMaterial(
            baseColorFactor=(0.5, 0.5, 0.5, 1), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
        )
        mesh = trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)
        self._scene = pyrender.Scene(ambient_light=np.zeros(3))
        self._scene.add(pyrender.Mesh.from_trimesh(mesh, material=material))
        camera = scene.sensor().camera
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[:3, 3] = camera.position_mm
        focal_px, center_px = camera.focal_length_px(size_px[0]), np.divide(size_px, 2)
        lens = pyrender.IntrinsicsCamera(focal_px, focal_px, *center_px, znear=1, zfar=100)
        self._scene.add(lens, pose=pose)
        for emitter in scene.light().emitters(camera):
            area_mm2 = 4 * np.linalg.norm(emitter.half_u_mm) * np.linalg.norm(emitter.half_v_mm)
            power = emitter.radiance_rgb * area_mm2
            pose = np.eye(4)
            pose[:3, 3] = emitter.center_mm
            light = pyrender.PointLight(color=power / power.max(), intensity=float(power.max()))
            self._scene.add(light, pose=pose)
        self._renderer = pyrender.OffscreenRenderer(*size_px)

    def code(self) -> np.ndarray:
        """Return its uint8 picture."""
        return self._renderer.render(self._scene)[0]

    def fitted_linear(self, reference: np.ndarray) -> np.ndarray:
        """Return its picture, pow(1/2.2) undone, with the gain of each channel fitted to a reference."""
        linear = (self.code() / 255.0) ** 2.2
        gain = (linear * reference).sum((0, 1)) / np.maximum((linear**2).sum((0, 1)), 1e-9)
        return linear * gain

    def close(self) -> None:
        self._renderer.delete()
