"""A sensor predicts with a share of its table of normals, under its own light alone."""

from pathlib import Path

import numpy as np
import pytest

from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render.flat_field import FlatField, FlatFieldMaps, save_maps
from gelgap.render.light.leds import Illumination
from gelgap.render.normal_table import NormalTable
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Markers, Sensor
from gelgap.render.variation import Variation, vary_sensor

SIZE_PX = (160, 120)


@pytest.fixture
def sensor(tmp_path: Path) -> Sensor:
    save_maps(FlatFieldMaps(np.full((*SIZE_PX[::-1], 3), 0.9, np.float32)), tmp_path / "flat.npz")
    rows = 20 * np.random.default_rng(0).standard_normal((27, 3))
    update = {
        "markers": Markers(layout="none"),
        "flat_field": FlatField(file="flat.npz").found_in(tmp_path),
        "normal_table": tuple(map(tuple, rows.tolist())),
    }
    return Sensor.preset("digit-like").model_copy(update=update)


def with_share(sensor: Sensor, share: float) -> MembraneRenderer:
    own = sensor.model_copy(update={"table_share": share})
    return MembraneRenderer(own, own.illumination, SIZE_PX)


def test_a_whole_share_is_the_tables_picture_and_a_part_lies_between(sensor: Sensor) -> None:
    lit, half, whole = (with_share(sensor, share) for share in (0.0, 0.5, 1.0))
    press = sphere_dent(0.4)
    table = NormalTable(np.array(sensor.normal_table), sensor.camera.footprint_mm(SIZE_PX)[0] / 2)
    expected = table.picture(lit.reference(), lit.normal_map(*press), sensor.camera).astype(int)
    light, mixed, tabled = (one.picture(*press).astype(int) for one in (lit, half, whole))
    assert np.abs(light - expected).max() > 20
    assert np.abs(tabled - expected).max() <= 2
    low, high = np.minimum(light, tabled), np.maximum(light, tabled)
    assert ((mixed >= low - 1) & (mixed <= high + 1)).all()
    np.testing.assert_array_equal(whole.reference(), lit.reference())


def test_under_another_light_the_table_counts_for_nothing(sensor: Sensor) -> None:
    other, press = Illumination.preset("i1"), sphere_dent(0.4)
    lit, whole = with_share(sensor, 0.0), with_share(sensor, 1.0)
    np.testing.assert_array_equal(whole.relit(other).picture(*press), lit.relit(other).picture(*press))
    back = whole.relit(other).relit(sensor.illumination)
    np.testing.assert_array_equal(back.picture(*press), whole.picture(*press))
    assert vary_sensor(whole.sensor, Variation(), np.random.default_rng(0)).table_share == 0


def test_a_share_needs_a_table_and_a_flat_field() -> None:
    with pytest.raises(ValueError, match=r"table_share = 0\.5 must be 0 without normal_table and flat_field"):
        Sensor(table_share=0.5)
