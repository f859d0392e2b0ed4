"""Own gels, lights, profiles and methods from the command line."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from picture_folders import forces_of, write_pictures

from gelgap.adapt.methods import registry
from gelgap.cli.generate import Generate
from gelgap.cli.main import main
from gelgap.data import ArrayFrames
from gelgap.domains import make_recipes, own_recipe
from gelgap.sim import Elastomer, Sphere

GEL = 'description = "soft"\nyoung_modulus_mpa = 0.2\npoisson_ratio = 0.48\nfriction = 0.5\nthickness_mm = 4.0\n'
LAMP = """[[leds]]
name = "left"
kind = "disc"
position_mm = [-12.0, 0.0, -5.0]
facing = [1.0, 0.0, 0.3]
diameter_mm = 4.0
spectrum = { cct_k = 6500.0 }
drive = 6.0
"""
METHOD = '''"""A method of one's own."""
from gelgap.adapt import Method

class Half(Method):
    """Half the distance of the means."""

    def transfer_loss(self, source, target):
        return 0.5 * (source.features.mean(dim=0) - target.features.mean(dim=0)).square().sum()

number = 3
'''


def test_an_own_gel_and_light_make_a_named_domain(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "gel.toml").write_text(GEL)
    (tmp_path / "lamp.toml").write_text(LAMP)
    main(
        f"generate wmb1i1 --elastomer {tmp_path}/gel.toml --illumination {tmp_path}/lamp.toml --name soft --path smoke "
        f"--size 64 48 --dry-run --out {tmp_path}/data".split()
    )
    assert "domains  soft" in capsys.readouterr().out
    assert not (tmp_path / "data").exists()


def test_a_picture_without_contact_makes_domains_in_lights_like_its(
    capsys: pytest.CaptureFixture[str],
    refused: Callable[..., str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("gelgap.domains.drawn_lights.CANDIDATES", 20)
    cv2.imwrite(str(tmp_path / "reference.png"), np.full((48, 64, 3), 120, np.uint8))
    (tmp_path / "lamp.toml").write_text(LAMP)
    command = f"generate wmb0i0 --lights-like {tmp_path}/reference.png --dry-run --path smoke".split()
    command += f"--size 64 48 --out {tmp_path}/data".split()
    main([*command, "--name", "mine", "--illumination", str(tmp_path / "lamp.toml")])
    assert "domains  mine-1, mine-2, mine-3, mine-4\n" in capsys.readouterr().out
    assert "--name is missing" in refused(*command)


def test_forces_beyond_the_declared_range_are_told_before_solving_and_a_range_mends_it(
    capsys: pytest.CaptureFixture[str], refused: Callable[..., str], tmp_path: Path
) -> None:
    command = ["generate", "mb0i0", "--path", "cpu", "--set", "diameter_mm=20", "--dry-run"]
    main([*command, "--size", "64", "48", "--out", str(tmp_path / "data")])
    (note,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note")]
    assert "the deepest press of mb0i0 takes about" in note
    assert "declared Fz = -3 N" in note
    ranges = note.partition(" --range ")[2].split()
    main([*command, "--size", "64", "48", "--out", str(tmp_path / "data"), "--range", *ranges])
    assert "note" not in capsys.readouterr().out
    (recipe,), _ = Generate(tmp_path, ("mb0i0",), range=("fz_n=-40:0",)).recipes()
    assert recipe.force_range_n == ((-0.75, 0.75), (-0.75, 0.75), (-40.0, 0.0))
    said = refused(*command, "--out", tmp_path / "data", "--range", "depth_mm=0:1")
    assert "depth_mm is no axis of the force" in said


def test_another_sphere_makes_the_domain_and_one_too_small_for_the_path_is_refused(
    refused: Callable[..., str], tmp_path: Path
) -> None:
    (recipe,), _ = Generate(tmp_path, ("mb0i0",), path="smoke", set=(("diameter_mm=42",),)).recipes()
    assert recipe.indenter == Sphere(diameter_mm=42.0)
    command = ["generate", "mb0i0", "--path", "smoke", "--workers", "synchronous", "--set"]
    for value, problem in (("0.6", "depth_mm = 0.6: must be in [0, 0.3] mm"), ("60", "[0.5, 50] mm")):
        assert problem in refused(*command, f"diameter_mm={value}", "--out", tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_what_is_not_given_is_the_named_domains() -> None:
    (base,) = make_recipes(["wmb0i0"], "smoke", seed=3)
    gel = Elastomer.preset("b1")
    own = own_recipe("soft", "smoke", base="wmb0i0", elastomer=gel, seed=3)
    assert own.elastomer == gel
    assert own.inpainted_from is None
    same = {"illumination", "sensor", "markers", "path", "seed", "size_px"}
    assert own.model_dump(include=same) == base.model_dump(include=same)


@pytest.mark.parametrize(("name", "words"), [("mb0i0", "presets"), ("../x", "letters"), ("x" * 200, "128")])
def test_a_name_that_means_something_else_is_refused(name: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        own_recipe(name, "smoke", elastomer=Elastomer.preset("b1"))


def test_a_wrong_gel_names_its_file_and_field(tmp_path: Path) -> None:
    (tmp_path / "gel.toml").write_text(GEL.replace("0.48", "0.5"))
    with pytest.raises(ValueError, match=r"gel\.toml: poisson_ratio = 0\.5"):
        Elastomer.load(tmp_path / "gel.toml")


def test_a_wrong_table_in_a_file_is_not_printed_whole(refused: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "lamp.toml").write_text(LAMP.replace('kind = "disc"\n', 'kind = "disc"\nbrightness = 3\n'))
    lamp, data = tmp_path / "lamp.toml", tmp_path / "data"
    message = refused("generate", "mb0i0", "--illumination", lamp, "--name", "x", "--out", data)
    assert "lamp.toml" in message
    assert "brightness" in message
    assert "facing" not in message


@pytest.fixture
def pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in a folder with 30 random pictures and forces in `real`, a small profile and a method."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (30, 48, 64, 3), np.uint8)
    frames = ArrayFrames("real", images, images[0], rng.uniform([0, 0, -1], [0.5, 0.1, 0], (30, 3)))
    write_pictures(tmp_path / "real", frames, **forces_of(frames))
    (tmp_path / "mine.toml").write_text(
        'base = "smoke"\nsource_epochs = 1\nadapt_epochs = 1\nbatch_size = 8\n'
    )
    (tmp_path / "own.py").write_text(METHOD)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "OWN_METHODS", {})
    return tmp_path


ADAPT = ["adapt", "--source", "real", "--target", "real", "--profile", "mine.toml", "--method"]


def test_an_own_profile_and_method_run(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main([*ADAPT, "own.py:Half"])
    assert "own.Half" in capsys.readouterr().out
    (record,) = (pictures / "runs").glob("real-real-own.Half-0-*/run.json")
    run = json.loads(record.read_text())
    assert run["profile"]["name"] == "mine"
    assert (run["profile"]["source_epochs"], run["profile"]["width"]) == (1, 0.25)


def test_a_method_that_fails_does_not_stop_the_others_and_the_command_fails_at_the_end(
    pictures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (pictures / "fails.py").write_text(
        "from gelgap.adapt import FeatureCollapse, Method\n\nclass Fails(Method):\n    def adapt(self, adaptation):\n"
        '        raise FeatureCollapse("a constant predictor")\n'
    )
    for _ in range(2):
        with pytest.raises(SystemExit) as stop:
            main([*ADAPT, "source-only", "fails.py:Fails", "own.py:Half"])
        assert stop.value.code == 1
        out, err = capsys.readouterr()
        first_words = [line.split()[0] for line in out.splitlines()[2:]]
        assert first_words[:5] == ["constant", "quadratic", "ridge", "source-only", "own.Half"]
        assert "fails.Fails: a constant predictor" in out
        assert err.splitlines()[-1] == "gelgap: 1 of 3 methods failed: fails.Fails"
    assert len(list((pictures / "runs").glob("real-real-*/run.json"))) == 3


def test_changed_code_is_another_run(pictures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    registry.use_method("own.py:Half")
    before = registry.method_code("own.Half")
    other = pictures / "other"
    other.mkdir()
    (other / "own.py").write_text(METHOD.replace("0.5", "0.7"))
    monkeypatch.setattr(registry, "OWN_METHODS", {})
    registry.use_method("other/own.py:Half")
    assert before is not None
    assert registry.method_code("own.Half") != before
    assert registry.method_code("dsan") is None
    with pytest.raises(ValueError, match=r"the name own\.Half is taken by another method"):
        registry.use_method("own.py:Half")


def test_code_that_changed_in_the_meantime_runs_as_it_is_now(pictures: Path) -> None:
    for words in ("Half the", "Full the"):
        (pictures / "own.py").write_text(METHOD.replace("Half the", words))
        os.utime(pictures / "own.py", (1e9, 1e9))
        registry.use_method("own.py:Half")
    assert registry.find_method("own.Half").__doc__ == "Full the distance of the means."


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("beside.py:Half", "No module named 'own'); name a .py file, and what it defines; files"),
        ("own.py", "FILE.py:CLASS"),
        ("absent.py:Half", "absent.py could not be run (FileNotFoundError"),
        ("own.py:Third", "Third is not a class of own.py that extends gelgap.adapt.Method; it has Half"),
        ("own.py:number", "number is not a class"),
        ("own:Half", "has left: gelgap 0.3.0 is the last version that has it; name its file, FILE.py:CLASS"),
        ("rsd", "method 'rsd' has left: gelgap 0.3.0 is the last version that has it"),
        ("fourier-style", "method 'fourier-style' has left: gelgap 0.3.0 is the last version that has it"),
    ],
)
def test_no_method_is_bad_input(method: str, words: str, pictures: Path, refused: Callable[..., str]) -> None:
    (pictures / "beside.py").write_text("from own import Half")
    assert words in refused(*ADAPT, method)
    assert not (pictures / "runs").exists()


def test_a_method_of_an_installed_package_is_named_with_its_file_now(
    pictures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    metadata = pictures / "offered-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: offered\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[gelgap.methods]\nhalf = offered_methods:Half\n")
    monkeypatch.syspath_prepend(str(pictures))
    with pytest.raises(
        ValueError, match=r"'half' has left: gelgap 0\.3\.0 .*; name its file, FILE\.py:CLASS"
    ):
        registry.find_method("half")
    with pytest.raises(
        ImportError, match=r"register has left: gelgap 0\.3\.0 is the last version that has it"
    ):
        from gelgap.adapt import register  # noqa: F401


def test_the_constant_mean_trains_nothing_and_stands_once_in_the_table(
    pictures: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def trained(*_: object, **__: object) -> None:
        raise AssertionError("a network was trained")

    monkeypatch.setattr("gelgap.adapt.runs.train_source", trained)
    main([*ADAPT, "constant-mean"])
    out = capsys.readouterr().out
    assert (out.count("constant mean"), out.count("constant-mean")) == (1, 0)
    assert not list((pictures / "runs").glob("stage1/*.pt"))
    (record,) = (pictures / "runs").glob("*/run.json")
    run = json.loads(record.read_text())
    assert run["target_test"]["mae"] == pytest.approx(run["target_constant_mean"]["mae"], rel=1e-5, abs=1e-7)
