"""Settings refuse what they do not know in one sentence."""

import pytest
from pydantic import Field, model_validator

from gelgap.assets.settings import Settings


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
    assert told == "lamps.0: power: extra inputs are not permitted, did you mean power_w?"


def test_of_several_kinds_the_one_that_was_meant_is_told() -> None:
    peak = {"peak_nm": 900.0, "width_nm": 20.0}
    told = refusal(lamps=[{"power_w": -1.0}], spectrum=peak)
    lamp = "lamps.0: power_w = -1.0: input should be greater than or equal to 0"
    assert told == f"{lamp}; spectrum: peak_nm = 900.0: input should be less than or equal to 780"
    told = refusal(spectrum={"wavelength_nm": [1.0, "red"]})
    assert told.startswith("spectrum: wavelength_nm.1 = 'red': ")
    assert refusal(spectrum={"colour": 1}) == "spectrum: must have peak_nm and width_nm, or wavelength_nm"
    assert refusal(lamps=[]).startswith("lamps = []: tuple should have at least 1 item")
