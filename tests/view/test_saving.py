"""What the page saves is what the other commands take."""

from dataclasses import replace
from pathlib import Path

import pytest

from gelgap.domains import domain_gap, load_recipes
from gelgap.render import Illumination, Sensor
from gelgap.sim import Elastomer
from gelgap.view.panels import compare
from gelgap.view.pictures import PictureMaker
from gelgap.view.saving import recipe_toml, sensor_files, settings_toml
from gelgap.view.state import Configuration


@pytest.fixture
def target(start: Configuration) -> Configuration:
    gel = Elastomer(**{**dict(start.elastomer), "young_modulus_mpa": 0.8})
    return replace(start, elastomer=gel, illumination=Illumination.preset("i2"), markers=False)


def test_saved_parts_read_back(start: Configuration, tmp_path: Path) -> None:
    (tmp_path / "gel.toml").write_bytes(settings_toml(start.elastomer))
    assert Elastomer.load(tmp_path / "gel.toml") == start.elastomer
    (tmp_path / "light.toml").write_bytes(settings_toml(start.illumination))
    assert Illumination.load(tmp_path / "light.toml") == start.illumination
    for name, content in sensor_files(Sensor.preset("gelsight-r1-fitted")).items():
        (tmp_path / name).write_bytes(content)
    read = Sensor.load(tmp_path / "sensor.toml")
    assert read.camera == Sensor.preset("gelsight-r1-fitted").camera
    assert Path(read.flat_field.file).is_file()


def test_a_recipe_holds_both_domains(start: Configuration, target: Configuration, tmp_path: Path) -> None:
    file = tmp_path / "gap.toml"
    file.write_bytes(recipe_toml(start, target))
    source, other = load_recipes(file, quality="draft")
    assert (source.name, other.name) == ("source", "target")
    assert (source.markers, other.markers) == (True, False)
    assert other.inpainted_from is None
    assert other.elastomer == target.elastomer
    assert other.illumination == target.illumination
    assert source.sensor == start.sensor
    assert {source.quality, other.quality} == {"draft"}


def test_the_gap_on_the_page_is_that_of_the_domains(
    start: Configuration, target: Configuration, tmp_path: Path
) -> None:
    (tmp_path / "gap.toml").write_bytes(recipe_toml(start, target))
    recorded = domain_gap(*load_recipes(tmp_path / "gap.toml"))
    seen = compare(start, target, PictureMaker())
    assert seen.modulus_ratio == pytest.approx(recorded.modulus_ratio)
    assert seen.colour_difference == pytest.approx(recorded.colour_difference, abs=1e-3)
    assert seen.colour_difference_p95 == pytest.approx(recorded.colour_difference_p95, abs=1e-3)
    assert seen.markers == recorded.markers == "removed"
    for sensor, said in (("digit-like", "removed"), ("gelsight-mini-like", "changed")):
        assert compare(start, replace(start, sensor=Sensor.preset(sensor)), PictureMaker()).markers == said


def test_a_sensor_that_a_recipe_cannot_hold_is_refused(start: Configuration) -> None:
    fitted = Sensor.preset("gelsight-r1-fitted").model_copy(update={"name": "mine"})
    with pytest.raises(ValueError, match="flat field"):
        recipe_toml(start, replace(start, sensor=fitted))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace('"target"', '"source"'), "named twice"),
        (lambda text: text.replace("friction = 0.5", "friction = -1.0"), "friction"),
        (lambda text: text.replace('path = "cpu"', 'path = "../cpu.toml"'), "below the working folder"),
    ],
)
def test_a_bad_recipe_is_refused_with_its_name(change, said, start, target, tmp_path: Path) -> None:
    file = tmp_path / "gap.toml"
    file.write_text(change(recipe_toml(start, target).decode()))
    with pytest.raises(ValueError, match=r"gap\.toml") as refused:
        load_recipes(file)
    assert said in str(refused.value)
