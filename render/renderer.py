"""The façade: a deformed membrane in, what the camera inside the sensor sees out."""

import copy
import logging
from typing import Literal

import numpy as np
from numba.core import event

from gelgap.render import imaging
from gelgap.render.flat_field import FlatFieldFilter
from gelgap.render.light.gloss import gloss
from gelgap.render.light.irradiance import DirectLight, direct_light
from gelgap.render.light.leds import Illumination, ShadowDetail, led_samples
from gelgap.render.light.scattered import ScatteredTable
from gelgap.render.markers import marker_cells, paint_markers
from gelgap.render.normal_table import NormalTable, TableShare
from gelgap.render.rasterizer import LOCK, NOWHERE_MM, rasterizer_for
from gelgap.render.sensor import Sensor, marker_rest_mm
from gelgap.render.surface import Lattice, Membrane, Surface, shared_surface

# The rastered mesh only says which rest point a pixel sees; light is gathered from the shaded grid, which is this many
# times finer. A frame takes 1.2 to 1.4 times as long where both are the same.
RASTER_STEP = 2

Quality = Literal["draft", "standard", "fine"]
LOG = logging.getLogger(__name__)
FIRST_USE = "numba compiles the renderer, which takes some ten seconds the first time on a machine"

# By quality level the spacing of the shaded grid in mm, and how finely shadows are sampled.
QUALITIES: dict[str, tuple[float, ShadowDetail]] = {
    "draft": (0.2, ShadowDetail(strip_width_mm=3.0, fewest_strips=2, march_step_mm=0.5)),
    "standard": (0.1, ShadowDetail(strip_width_mm=3.0, fewest_strips=3, march_step_mm=0.5)),
    "fine": (0.05, ShadowDetail(strip_width_mm=0.8, fewest_strips=8, march_step_mm=0.1)),
}


class _Announcement(event.Listener):
    """Warns at the first compilation while it listens; a function that is loaded from numba's cache is none."""

    made = False

    def on_start(self, event: event.Event) -> None:
        if not self.made:
            self.made = True
            LOG.warning(FIRST_USE)

    def on_end(self, event: event.Event) -> None:
        """Say nothing: what is compiled next follows at once."""


_ANNOUNCEMENT = _Announcement()


class MembraneRenderer:
    """Renders membranes through one sensor under one illumination.

    Parameters
    ----------
    sensor, illumination
        What looks and what lights.
    size_px
        Width and height of the picture.
    quality
        `draft`, `standard` or `fine`: spacing of the shaded grid and number of strips per LED.

    Raises
    ------
    ValueError
        For an unknown quality, or a size outside 16…4096 px.
    """

    def __init__(
        self,
        sensor: Sensor,
        illumination: Illumination,
        size_px: tuple[int, int] = (320, 240),
        quality: Quality = "standard",
    ) -> None:
        if quality not in QUALITIES:
            raise ValueError(f"render quality {quality!r} is unknown; known: {', '.join(QUALITIES)}")
        if not all(16 <= side <= 4096 for side in size_px):
            raise ValueError(f"size_px is {size_px[0]}×{size_px[1]}; each side must lie in 16…4096")
        self.sensor = sensor
        self.illumination = illumination
        self.quality = quality
        spacing_mm, self._shadows = QUALITIES[quality]
        self.size_px = (int(size_px[0]), int(size_px[1]))
        self.lattice = Lattice.covering(sensor.camera, self.size_px, spacing_mm)
        self._flat = np.zeros((self.lattice.rows, self.lattice.columns, 3), np.float32)
        self._marker_cells = marker_cells(sensor.markers)
        ratio = np.asarray(sensor.markers.albedo) / np.maximum(sensor.coating.albedo, 1e-6)
        self._marker_ratio = ratio.astype(np.float32)
        self._gain = None
        if sensor.camera.vignetting > 0:
            self._gain = imaging.vignetting_gain(sensor.camera, self.size_px)
        self._flat_field = None
        if sensor.flat_field is not None:
            self._flat_field = FlatFieldFilter(sensor.flat_field, sensor.camera, self.size_px)
        self._set_colours(illumination)
        self._set_scattered(illumination)
        with event.install_listener("numba:compile", _ANNOUNCEMENT):
            self._set_leds(illumination)
        self._set_table(illumination)

    def __repr__(self) -> str:
        width, height = self.size_px
        return (
            f"MembraneRenderer({self.sensor!r}, {self.illumination!r}, {width}×{height} px, {self.quality})"
        )

    def relit(self, illumination: Illumination) -> "MembraneRenderer":
        """Return the renderer of the same sensor under another illumination.

        It gives the pictures of a new one, sooner: what the illuminations have in common is not computed again, which
        for LEDs in the same places is all but their colours.
        """
        before = self.illumination
        other = copy.copy(self)
        other.illumination = illumination
        other._set_colours(illumination)
        if illumination.scattered != before.scattered:
            other._set_scattered(illumination)
        if [led.face for led in illumination.leds] != [led.face for led in before.leds]:
            other._set_leds(illumination)
        other._set_table(illumination)
        return other

    def _set_colours(self, illumination: Illumination) -> None:
        """Compute what depends on the LEDs' colours."""
        glossy = self.sensor.coating.specular
        radiance = illumination.led_to_camera(self.sensor.camera)
        diffuse = radiance * np.asarray(self.sensor.coating.albedo) / np.pi
        self._lambert_to_linear = ((1 - glossy) * diffuse).astype(np.float32)
        # Rows as `gloss` gives them: base and highlight of each LED.
        gloss_to_linear = np.stack([glossy * diffuse, glossy * radiance], 1)
        self._gloss_to_linear = gloss_to_linear.reshape(-1, 3).astype(np.float32)

    def _set_scattered(self, illumination: Illumination) -> None:
        self._scattered = None
        if illumination.scattered is not None:
            exposure = self.sensor.camera.exposure
            self._scattered = ScatteredTable(illumination.scattered, self.lattice, exposure)

    def _set_leds(self, illumination: Illumination) -> None:
        """Compute what depends on where the LEDs are: their light on the undeformed membrane."""
        self._leds = led_samples(illumination.emitters(self.sensor.camera), self._shadows, self.lattice)
        flat = shared_surface(self.lattice, self._flat, "reference")
        light = direct_light(flat, self._leds, self._shadows, None)
        self._reference_irradiance = light.irradiance
        self._reference_gloss = self._gloss(flat, light, None) if self.sensor.coating.specular > 0 else None

    def _set_table(self, illumination: Illumination) -> None:
        """Prepare the share of the sensor's table of normals, which holds under its own light alone."""
        self._table = None
        sensor = self.sensor
        if sensor.table_share == 0 or illumination != sensor.illumination:
            return
        surface = shared_surface(self.lattice, self._flat, "reference")
        flat = self._seen(surface, self._radiance(surface))
        table = NormalTable(np.array(sensor.normal_table), sensor.camera.footprint_mm(self.size_px)[0] / 2)
        untouched = self._linear(surface, markers=False)
        self._table = TableShare(table, sensor.table_share, sensor.camera, flat, untouched)

    def _gloss(self, surface: Surface, light: DirectLight, reference: np.ndarray | None) -> np.ndarray:
        roughness = self.sensor.coating.roughness
        return gloss(surface, self._leds, light, self.sensor.camera.position_mm, roughness, reference)

    def _radiance(self, surface: Surface) -> np.ndarray:
        """Return (rows, columns, 3) float32: linear camera RGB of every vertex of the shaded grid, without markers."""
        light = direct_light(surface, self._leds, self._shadows, self._reference_irradiance)
        linear = _weighted(light.irradiance, self._lambert_to_linear)
        if self._reference_gloss is not None:
            linear += _weighted(self._gloss(surface, light, self._reference_gloss), self._gloss_to_linear)
        if self._scattered is not None:
            self._scattered.add_to(linear, surface)
        return linear

    def _surface(self, membrane: Membrane) -> Surface:
        surface = shared_surface(self.lattice, membrane.displacement_on(self.lattice), membrane.name)
        if (top_mm := surface.height_mm.max()) > (most_mm := -0.9 * self.sensor.camera.position_mm[2]):
            raise ValueError(
                f"{membrane.name}: the membrane rises by {top_mm:.3g} mm; the camera sees it up to {most_mm:.3g} mm"
            )
        return surface

    def _geometry(self, surface: Surface) -> np.ndarray:
        positions = np.ascontiguousarray(surface.positions_mm[::RASTER_STEP, ::RASTER_STEP])
        lattice = self.lattice.every(RASTER_STEP)
        return rasterizer_for(self.sensor.camera, lattice, self.size_px).geometry(positions)

    def _gather(self, geometry: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return (h, w, 3): float32 (rows, columns, 3) values of the shaded grid's vertices at rest coordinates."""
        out = np.empty((*geometry.shape[:2], 3), np.float32)
        imaging.gather(geometry, values, self.lattice.grid, np.float32(NOWHERE_MM), out)
        return out

    def _seen(self, surface: Surface, values: np.ndarray) -> np.ndarray:
        """Return (h, w, 3): the values of the surface's vertices in each pixel."""
        with LOCK:
            return self._gather(self._geometry(surface), values)

    def _linear(self, surface: Surface, markers: bool) -> np.ndarray:
        with LOCK:
            geometry = self._geometry(surface)
            linear = self._gather(geometry, self._radiance(surface))
            if self._table is not None:
                self._table.mix_into(linear, self._gather(geometry, surface.normals))
            if markers and self._marker_cells is not None:
                paint_markers(geometry, *self._marker_cells, self._marker_ratio, linear)
            if self._gain is not None:
                linear *= self._gain
            if self.sensor.camera.point_spread_px > 0:
                linear = imaging.point_spread(linear, self.sensor.camera)
            if self._flat_field is not None:
                self._flat_field.apply(linear, surface, geometry if markers else None)
            return linear

    def _encoded(self, linear: np.ndarray, rng: np.random.Generator | None) -> np.ndarray:
        if rng is not None:
            linear = imaging.sensor_noise(linear, self.sensor.camera, rng)
        return imaging.encode(linear)

    def linear(
        self,
        x_mm: np.ndarray,
        y_mm: np.ndarray,
        displacement_mm: np.ndarray,
        markers: bool = True,
        frame_name: str = "membrane",
    ) -> np.ndarray:
        """Return float32 (h, w, 3): linear camera RGB before noise and encoding; 1 is the camera's saturation.

        Parameters
        ----------
        x_mm, y_mm
            The regular rest grid, (nx,) and (ny,).
        displacement_mm
            (ny, nx, 3) displacement of the outer membrane; pressing moves to −z.
        markers
            Whether the sensor's markers are there.
        frame_name
            What an error calls this membrane.

        Raises
        ------
        ValueError
            If the grid is not regular or the displacement has another shape, is not finite, or folds the membrane.
        """
        return self._linear(self._surface(Membrane(x_mm, y_mm, displacement_mm, frame_name)), markers)

    def picture(
        self,
        x_mm: np.ndarray,
        y_mm: np.ndarray,
        displacement_mm: np.ndarray,
        markers: bool = True,
        rng: np.random.Generator | None = None,
        frame_name: str = "membrane",
    ) -> np.ndarray:
        """Return the uint8 (h, w, 3) sRGB picture; `rng` draws shot and read noise. Otherwise as `linear`."""
        return self._encoded(self.linear(x_mm, y_mm, displacement_mm, markers, frame_name), rng)

    def reference_linear(self, markers: bool = True) -> np.ndarray:
        """Return `linear` of the undeformed membrane."""
        return self._linear(shared_surface(self.lattice, self._flat, "reference"), markers)

    def reference(self, markers: bool = True, rng: np.random.Generator | None = None) -> np.ndarray:
        """Return the `picture` of the undeformed membrane."""
        picture = self._encoded(self.reference_linear(markers), rng)
        imaging.warn_if_blind(picture)
        return picture

    def height_map_mm(
        self, x_mm: np.ndarray, y_mm: np.ndarray, displacement_mm: np.ndarray, frame_name: str = "membrane"
    ) -> np.ndarray:
        """Return float32 (h, w): how far the membrane in each pixel stands towards the camera (−z), in mm."""
        surface = self._surface(Membrane(x_mm, y_mm, displacement_mm, frame_name))
        return -self._seen(surface, surface.positions_mm)[..., 2]

    def normal_map(
        self, x_mm: np.ndarray, y_mm: np.ndarray, displacement_mm: np.ndarray, frame_name: str = "membrane"
    ) -> np.ndarray:
        """Return float32 (h, w, 3): the membrane's unit normal in each pixel, towards the camera (−z)."""
        surface = self._surface(Membrane(x_mm, y_mm, displacement_mm, frame_name))
        return self._seen(surface, surface.normals)

    def contact_mask(
        self,
        x_mm: np.ndarray,
        y_mm: np.ndarray,
        displacement_mm: np.ndarray,
        contact: np.ndarray,
        frame_name: str = "membrane",
    ) -> np.ndarray:
        """Return bool (h, w): pixels that see a part of the membrane in contact, given `contact` (ny, nx)."""
        contact = np.asarray(contact)
        if contact.shape != np.shape(displacement_mm)[:2]:
            raise ValueError(
                f"{frame_name}: contact has shape {contact.shape}; the displacement asks for "
                f"{np.shape(displacement_mm)[:2]}"
            )
        membrane = Membrane(x_mm, y_mm, displacement_mm, frame_name)
        as_field = np.repeat(contact.astype(np.float32)[..., None], 3, axis=2)
        on_lattice = membrane.field_on(self.lattice, as_field).astype(np.float32)
        return self._seen(self._surface(membrane), on_lattice)[..., 0] > 0.5

    def marker_px(
        self, x_mm: np.ndarray, y_mm: np.ndarray, displacement_mm: np.ndarray, frame_name: str = "membrane"
    ) -> np.ndarray:
        """Return (rows, columns, 2), or (1, n, 2) of a list: markers' centres in the picture (pixel centres at +0.5).

        A missing marker is NaN.
        """
        rest_mm = marker_rest_mm(self.sensor.markers)
        if rest_mm.size == 0:
            return rest_mm
        on_lattice = Membrane(x_mm, y_mm, displacement_mm, frame_name).displacement_on(self.lattice)
        moved = self._gather(np.nan_to_num(rest_mm).astype(np.float32), on_lattice.astype(np.float32))
        points = np.pad(rest_mm, ((0, 0), (0, 0), (0, 1))) + moved
        return self.sensor.camera.project_px(points, self.size_px)


def _weighted(parts: np.ndarray, to_linear: np.ndarray) -> np.ndarray:
    """Return (rows, columns, 3): parts of light (rows, columns, ...) times what each is to the camera (parts, 3)."""
    rows, columns = parts.shape[:2]
    return (parts.reshape(rows * columns, -1) @ to_linear).reshape(rows, columns, 3)


def reference_gap(one: MembraneRenderer, other: MembraneRenderer) -> imaging.ColourGap:
    """Return the colour gap of two renderers' pictures of the undeformed membrane, without markers and noise."""
    return imaging.picture_gap(one.reference(markers=False), other.reference(markers=False))
