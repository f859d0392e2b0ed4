"""Settings refuse what they do not know in one sentence."""

import pytest

from gelgap.assets.settings import Settings


class Lamp(Settings):
    power_w: float = 1.0


@pytest.mark.parametrize("field", ["self", "power", "model_config"])
def test_an_unknown_field_is_named_whatever_it_is_called(field: str) -> None:
    with pytest.raises(ValueError, match=f"^{field}: extra inputs are not permitted$"):
        Lamp(**{field: 1.0})
