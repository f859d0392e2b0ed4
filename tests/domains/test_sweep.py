import json
from pathlib import Path

import pytest

from gelgap.data.facts import unseen_differences
from gelgap.domains.gap import domain_gap
from gelgap.domains.generation.plan import plan_generation
from gelgap.domains.recipe import facts_of, make_recipes
from gelgap.domains.sweep import Sweep
from gelgap.render import Markers, Sensor


def load(tmp_path: Path, text: str) -> Sweep:
    (tmp_path / "soft.toml").write_text(text)
    return Sweep.load(tmp_path / "soft.toml")


GRID = """
base = "mb0i0"
path = "smoke"
[[factors]]
field = "elastomer.young_modulus_mpa"
change = "scale"
values = [0.5, 2.0]
[[factors]]
field = "markers"
values = [true, false]
"""


def test_a_grid_crosses_its_factors_and_records_the_gap(tmp_path: Path):
    variants = load(tmp_path, GRID).variants(size_px=(80, 60))
    assert [variant.recipe.name for variant in variants] == ["mb0i0", *(f"soft-00{k}" for k in (1, 2, 3, 4))]
    table = json.loads(Sweep.write_gaps(variants, tmp_path / "out").read_text())
    gaps = [domain["gap"] for domain in table["domains"].values()]
    assert [gap["modulus_ratio"] for gap in gaps] == [1, 0.5, 0.5, 2, 2]
    assert [gap["markers"] for gap in gaps] == ["equal", "equal", "removed", "equal", "removed"]
    assert [gap["colour_difference"] for gap in gaps] == [0] * 5
    assert gaps[2]["fields"] == ["name", "elastomer.young_modulus_mpa", "markers"]


def test_variants_that_differ_in_light_alone_share_all_their_solves(tmp_path: Path):
    text = 'base = "mb0i0"\n[[factors]]\nfield = "illumination.leds.*.drive"\nchange = "scale"\nvalues = [0.7, 1.2]\n'
    variants = load(tmp_path, text).variants(size_px=(80, 60))
    recipes = [variant.recipe for variant in variants]
    assert len(plan_generation(recipes).solves) == len(plan_generation(recipes[:1]).solves)
    drives = [[led.drive for led in recipe.illumination.leds] for recipe in recipes]
    assert drives[1] == pytest.approx([0.7 * drive for drive in drives[0]])
    table = json.loads(Sweep.write_gaps(variants, tmp_path / "out").read_text())
    _, *gaps = (domain["gap"] for domain in table["domains"].values())
    assert min(gap["colour_difference"] for gap in gaps) > 1


def test_a_latin_hypercube_fills_its_ranges_and_repeats(tmp_path: Path):
    text = """
    base = "wmb0i0"
    method = "latin-hypercube"
    samples = 8
    [[factors]]
    field = "elastomer.young_modulus_mpa"
    range = [0.2, 1.0]
    [[factors]]
    field = "acquisition.tilt_deg"
    range = [0.0, 1.0]
    """
    sweep = load(tmp_path, text)
    points = list(sweep.points())
    assert points == list(sweep.points())
    cells = sorted(int((point["elastomer.young_modulus_mpa"] - 0.2) / 0.1) for point in points)
    assert cells == list(range(8))
    variant = sweep.variants()[1].recipe
    assert variant.inpainted_from == "soft-001-with-markers"


def test_one_at_a_time_changes_one_at_a_time(tmp_path: Path):
    sweep = load(tmp_path, GRID.replace('path = "smoke"', 'method = "one-at-a-time"'))
    assert [len(variant.values) for variant in sweep.variants()] == [0, 1, 1, 1, 1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "elastomer.young_modulus_mpa",
            "elastomer.stiffness",
            r"'stiffness' does not exist; there is young_",
        ),
        ("elastomer.young_modulus_mpa", "illumination.leds.9.drive", r"'9' does not exist; there is \*, 0…"),
        ("[0.5, 2.0]", "[-1.0]", r"young_modulus_mpa = -0.7.*must lie in"),
        ("[0.5, 2.0]", '["stiff"]', "both must be numbers"),
        ('base = "mb0i0"', 'base = "mb0i0"\nmethod = "latin-hypercube"', "needs its range"),
    ],
)
def test_a_wrong_sweep_says_what_is_wrong(tmp_path: Path, old: str, new: str, message: str):
    with pytest.raises(ValueError, match=message):
        load(tmp_path, GRID.replace(old, new)).variants()


def test_leds_and_coat_are_drawn_around_the_base_and_repeat(tmp_path: Path):
    text = 'base = "mb0i0"\nsamples = 3\nseed = 5\n[variation]\nled_drive = 0.2\nyellowing = 0.5\n'
    once, again = (load(tmp_path, text).variants(size_px=(80, 60)) for _ in range(2))
    assert [one.recipe for one in once] == [other.recipe for other in again]
    base, *drawn = [variant.recipe for variant in once]
    assert len({recipe.illumination.model_dump_json() for recipe in (base, *drawn)}) == 4
    assert all(recipe.sensor.coating.albedo[2] < recipe.sensor.coating.albedo[0] for recipe in drawn)
    assert len(plan_generation((base, *drawn)).solves) == len(plan_generation([base]).solves)
    assert once[2].values == {"draw": 2}
    with_factor = text.replace("[variation]", "[[factors]]\nfield = 'markers'\nvalues = [false]\n[variation]")
    (_, variant) = load(tmp_path, with_factor).variants(size_px=(80, 60))
    assert not variant.recipe.markers
    assert variant.recipe.illumination == drawn[0].illumination
    with pytest.raises(ValueError, match="needs factors, a variation, or both"):
        load(tmp_path, 'base = "mb0i0"\n')


def test_the_gap_says_how_markers_differ():
    sensor = Sensor.preset("paper")
    (base,) = make_recipes(["mb0i0"], "smoke", size_px=(80, 60))
    changed, removed = Markers(pitch_mm=(1.1, 1.3)), Markers(layout="none")
    for expected, markers in {"equal": sensor.markers, "changed": changed, "removed": removed}.items():
        own = sensor.model_copy(update={"markers": markers})
        (other,) = make_recipes(["mb0i0"], "smoke", size_px=(80, 60), sensor=own)
        assert domain_gap(base, other).markers == expected
        notes = unseen_differences("base", facts_of(base), "other", facts_of(other))
        said = any("no markers" in note for note in notes)
        assert said == (expected == "removed")


def test_markers_lie_on_the_pad():
    sensor = Sensor.preset("paper").model_copy(update={"markers": Markers(positions_mm=((0, 0), (13.0, 0)))})
    with pytest.raises(ValueError, match=r"positions_mm.1 = \(13.0, 0.0\): .* on the pad .* 24 × 20 mm"):
        make_recipes(["mb0i0"], "smoke", sensor=sensor)
