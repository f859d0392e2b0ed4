"""Settings refuse what they do not know in one sentence."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import Field, model_validator

from gelgap.assets.settings import Settings
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.sim import Elastomer


class Lamp(Settings):
    power_w: float = Field(1.0, ge=0)


class Peak(Settings):
    peak_nm: float = Field(le=780)
    width_nm: float


class Table(Settings):
    wavelength_nm: tuple[float, ...]

    @model_validator(mode="after")
    def _check(self) -> "Table":
        return self


class Bulb(Settings):
    number: int = 1
    power_w: float = 1.0
    place_mm: tuple[float, float] = (0, 0)
    name: str = ""
    is_on: bool = True


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("power_w = true", "power_w = True: "),
        ('power_w = "0.3"', "power_w = '0.3': "),
        ("number = 2.0", r"number = 2\.0: "),
        ('place_mm = [1, "2"]', r"place_mm\.1 = '2': "),
        ("is_on = 1", "is_on = 1: "),
    ],
)
def test_a_value_of_another_type_is_refused_by_file_and_field(tmp_path: Path, values: str, message: str):
    (tmp_path / "bulb.toml").write_text(values)
    with pytest.raises(ValueError, match=rf"bulb\.toml: {message}"), named_in_errors(tmp_path / "bulb.toml"):
        Bulb(**read_toml(tmp_path / "bulb.toml"))


def test_whole_numbers_lists_and_numbers_of_numpy_are_taken(tmp_path: Path):
    (tmp_path / "bulb.toml").write_bytes(b"\xef\xbb\xbfpower_w = 5\nplace_mm = [1, 2.5]\n")
    bulb = Bulb(**read_toml(tmp_path / "bulb.toml"), number=np.int64(3))
    assert (bulb.power_w, bulb.place_mm, bulb.number) == (5.0, (1.0, 2.5), 3)
    assert Bulb(power_w=np.float32(0.5), place_mm=tuple(np.ones(2, np.float32))).place_mm == (1, 1)


def test_a_large_file_is_refused_by_its_size(tmp_path: Path):
    (tmp_path / "large.toml").write_text("a = 1\n" + "#" * 2**20)
    with pytest.raises(ValueError, match=r"large\.toml has 1048582 bytes; TOML files have at most 1048576"):
        read_toml(tmp_path / "large.toml")


class Lamps(Settings):
    lamps: tuple[Lamp, ...] = Field((), min_length=1)
    spectrum: Peak | Table | None = None


@pytest.mark.parametrize("field", ["self", "colour", "model_config"])
def test_an_unknown_field_is_named_whatever_it_is_called(field: str) -> None:
    with pytest.raises(ValueError, match=f"^{field}: extra inputs are not permitted$"):
        Lamp(**{field: 1.0})


def refusal(**values: object) -> str:
    with pytest.raises(ValueError) as error:  # noqa: PT011
        Lamps(**values)
    return str(error.value)


def test_a_field_that_is_nearly_one_is_asked_about() -> None:
    told = refusal(lamps=[{"power": 1.0}])
    assert told == "lamps.0: power: extra inputs are not permitted; did you mean power_w?"


def test_of_several_kinds_the_one_that_was_meant_is_told() -> None:
    peak = {"peak_nm": 900.0, "width_nm": 20.0}
    told = refusal(lamps=[{"power_w": -1.0}], spectrum=peak)
    lamp = "lamps.0: power_w = -1.0: input should be greater than or equal to 0"
    assert told == f"{lamp}; spectrum: peak_nm = 900.0: input should be less than or equal to 780"
    told = refusal(spectrum={"wavelength_nm": [1.0, "red"]})
    assert told.startswith("spectrum: wavelength_nm.1 = 'red': ")
    assert refusal(spectrum={"colour": 1}) == "spectrum: must have peak_nm and width_nm, or wavelength_nm"
    assert refusal(lamps=[]).startswith("lamps = (): tuple should have at least 1 item")


def test_settings_are_named_by_preset_or_file_or_are_there(tmp_path: Path) -> None:
    (tmp_path / "gel.toml").write_text("young_modulus_mpa = 0.2\npoisson_ratio = 0.48\nfriction = 0.5\n")
    gel = Elastomer.named(tmp_path / "gel.toml")
    assert Elastomer.named(str(tmp_path / "gel.toml")).young_modulus_mpa == 0.2
    assert Elastomer.named(gel) is gel
    assert Elastomer.named("b0") == Elastomer.preset("b0")
