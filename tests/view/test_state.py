"""The live model does what a change needs, and shows what a picture made anew shows."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gelgap.render import Illumination, MembraneRenderer, Sensor
from gelgap.sim import Cone, Elastomer, Pose, PoseLibrary, load_indenter, solve_pose
from gelgap.view.pictures import SIZE_PX
from gelgap.view.state import Configuration, LiveModel

SOFT = Elastomer.preset("e02")


def brighter(start: Configuration) -> Configuration:
    first, *others = start.illumination.leds
    leds = (first.model_copy(update={"drive": 2 * first.drive}), *others)
    return replace(start, illumination=start.illumination.model_copy(update={"leds": leds}))


SEEN = {"light", "picture"}
CHANGES: dict[str, tuple[Callable[[Configuration], Configuration], set[str]]] = {
    "nothing": (lambda start: start, set()),
    "drive": (brighter, SEEN),
    "illumination": (lambda start: replace(start, illumination=Illumination.preset("i2")), SEEN),
    "sensor": (lambda start: replace(start, sensor=Sensor.preset("digit-like")), SEEN),
    "markers": (lambda start: replace(start, markers=False), SEEN),
    "noise": (lambda start: replace(start, noise=True), SEEN),
    "modulus": (lambda start: replace(start, elastomer=SOFT), {"force"}),
    "depth": (lambda start: replace(start, pose=Pose(depth_mm=0.45)), {"membrane", *SEEN}),
    "friction": (
        lambda start: replace(start, elastomer=start.elastomer.model_copy(update={"friction": 0.2})),
        {"membrane", *SEEN},
    ),
    "modulus of a gel on a spring": (
        lambda start: replace(start, elastomer=Elastomer.preset("b0")),
        {"membrane", *SEEN},
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_needs_no_more_than_its_work(change: str, model: LiveModel, start: Configuration) -> None:
    changed, stages = CHANGES[change]
    model.show(start)
    assert model.show(changed(start)).stages_ms.keys() == stages


@pytest.mark.parametrize("change", ["drive", "illumination", "sensor", "markers", "noise", "depth"])
def test_the_picture_is_that_of_a_renderer_made_anew(
    change: str, model: LiveModel, start: Configuration
) -> None:
    model.show(start)
    shown = model.show(CHANGES[change][0](start))
    configuration, state = shown.configuration, shown.solved
    renderer = MembraneRenderer(configuration.sensor, configuration.illumination, SIZE_PX)
    rng = np.random.default_rng(0) if configuration.noise else None
    anew = renderer.picture(state.x_mm, state.y_mm, state.displacement_mm, configuration.markers, rng)
    np.testing.assert_array_equal(shown.picture, anew)


def test_light_leaves_the_physics_alone(model: LiveModel, start: Configuration) -> None:
    before, after = model.show(start), model.show(brighter(start))
    assert after.solved is before.solved
    assert after.picture[..., 0].mean() > before.picture[..., 0].mean() + 5


def test_modulus_scales_the_force_and_keeps_the_picture(model: LiveModel, start: Configuration) -> None:
    before, after = model.show(start), model.show(replace(start, elastomer=SOFT))
    np.testing.assert_allclose(after.solved.force_n, before.solved.force_n / 2, rtol=1e-9)
    assert after.picture is before.picture


def test_a_gel_without_a_library_says_so_and_shows_the_one_before(
    model: LiveModel, start: Configuration, dents: PoseLibrary
) -> None:
    other = CHANGES["friction"][0](start)
    model.show(start)
    shown = model.show(other)
    assert "until this gel is solved" in shown.source
    assert shown.solved.force_n[2] < 0
    request = model.lacks(other)
    assert request.elastomer == other.elastomer
    model.add_library(request, dents)
    assert model.lacks(other) is None
    assert "interpolated" in model.show(other).source


def test_before_anything_is_solved_the_membrane_is_flat(start: Configuration) -> None:
    shown = LiveModel().show(start)
    assert not shown.solved.displacement_mm.any()
    assert "no contact is shown" in shown.source


def test_a_pose_solved_by_itself_is_shown_until_the_contact_changes(
    model: LiveModel, start: Configuration
) -> None:
    drawn = model.show(start)
    model.add_pose(start.exact_pose, solve_pose(start.elastomer, start.indenter, Pose(depth_mm=0.0)))
    exact = model.show(start)
    assert exact.exact
    assert exact.source == "this pose, solved at standard"
    assert (exact.picture != drawn.picture).any()
    assert model.show(replace(start, markers=False)).exact
    moved = model.show(replace(start, pose=Pose(depth_mm=0.5)))
    assert not moved.exact
    assert moved.solved.force_n[2] < 0
    assert model.show(start).exact


def test_the_edge_of_the_pad_is_not_passed_over_in_silence(model: LiveModel, start: Configuration) -> None:
    assert "edge" not in model.show(start).source
    assert "edge" in model.show(replace(start, pose=Pose(depth_mm=0.5, point_x_mm=5.0))).source


def test_a_pose_beyond_the_library_is_refused(model: LiveModel, start: Configuration) -> None:
    with pytest.raises(ValueError, match=r"depth_mm = 1\.2: the library ends at 1 mm"):
        model.show(replace(start, pose=Pose(depth_mm=1.2)))


def test_a_body_without_a_library_is_shown_once_its_pose_is_solved(
    model: LiveModel, start: Configuration
) -> None:
    ring = replace(start, indenter=load_indenter("ring"), pose=Pose(depth_mm=0.0))
    model.show(start)
    assert model.lacks(ring) is None
    assert not model.show(ring).exact
    solved = solve_pose(ring.elastomer, ring.indenter, ring.pose)
    model.add_pose(ring.exact_pose, solved)
    shown = model.show(ring)
    assert shown.exact
    assert shown.solved is solved


def test_no_other_bodys_library_stands_in(model: LiveModel, start: Configuration) -> None:
    model.show(start)
    cone = replace(start, indenter=Cone(diameter_mm=8.0))
    assert model.lacks(cone) == cone.library
    assert not model.show(cone).solved.force_n.any()


def test_a_pressure_is_the_mean_of_half_a_millimetre(model: LiveModel, start: Configuration) -> None:
    shown = replace(model.show(start), solved=SimpleNamespace(pressure_mpa=1.0 * np.diag(np.arange(9) == 4)))
    assert shown.pressure_mpa.max() == pytest.approx(1 / 25)
