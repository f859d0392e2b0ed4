"""Light from single points of the membrane that nothing shadows, as a calibration compares it with pictures."""

import numba
import numpy as np

from gelgap.render.gloss import view_from
from gelgap.render.led import Led
from gelgap.render.led_samples import LedSamples, ShadowDetail, led_samples
from gelgap.render.occlusion import Vertex
from gelgap.render.plastic import highlight, rough_plastic, shadowing, transmitted_share
from gelgap.render.sensor import Sensor

DETAIL = ShadowDetail(strip_width_mm=2.0, fewest_strips=3, march_step_mm=1.0)


def unshadowed_light(
    sensor: Sensor, leds: tuple[Led, ...], positions_mm: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Return (n, leds, 3): Lambert, plastic base and highlight of points (n, 3), per unit LED radiance."""
    samples: LedSamples = led_samples(tuple(led.emitter(np.ones(3)) for led in leds), DETAIL)
    out = np.empty((len(positions_mm), len(leds), 3))
    camera_mm, coat = np.asarray(sensor.camera.position_mm), rough_plastic(sensor.coating.roughness)
    _unshadowed_light(positions_mm, normals, camera_mm, coat, samples, out)
    return out


@numba.njit(cache=True)
def _unshadowed_light(positions, normals, camera_mm, coat, leds, out):
    """Fill out[point, led] = (Lambert, plastic base, plastic highlight) per unit radiance; each / π but the last."""
    for p in range(len(positions)):
        x, y, z = positions[p]
        nx, ny, nz = normals[p]
        view = view_from(Vertex(x, y, z, nx, ny, nz), camera_mm)
        # A guess may look along the sphere's flank; nothing is seen there.
        cosine_out = max(view.cosine, 1e-3)
        share_out = coat.base_scale * transmitted_share(cosine_out, coat)
        shadowing_out = shadowing(cosine_out, coat) / (4 * cosine_out)
        for led in range(len(leds.is_point)):
            lambert, base, glossy = 0.0, 0.0, 0.0
            for k in range(1 if leds.is_point[led] else leds.nodes.area_mm2.shape[1]):
                qx, qy, qz = leds.nodes.position_mm[led, :, k]
                qx, qy, qz = qx - x, qy - y, qz - z
                r2 = qx * qx + qy * qy + qz * qz
                inverse = 1 / np.sqrt(r2)
                cosine_in = (nx * qx + ny * qy + nz * qz) * inverse
                solid_angle = 1 / r2
                if not leds.is_point[led]:
                    ex, ey, ez = leds.nodes.normal[led, :, k]
                    away = -(ex * qx + ey * qy + ez * qz) * inverse
                    solid_angle *= away * leds.nodes.area_mm2[led, k]
                if cosine_in <= 0 or solid_angle <= 0:
                    continue
                lambert += solid_angle * cosine_in
                base += solid_angle * cosine_in * transmitted_share(cosine_in, coat) * share_out
                in_dot_out = (qx * view.x + qy * view.y + qz * view.z) * inverse
                glossy += solid_angle * highlight(cosine_in, cosine_out, in_dot_out, shadowing_out, coat)
            out[p, led, 0] = lambert / np.pi
            out[p, led, 1] = base / np.pi
            out[p, led, 2] = glossy
