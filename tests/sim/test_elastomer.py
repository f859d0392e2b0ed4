"""Elastomers and indenters: presets, and bad values named with their range."""

import pytest

from gelgap.assets import list_presets
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.sphere import Sphere

GEL = {"young_modulus_mpa": 0.3, "poisson_ratio": 0.49, "friction": 0.8}


def test_every_preset_loads() -> None:
    assert {"b0", "b1", "b2", "e02", "e04", "e08"} <= set(list_presets("elastomers"))
    for name in list_presets("elastomers"):
        Elastomer.preset(name)


def test_paper_like_gels_get_harder_with_their_index() -> None:
    moduli = [Elastomer.preset(name).young_modulus_mpa for name in ("b0", "b1", "b2")]
    assert moduli == sorted(moduli)


def test_pure_modulus_gels_differ_in_nothing_else() -> None:
    rest = {
        tuple(Elastomer.preset(n).model_dump(exclude={"young_modulus_mpa"}).items())
        for n in ("e02", "e04", "e08")
    }
    assert len(rest) == 1


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("young_modulus_mpa", -1.0),
        ("poisson_ratio", 0.5),
        ("poisson_ratio", -0.1),
        ("friction", -0.1),
        ("thickness_mm", 0.0),
        ("pad_size_mm", (0.0, 5.0)),
        ("mount_stiffness_n_per_mm", -3.0),
        ("young_modulus_mpa", float("nan")),
    ],
)
def test_a_bad_value_is_named(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        Elastomer(**{**GEL, field: value})


def test_the_message_gives_value_and_range() -> None:
    with pytest.raises(ValueError, match=r"poisson_ratio = 0\.5: must lie in \[0, 0\.5\)"):
        Elastomer(**{**GEL, "poisson_ratio": 0.5})


def test_unknown_presets_list_the_known_ones() -> None:
    with pytest.raises(ValueError, match="b0"):
        Elastomer.preset("b9")


def test_a_sphere_has_a_size() -> None:
    assert Sphere(diameter_mm=4.0).radius_mm == 2.0
    with pytest.raises(ValueError, match="diameter_mm"):
        Sphere(diameter_mm=0.0)
