"""`--set KEY=VALUE`: what TOML files say, key by key, with one sentence for what nothing has."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from gelgap.cli.adapt import profile_keys
from gelgap.cli.contact_keys import body_keys, gel_keys
from gelgap.cli.generate import Generate
from gelgap.cli.keys import given
from gelgap.cli.main import COMMANDS, main
from gelgap.sim import Box, Elastomer, load_indenter
from gelgap.sim.shapes import BODIES, fields_of

PRESS = {"gel": gel_keys(), "body": body_keys()}


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("friction=0.4", 0.4),
        ("friction=.5", 0.5),
        ("pad-size-mm=20,16.5", [20, 16.5]),
        ("pad_size_mm=[20, 16.5]", [20, 16.5]),
        ("strain_energy=isochoric", "isochoric"),
        ("flip=true", True),
    ],
)
def test_a_value_is_what_it_is_in_toml(word: str, value: object) -> None:
    gel, body = given(((word,),), PRESS).values()
    (found,) = (gel | body).values()
    assert found == value
    assert type(found) is type(value)


def test_all_words_of_all_flags_are_told_apart_by_what_they_belong_to() -> None:
    words = (("friction=0.4", "size_mm=3,2"), ("edge_radius_mm=0.5",))
    gel, body = given(words, PRESS).values()
    assert Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, **gel).friction == 0.4
    assert load_indenter("box", **body) == Box(size_mm=(3.0, 2.0), edge_radius_mm=0.5)


def test_every_key_has_its_meaning_and_one_owner() -> None:
    assert gel_keys().keys().isdisjoint(body_keys())
    assert all(len(meaning) > 8 for keys in (*PRESS.values(), profile_keys()) for meaning in keys.values())
    assert {key for body in BODIES for key in fields_of(body)} == body_keys().keys()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set"], "--set needs KEY=VALUE"),
        (["--set", "friction"], "must be KEY=VALUE"),
        (["--set", "frictoin=1"], "did you mean friction?"),
        (["--set", "indenter_diameter_mm=3"], "did you mean diameter_mm?"),
        (["--set", "friction=1", "--set", "friction=2"], "friction is set twice"),
        (["--set", "friction=-1"], "friction = -1: must lie in [0, 1000]"),
        (["--set", "friction=much"], "friction = 'much': input should be a valid number"),
        (["--set", "tip_radius_mm=1"], "tip_radius_mm: a sphere has none; it has diameter_mm"),
    ],
)
def test_what_cannot_be_set_is_one_sentence(words: list[str], said: str, refused: Callable[..., str]) -> None:
    assert said in refused("press", *words)


def test_a_key_that_is_typed_as_an_option_is_told_how_to_set(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["press", "--young-modulus-mpa", "0.05", "--friction=0.5"])
    assert "gelgap: write --set young_modulus_mpa=0.05 friction=0.5\n" in capsys.readouterr().err


def test_help_lists_the_keys_and_presets_show_their_values(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["press", "--help"])
    said = capsys.readouterr().out
    assert all(f"\n  {key} " in said for keys in PRESS.values() for key in keys)
    main(["presets", "indenters"])
    said = capsys.readouterr().out
    assert "cone: diameter_mm=8 half_angle_deg=60 tip_radius_mm=0.4" in said
    assert "box              yaw_deg=0 tilt_deg=0,0 edge_radius_mm=0.3 size_mm=4,3" in said


def test_a_domain_is_made_with_a_gel_that_is_set(refused: Callable[..., str], tmp_path: Path) -> None:
    words = ("young_modulus_mpa=0.5", "interpolated=false", "contacts=independent")
    (own,), _ = Generate(tmp_path, ("mb1i0",), path="smoke", name="own", set=(words,)).recipes()
    assert own.elastomer == Elastomer(**Elastomer.preset("b1").model_dump() | {"young_modulus_mpa": 0.5})
    assert (own.interpolated, own.contacts) == (False, "independent")
    generate = ("generate", "mb1i0", "--out", tmp_path / "data")
    assert "--name is missing" in refused(*generate, "--set", "young_modulus_mpa=0.5")
    several = ("--indenter", "box", "sphere", "--set", "size_mm=3,2")
    assert "is a size of which of the 2 indenters?" in refused(*generate, *several)


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if command.keys()])
def test_each_command_lists_the_keys_that_it_takes_and_no_others(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        main([name, "--help"])
    said = capsys.readouterr().out.partition("Keys of --set")[2].partition("╭")[0]
    listed = set(re.findall(r"^  (\w+)  ", said, re.MULTILINE))
    keys = COMMANDS[name].keys()
    assert listed == {key for meanings in keys.values() for key in meanings}
    for key in listed:
        (values,) = filter(None, given(((f"{key}=1",),), keys).values())
        assert values == {key: 1}
