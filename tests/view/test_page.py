"""The page in a real browser: knobs are turned, and picture and force change."""

import queue
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from loaded_file import load_file

from gelgap.sim import Pose, PoseLibrary, solve_pose
from gelgap.view.solver import Answer, Failed, Progress, Request, SolvedAlone, SolvedLibrary
from gelgap.view.state import Configuration, PoseRequest

pytest.importorskip("viser")
PICTURES = load_file(Path(__file__).parents[2] / "scripts" / "guide_pictures.py")

needs_browser = pytest.mark.skipif(
    find_spec("playwright") is None or PICTURES.find_chromium() is None,
    reason="no browser: pip install playwright; apt-get install chromium",
)


class FakeSolver:
    """Answers at once: with a library in closed form, or with a failure while `reason` is given."""

    def __init__(self, on_answer: Callable[[Answer], None], library: PoseLibrary) -> None:
        self._on_answer, self._library = on_answer, library
        self.requests: queue.Queue[Request] = queue.Queue()
        self.reason = ""

    def request(self, request: Request) -> None:
        self.requests.put(request)
        self._on_answer(Progress(request, 1, 2))
        if self.reason:
            self._on_answer(Failed(request, self.reason))
            return
        if isinstance(request, PoseRequest):
            flat = solve_pose(request.elastomer, request.indenter, Pose(depth_mm=0.0))
            self._on_answer(SolvedAlone(request, flat))
        else:
            self._on_answer(SolvedLibrary(request, self._library))

    def close(self) -> None:
        pass


@pytest.fixture
def page(start: Configuration, dents: PoseLibrary, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    from gelgap.view.page import Page

    monkeypatch.setattr("gelgap.view.page.Solver", lambda on_answer: FakeSolver(on_answer, dents))
    page = Page(start, "127.0.0.1", 0)
    yield page
    page.close()


def settled(page: Any, sure: Callable[[], bool]) -> None:
    """Let the model's thread work until something holds."""
    done: queue.Queue[None] = queue.Queue()
    for _ in range(200):
        page.do(lambda: done.put(None))
        done.get(timeout=300)
        if sure():
            return
    raise AssertionError("the page did not come to show it")


def test_turned_knobs_change_picture_and_force(page: Any) -> None:
    settled(page, lambda: page.shown is not None and "interpolated" in page.shown.source)
    before = page.shown
    page.controls.depth.value = 0.9
    settled(page, lambda: page.shown.configuration.pose.depth_mm == 0.9)
    assert page.shown.solved.force_n[2] < before.solved.force_n[2] < 0
    assert (page.shown.picture != before.picture).any()
    page.controls.elastomer.value = "e08"
    settled(page, lambda: page.shown.configuration.elastomer.young_modulus_mpa == 0.8)
    assert page.controls.modulus.value == 0.8
    page.controls.move_led(1, (8.0, 1.0, -4.0))
    settled(page, lambda: page.shown.configuration.illumination.leds[1].position_mm == (8.0, 1.0, -4.0))
    assert page.controls.illumination.value == "own"
    assert page.controls.place.value == (8.0, 1.0, -4.0)
    page.controls.illumination.value = "i2"
    settled(page, lambda: len(page.shown.configuration.illumination.leds) == 4)
    page.controls.sensor.value = "digit-like"
    settled(page, lambda: page.shown.configuration.sensor.name == "digit-like")
    assert page.controls.illumination.value == "own"


def test_a_dragged_led_is_not_put_back_under_the_hand(page: Any) -> None:
    settled(page, lambda: page.shown is not None and page._scene._leds)
    control = page._scene._leds[1]
    for phase, place in (("start", (10.0, 0.0, -3.0)), ("update", (9.0, 0.5, -3.0))):
        control.position = place
        page._scene._dragged(1)(SimpleNamespace(phase=phase, target=control))
    control.position = (8.0, 0.5, -3.0)
    settled(page, lambda: page.shown.configuration.illumination.leds[1].position_mm == (9.0, 0.5, -3.0))
    assert tuple(control.position) == (8.0, 0.5, -3.0)
    assert page.controls.led.value.startswith("2:")
    page._scene._dragged(1)(SimpleNamespace(phase="end", target=control))
    settled(page, lambda: page.shown.configuration.illumination.leds[1].position_mm == (8.0, 0.5, -3.0))


def test_a_value_beyond_a_knob_widens_its_range(page: Any) -> None:
    stiff = page.controls.wanted.elastomer.model_copy(update={"young_modulus_mpa": 8.0})
    page.controls.set_configuration(replace(page.controls.wanted, elastomer=stiff))
    assert (page.controls.modulus.value, page.controls.modulus.max) == (8.0, 16.0)
    assert page.controls.elastomer.value == "own"


def test_a_number_typed_beyond_a_slider_becomes_its_end_with_a_sentence(page: Any) -> None:
    settled(page, lambda: page.shown is not None and "interpolated" in page.shown.source)
    page.controls.depth.value = 1309.0
    assert page.controls.wanted.pose.depth_mm == 0.6
    page.controls._put_back(page.controls.depth)
    assert page.controls.depth.value == page.controls.wanted.pose.depth_mm == 1.0
    assert "1309 lies outside 0 to 1: 1 is shown" in page._readout.message.content


def test_a_knob_changes_nothing_but_its_own_value(page: Any) -> None:
    """Travel and direction are shown rounded; turning the depth turned the drag to what they show."""
    pose = Pose(depth_mm=0.7, shear_x_mm=0.35, shear_y_mm=-0.15)
    page.controls.set_configuration(replace(page.controls.wanted, pose=pose))
    page.controls.depth.value = 0.9
    assert page.controls.wanted.pose == replace(pose, depth_mm=0.9)
    page.controls.direction.value = 90
    assert page.controls.wanted.pose.radius_mm == pytest.approx(pose.radius_mm, abs=1e-6)
    assert page.controls.wanted.pose.angle_deg == pytest.approx(90.0)


def test_what_cannot_be_leaves_the_page_as_it_was(page: Any) -> None:
    settled(page, lambda: page.shown is not None and "interpolated" in page.shown.source)
    wanted = page.controls.wanted
    page.controls.move_led(0, (-11.0, 0.0, 1.0))
    assert page.controls.wanted == wanted
    assert "z" in page._readout.message.content


def test_a_failed_solve_is_said_and_the_page_lives_on(page: Any) -> None:
    settled(page, lambda: page.shown is not None and "interpolated" in page.shown.source)
    page._solver.reason = "it <did> not converge"
    page.controls.friction.value = 0.2
    settled(page, lambda: "the solve failed: it &lt;did&gt; not" in page._readout.message.content)
    page._solver.reason = ""
    page.controls.friction.value = 0.3
    settled(page, lambda: "interpolated" in page.shown.source)
    page.controls.solve.value = True
    settled(page, lambda: page.shown.exact)


def test_a_source_is_set_beside_the_target(page: Any) -> None:
    settled(page, lambda: page.shown is not None and "interpolated" in page.shown.source)
    page.do(page._keep_source)
    page.controls.elastomer.value = "e08"
    settled(page, lambda: ">2<" in page._compare.figures.content)
    assert page._compare.figures.content.count("interpolated between poses solved at draft") == 2
    page.controls.illumination.value = "i2"
    settled(page, lambda: ">0.00<" not in page._compare.figures.content)
    page.do(page._swap)
    settled(page, lambda: page.shown.configuration.elastomer.young_modulus_mpa == 0.4)
    assert page.controls.elastomer.value == "e04"


@needs_browser
def test_arrow_keys_on_a_slider_do_not_reach_the_camera(page: Any) -> None:
    """viser's camera listens to the keys of the document."""
    settled(page, lambda: page.shown is not None)
    depth_mm = page.controls.depth.value
    with PICTURES.browser_page(page.address) as browser:
        browser.evaluate(
            "window.heard = 0; document.addEventListener('keydown', () => { window.heard += 1; })"
        )
        browser.locator("[role=slider]").first.press("ArrowRight")
        settled(page, lambda: page.controls.depth.value > depth_mm)
        assert browser.evaluate("window.heard") == 0
        browser.evaluate("document.activeElement.blur()")
        browser.keyboard.press("ArrowRight")
        assert browser.evaluate("window.heard") == 1


def test_a_narrow_window_has_picture_and_force_above_the_knobs_and_no_negative_zero(page: Any) -> None:
    settled(page, lambda: page.shown is not None and "interpolated" in page.shown.source)
    text = page._narrow.content
    assert "@media (min-width" in text
    assert "data:image/jpeg;base64," in text
    assert "-0.000" not in text
    assert "sphere 3 mm" in text
    assert "Fz" in text


@needs_browser
def test_in_a_browser(page: Any) -> None:
    with PICTURES.browser_page(page.address) as browser:
        browser.get_by_text("interpolated").first.wait_for()

        def force() -> str:
            return browser.locator("tr", has_text="Fz").first.inner_text()

        def picture() -> str:
            return browser.locator("img").first.get_attribute("src")

        force_before, picture_before = force(), picture()
        depth = browser.get_by_role("slider").first
        depth.focus()
        for _ in range(5):
            depth.press("ArrowRight")
        browser.wait_for_function(
            "before => !document.body.innerText.includes(before)", arg=force_before.split("\t")[-1]
        )
        settled(page, lambda: page.shown.configuration.pose.depth_mm == pytest.approx(0.65))
        assert force() != force_before
        browser.wait_for_function("before => document.querySelector('img').src != before", arg=picture_before)
        assert browser.locator("canvas").count()
