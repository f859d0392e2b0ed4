"""LEDs cut up for integration: strips for where an LED is partly hidden, nodes for where it is in full view."""

from dataclasses import dataclass
from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np

from gelgap.render.led import LED_SHAPES, Emitter

# Nodes of an LED in full view: along its level axis and across.
OPEN_NODES = (8, 2)


@dataclass(frozen=True)
class ShadowDetail:
    """How finely partly hidden LEDs are sampled."""

    strip_width_mm: float
    fewest_strips: int
    march_step_mm: float


# A strip of an LED: its ends in mm (low is nearer to the membrane), its normal and its area in mm². A point is one
# strip of 1 mm² without length.
STRIP = np.dtype(
    [
        *((f"{part}_{axis}", np.float32) for part in ("low", "high", "normal") for axis in "xyz"),
        ("area", np.float32),
        ("is_point", np.bool_),
    ],
    align=True,
)


class Nodes(NamedTuple):
    """The points that stand for each LED in full view, float32; a point light has only its first node."""

    position_mm: np.ndarray  # (leds, 3, nodes): nodes lie side by side for vector registers
    normal: np.ndarray  # (leds, 3, nodes)
    area_mm2: np.ndarray  # (leds, nodes)


class Outlines(NamedTuple):
    """The bounds of each LED as seen from the membrane, float32."""

    left_mm: np.ndarray  # (leds, 2): x and y of one end of the level axis
    right_mm: np.ndarray  # (leds, 2): of the other end
    lowest_mm: np.ndarray  # (leds,): the least height above the undeformed membrane


class LedSamples(NamedTuple):
    """All LEDs of an illumination as the kernels take them."""

    is_point: np.ndarray  # (leds,) bool: an intensity of 1 mm² in all directions, not a Lambertian face
    strips: np.ndarray  # (strips,) of STRIP; LED k owns those from first_strip[k] up to first_strip[k + 1]
    first_strip: np.ndarray  # (leds + 1,) int32
    nodes: Nodes
    outlines: Outlines


def led_samples(emitters: tuple[Emitter, ...], detail: ShadowDetail) -> LedSamples:
    """Return the strips, nodes and outlines of emitters."""
    strips = [_strips(emitter, detail) for emitter in emitters]
    return LedSamples(
        is_point=np.array([LED_SHAPES[emitter.kind].is_point for emitter in emitters]),
        strips=np.concatenate(strips),
        first_strip=np.cumsum([0] + [len(own) for own in strips]).astype(np.int32),
        nodes=_nodes(emitters),
        outlines=_outlines(emitters),
    )


def _strips(emitter: Emitter, detail: ShadowDetail) -> np.ndarray:
    shape = LED_SHAPES[emitter.kind]
    length_mm = 2 * np.linalg.norm(emitter.half_u_mm)
    strips = []
    for place, weight, chord in shape.slices(
        max(ceil(length_mm / detail.strip_width_mm), detail.fewest_strips)
    ):
        center = emitter.center_mm + place * emitter.half_u_mm
        half = chord * emitter.half_v_mm
        area = 1.0 if shape.is_point else weight * length_mm / 2 * 2 * np.linalg.norm(half)
        strips.append((*(center - half), *(center + half), *emitter.normal, area, shape.is_point))
    return np.array(strips, STRIP)


def _nodes(emitters: tuple[Emitter, ...]) -> Nodes:
    positions = np.empty((len(emitters), 3, OPEN_NODES[0] * OPEN_NODES[1]))
    normals = np.empty_like(positions)
    areas = np.zeros((len(emitters), positions.shape[2]))
    across = list(zip(*np.polynomial.legendre.leggauss(OPEN_NODES[1]), strict=True))
    for led, emitter in enumerate(emitters):
        positions[led], normals[led] = emitter.center_mm[:, None], emitter.normal[:, None]
        slices = LED_SHAPES[emitter.kind].slices(OPEN_NODES[0])
        for node, ((place, weight, chord), (v, v_weight)) in enumerate(product(slices, across)):
            half = chord * emitter.half_v_mm
            positions[led, :, node] += place * emitter.half_u_mm + v * half
            areas[led, node] = weight * np.linalg.norm(emitter.half_u_mm) * v_weight * np.linalg.norm(half)
    return Nodes(*(values.astype(np.float32) for values in (positions, normals, areas)))


def _outlines(emitters: tuple[Emitter, ...]) -> Outlines:
    return Outlines(
        left_mm=np.array([(led.center_mm - led.half_u_mm)[:2] for led in emitters], np.float32),
        right_mm=np.array([(led.center_mm + led.half_u_mm)[:2] for led in emitters], np.float32),
        lowest_mm=np.array(
            [-led.center_mm[2] - abs(led.half_u_mm[2]) - abs(led.half_v_mm[2]) for led in emitters],
            np.float32,
        ),
    )
