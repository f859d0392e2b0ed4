"""Scattered light and flat fields: what they do to a picture, and what is refused."""

import numpy as np
import pytest

from gelgap.render.flat_field import FlatField, FlatFieldMaps, save_maps
from gelgap.render.light.leds import Illumination
from gelgap.render.light.scattered import Scattered, harmonics
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Sensor, save_sensor
from gelgap.render.surface import Membrane, shared_surface

SIZE_PX = (96, 72)
SOME = tuple(tuple(0.02 * np.sin(np.arange(9) + channel)) for channel in range(3))


def lit(scattered=None, flat_field=None):
    sensor = Sensor.preset("paper").model_copy(update={"flat_field": flat_field})
    light = Illumination.preset("i0").model_copy(update={"scattered": scattered})
    return MembraneRenderer(sensor, light, SIZE_PX)


def written(folder, value=1.2, loaded=0.9, **settings):
    shape = (SIZE_PX[1], SIZE_PX[0], 3)
    maps = FlatFieldMaps(np.full(shape, value, np.float32), np.full(shape, loaded, np.float32))
    save_maps(maps, folder / "flat.npz")
    return FlatField(file="flat.npz", **settings)


def test_what_is_off_stays_out_of_recipes():
    assert "flat_field" not in Sensor.preset("paper").model_dump(mode="json")
    assert "scattered" not in Illumination.preset("i0").model_dump(mode="json")


def test_scattered_light_leaves_the_reference_alone(dent):
    plain, scattered = lit(), lit(Scattered(order=1, degree=1, coefficients=SOME))
    np.testing.assert_array_equal(plain.reference_linear(), scattered.reference_linear())
    change = scattered.linear(*dent(0.6), markers=False) - plain.linear(*dent(0.6), markers=False)
    assert np.abs(change).max() > 1e-3


def test_scattered_light_is_the_polynomial_of_normal_and_place(dent):
    settings = Scattered(order=1, degree=1, coefficients=SOME, scale_mm=5.0, ambient=((0.01, 0.0, 0.0),) * 3)
    plain, scattered = lit(), lit(settings)
    surface = plain._surface(Membrane(*dent(0.6)))
    change = scattered._radiance(surface) - plain._radiance(surface)
    row, column = 60, 75
    x, y, _ = surface.positions_mm[row, column]
    by_place = harmonics(surface.normals[row, column][None], 1)[0][:, None] * [1, x / 5, y / 5]
    expected = np.reshape(SOME, (3, 3, 3)).reshape(3, 9) @ by_place.ravel() + 0.01
    np.testing.assert_allclose(change[row, column], expected, atol=2e-4)


def test_light_is_never_negative(dent):
    dark = lit(Scattered(order=1, coefficients=((0.0, 0.0, -5.0),) * 3))
    linear = dark.linear(*dent(0.9), markers=False)
    assert linear.min() == 0


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"order": 1, "coefficients": ((1.0,),) * 3}, "3 rows of 3 numbers"),
        ({"order": 1, "coefficients": ((9.0, 0.0, 0.0),) * 3}, r"\[-5, 5\]"),
        ({"span_mm": (1, -1, 0, 1)}, "span_mm"),
    ],
)
def test_bad_scattered_light_is_refused(values, said):
    with pytest.raises(ValueError, match=said):
        Scattered(**values)


def test_a_flat_field_multiplies_the_picture(tmp_path, dent):
    plain = lit()
    volume_mm3 = 1e-3  # any dent is larger
    with_field = lit(
        flat_field=written(tmp_path, volume_mm3=volume_mm3, gain=((0.1, 0, 0, 0, 0, 0),) * 3).found_in(
            tmp_path
        )
    )
    np.testing.assert_allclose(with_field.reference_linear(), 1.2 * plain.reference_linear(), rtol=1e-3)
    pressed = with_field.linear(*dent(0.6)) / np.maximum(plain.linear(*dent(0.6)), 1e-6)
    np.testing.assert_allclose(pressed, 1.2 * 0.9 * (1 + 2 * 0.1), rtol=2e-3)


def test_a_sensor_file_carries_its_flat_field(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    field = written(tmp_path / "a").found_in(tmp_path / "a")
    save_sensor(Sensor.preset("paper").model_copy(update={"flat_field": field}), tmp_path / "b" / "s.toml")
    read = Sensor.load(tmp_path / "b" / "s.toml")
    assert read.flat_field.file == str((tmp_path / "b" / "flat.npz").resolve())
    assert read.flat_field.sha256 == field.sha256


def test_a_flat_field_of_other_proportions_is_refused(tmp_path):
    field = written(tmp_path).found_in(tmp_path)
    sensor = Sensor.preset("paper").model_copy(update={"flat_field": field})
    with pytest.raises(ValueError, match="other proportions"):
        MembraneRenderer(sensor, Illumination.preset("i0"), (96, 96))


def objects(path):
    np.savez(path, ratio=np.array([{"a": 1}], dtype=object))


def array(**arrays):
    return lambda path: np.savez(path, **arrays)


FLAT = np.ones((16, 20, 3), np.float32)


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (objects, "cannot be read"),
        (array(ratio=FLAT[..., :2]), "shape"),
        (array(ratio=FLAT.astype(int)), "type"),
        (array(ratio=np.full_like(FLAT, np.nan)), "finite"),
        (array(ratio=100 * FLAT), r"\[0, 8\]"),
        (array(other=FLAT), "holds other"),
        (array(ratio=FLAT, loaded=FLAT[:-1]), "another shape"),
    ],
)
def test_hostile_flat_fields_are_refused(tmp_path, write, said):
    write(tmp_path / "flat.npz")
    with pytest.raises(ValueError, match=said):
        FlatField(file="flat.npz").found_in(tmp_path)


def test_flat_fields_outside_missing_or_changed_are_refused(tmp_path):
    (tmp_path / "in").mkdir()
    written(tmp_path)
    for name in ("../flat.npz", str(tmp_path / "flat.npz")):
        with pytest.raises(ValueError, match="in the folder of the sensor file"):
            FlatField(file=name).found_in(tmp_path / "in")
    (tmp_path / "in" / "link.npz").symlink_to(tmp_path / "flat.npz")
    with pytest.raises(ValueError, match="in the folder of the sensor file"):
        FlatField(file="link.npz").found_in(tmp_path / "in")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        FlatField(file="gone.npz").found_in(tmp_path)
    with pytest.raises(ValueError, match="SHA-256"):
        FlatField(file="flat.npz", sha256="0" * 64).found_in(tmp_path)


def test_a_nearly_parallel_camera_is_rastered_precisely():
    fov_deg = float(2 * np.degrees(np.arctan(6 / 500)))
    camera = Sensor.preset("paper").camera.model_copy(
        update={"position_mm": (0.0, 0.0, -500.0), "horizontal_field_of_view_deg": fov_deg}
    )
    sensor = Sensor.preset("paper").model_copy(update={"camera": camera})
    renderer = MembraneRenderer(sensor, Illumination.preset("i0"), SIZE_PX)
    geometry = renderer._geometry(shared_surface(renderer.lattice, renderer._flat, "flat"))
    x_mm = (np.arange(96) + 0.5 - 48) * 12 / 96
    np.testing.assert_allclose(geometry[..., 0], np.broadcast_to(x_mm, (72, 96)), atol=2e-5)


def test_dots_of_a_real_sensor_move_with_the_gel(tmp_path, dent):
    rows, columns = np.indices(SIZE_PX[::-1])
    dots = np.where((rows % 8 < 3) & (columns % 8 < 3), 0.3, 1.0)[..., None] * np.ones(3)
    ones, lacking = np.ones_like(dots, np.float32), 0.05  # light that the model does not have
    save_maps(FlatFieldMaps(ones, offset=lacking * ones, dots=dots.astype(np.float32)), tmp_path / "flat.npz")
    plain, dotted = lit(), lit(flat_field=FlatField(file="flat.npz").found_in(tmp_path))
    bare = plain.reference_linear(markers=False) + lacking
    np.testing.assert_allclose(dotted.reference_linear(markers=False), bare, atol=1e-5)

    def shown(*membrane):
        without = plain.linear(*membrane) + lacking
        return (dotted.linear(*membrane) / without)[..., 0]

    straight = shown(*dent(0.01))
    np.testing.assert_allclose(straight, dots[..., 0], atol=0.02)
    moved = np.abs(shown(*dent(0.6, shear_mm=(0.4, 0.0))) - straight) > 0.1
    assert moved[np.hypot(rows - SIZE_PX[1] / 2, columns - SIZE_PX[0] / 2) < 10].mean() > 0.1
    assert moved[:3].mean() < 0.05
