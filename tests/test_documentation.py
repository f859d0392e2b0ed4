"""The documentation is true: what it tells a reader to type runs, and what it names exists.

The README's commands run first, in an empty folder; every other page, and the examples of --help, run in a copy of what
they leave behind. Everything runs in its quickest form, which the tables below say how to make.
"""

import contextlib
import glob
import io
import pkgutil
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import pytest
from documented import FENCE, OTHER_PAGES, PAGES, README, ROOT, Snippet, help_examples, page_text, snippets
from quick_solves import SMALL_RANGES, coarsen, shrink_libraries
from real_clones import write_ball_clone, write_labelled_pictures, write_recordings, write_wedge_clone

from gelgap.adapt import Profile
from gelgap.cli.main import COMMANDS, main, parse
from gelgap.domains import make_recipes
from gelgap.render import MembraneRenderer, Sensor, save_sensor
from gelgap.sim import MembraneState

# --- how each is made quick ------------------------------------------------------------------------------------

SMALL = "--quality draft --size 64 48 --workers synchronous"
QUICKEST = {
    r"^make ": "make --dry-run ",
    r"^gelgap press (?!.*--quality)": "gelgap press --quality draft ",
    r"--domains 60 --frames 60": f"--domains 2 --frames 12 --ranges small.toml {SMALL}",
    r"--path cpu-random --quality draft": f"--path tiny.toml {SMALL}",
    r"--path cpu(?!-)": f"--path tiny.toml {SMALL}",
    r"from-force 20": "from-force 4",
    r"classes_from_force=20": "classes_from_force=4",
    r"PressStream\(seed=0, size_px=\(320, 240\), stop=64": 'PressStream("small.toml", seed=0, size_px=(48, 36), stop=8',
    r"PoseRanges\(0.1, 1.0, travel_mm=0.6\)": "PoseRanges(0.05, 0.55, travel_mm=0.25)",
    r'TactileSensor\("b0"': 'TactileSensor("b0", deepest_mm=0.45, farthest_mm=0.15',
    r"generate paper --out paper-data$": "generate paper --out paper-data --dry-run",
    r"generate sweep.toml": f"generate sweep.toml {SMALL}",
    r"generate gap.toml": f"generate gap.toml {SMALL}",
    r"tuned.pt --profile cpu --set split_by=clip": "tuned.pt --profile smoke",
    r"--profile cpu": "--profile smoke",
    r"--mm-per-px 0.03": "--mm-per-px 0.12",
    r"--test later/later-clips --clips 7": "--test later/later-clips --clips 2",
    r"own/mine --clips 5": "own/mine --clips 1",
    r"source_epochs=150": "source_epochs=4",
    r"guide_pictures.py docs/pictures(?! --)": "guide_pictures.py pictures --quality draft",
    r"^gelgap benchmark adaptation$": "gelgap benchmark adaptation --quick",
    r'"cpu", "data"': '"tiny.toml", "data", quality="draft", size_px=(64, 48), scheduler="synchronous"',
    r"Pose\(depth_mm=0.6, shear_x_mm=0.3\)\)": 'Pose(depth_mm=0.6, shear_x_mm=0.3), "draft")',
    r'path = "smoke"': 'path = "tiny.toml"',
}
"""What makes a command, a code block or a file quick: a pattern, and what stands in its place."""

NOT_RUN = {
    r"gelgap cache --clear": "would make the next pages solve again; tests/cli/test_cache.py runs it",
    r"gelgap demo": "tests/cli/test_demo.py runs it",
    r"gelgap benchmark physics-shapes": "tests/benchmarks/physics/test_shapes.py runs its parts",
    r"gelgap benchmark render --quick": "tests/benchmarks/render/test_accuracy.py runs it",
    r"python -m gelgap.benchmarks.adaptation.\w+(?!.* --(help|table))": "hours; its modules are looked up",
    r"python -m gelgap.benchmarks.physics.stability --only": "repeats a scene of the command before",
    r"gelgap (generate .*--lights-like|adapt --source random)": "needs a picture; tests/cli has one",
    r"gelgap (generate .*--path drags|(adapt|predict) .*recorded)": "minutes; tests/adapt/test_first_touch.py runs it",
    r"gelgap generate .* --workers tcp": "needs the cluster that tests/domains/test_cluster.py starts",
    r"pip install (--no-deps taxim|'gelgap\[view\]')": "installs a package",
    r"gelgap predict tuned.pt (--camera|p\w+)": "needs pictures or a camera; tests/adapt/test_own_backbone.py runs it",
    r"gelgap view": "serves until Ctrl-C; tests/cli/test_view.py and tests/view run it",
    r"python scripts/guide_pictures.py docs/pictures --view": "needs a browser; tests/view/test_page.py opens one",
    r"gelgap (benchmark sensors|calibrate gelsight)": "needs the package taxim, which tests do not install",
    r"git clone": "downloads; tests/real_clones.py writes such clones in small",
    r"dask (scheduler|worker)": "servers; tests/domains/test_cluster.py starts them",
    r"from dask_": "needs a cluster of that kind",
}
"""What does not run, and why. Commands of gelgap are parsed nevertheless, code is compiled."""

RUN_SLOWLY = re.compile(r"gelgap benchmark (throughput|physics|stability) --quick")
"""Run by the slow form of a page's test alone: tests/benchmarks runs the parts of these."""


def shorter(preset: Callable[[str], Profile]) -> Callable[[str], Profile]:
    """Train for a few epochs only, whatever the profile."""
    return staticmethod(lambda name: preset(name).replace(source_epochs=4, adapt_epochs=2))


TINY_PATH = """
points_x_mm = [-1.5, 1.5]
points_y_mm = [-1.0, 1.0]
depths_mm = [0.2, 0.4]
radii_mm = [0.1]
angles_deg = [0, 180]
"""


def measured_in_this_process(real: Callable) -> Callable:
    """Measure the settings of a benchmark in this process, instead of each in a fresh one."""
    return lambda *given, **options: real(*given, **options | {"workers": 1, "tasks_per_worker": None})


def smallest_recipes(_: Callable) -> Callable:
    """Make one domain of the tiny path instead of a preset's."""
    return lambda *_, **__: make_recipes(["mb0i0"], "tiny.toml", quality="draft", size_px=(64, 48))


def data_of_the_readme(_: Callable) -> Callable:
    """Take the domains that the README's commands have made instead of generating some."""
    return lambda bench, recipes, data="paired": shutil.copytree(
        "data", bench.data / data, dirs_exist_ok=True
    )


SMALLEST: dict[str, dict[str, Callable[[Any], Any]]] = {
    "gelgap calibrate": {"cli.calibrate.FOLDS": lambda real: 2},
    "gelgap benchmark physics --quick": {
        "benchmarks.physics.cases.run_missing": measured_in_this_process,
        "benchmarks.physics.accuracy.QUICK_DEPTH_MM": lambda real: 0.2,
    },
    "gelgap benchmark throughput --quick": {
        "benchmarks.throughput.recipes_of": smallest_recipes,
        "benchmarks.throughput.processor_s": lambda real: lambda work, repeats=0: real(work),
    },
    "gelgap benchmark stability --quick": {
        "benchmarks.physics.stability.QUICK_SCENES": lambda real: real[:1],
    },
    "gelgap benchmark adaptation --quick": {
        "benchmarks.adaptation.study.Study.generate": data_of_the_readme,
        "benchmarks.adaptation.groups.QUICK_METHODS": lambda real: ("source-only", "dsan"),
    },
}
"""What else is replaced in gelgap, for commands that take minutes even so."""


# --- running them ----------------------------------------------------------------------------------------------


def quickest(text: str) -> tuple[str, set[str]]:
    """Return a snippet's text in its quickest form, and the patterns of the table that it needed."""
    needed = {pattern for pattern in QUICKEST if re.search(pattern, text)}
    for pattern in QUICKEST:
        text = re.sub(pattern, QUICKEST[pattern], text)
    return text, needed


def reason_not_to_run(text: str) -> str | None:
    """Return the pattern that excuses a snippet, or None if it runs."""
    return next((pattern for pattern in NOT_RUN if re.match(pattern, text)), None)


def smallest_case(line: str) -> dict[str, Callable[[Any], Any]]:
    """Return what to replace in gelgap for a command line."""
    return next((parts for command, parts in SMALLEST.items() if line.startswith(command)), {})


def run_all(listed: list[Snippet], folder: Path, slowly: bool = False) -> None:
    """Run snippets one after another in a folder; the first that fails is named with its place."""
    with contextlib.chdir(folder):
        for snippet in listed:
            output = io.StringIO()
            try:
                with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
                    run(snippet, slowly)
            except BaseException as error:
                said = output.getvalue()[-2000:]
                raise AssertionError(f"{snippet.where}: {snippet.text}\n{error!r}\n{said}") from error


def run(snippet: Snippet, slowly: bool) -> None:
    """Run one snippet in its quickest form, or check what can be checked without."""
    left_out = not slowly and RUN_SLOWLY.match(snippet.text)
    excused = bool(left_out) or reason_not_to_run(snippet.text) is not None
    text = snippet.text if excused else quickest(snippet.text)[0]
    if snippet.kind == "file":
        Path(snippet.file_name).write_text(text)
    elif snippet.kind == "python":
        code = compile(text, snippet.where, "exec")
        if not excused:
            exec(code, {"__name__": "__main__"})
    else:
        run_command(text, excused)


def run_command(line: str, parse_only: bool) -> None:
    """Run a command line as a shell would; of a command that does not run, check that it would start."""
    words = [name for word in shlex.split(line) for name in sorted(glob.glob(word)) or [word]]
    if words[0] == "gelgap":
        with pytest.MonkeyPatch.context() as patch:
            for name, smallest in smallest_case(line).items():
                place = f"gelgap.{name}"
                patch.setattr(place, smallest(pkgutil.resolve_name(place)))
            parse(words[1:]) if parse_only else main(words[1:])
    elif words[:2] == ["python", "-m"]:
        assert find_spec(words[2]), f"there is no module {words[2]}"
        if not parse_only:
            run_program([sys.executable, *words[1:]])
    elif words[0] == "python":
        assert (ROOT / words[1]).is_file(), f"there is no file {words[1]}"
        if not parse_only:
            run_script(ROOT / words[1], words[2:])
    elif words[0] == "make":
        run_program([*words, "--directory", str(ROOT)])
    else:
        assert parse_only, f"{words[0]} is not a program that this test knows"


def run_script(path: Path, arguments: list[str]) -> None:
    """Run a script as Python would, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(path), *arguments])
        runpy.run_path(str(path), run_name="__main__")


def run_program(words: list[str]) -> None:
    done = subprocess.run(words, capture_output=True, text=True)
    print(done.stdout, done.stderr)
    assert done.returncode == 0


# --- the tests -------------------------------------------------------------------------------------------------


def examples_of_help() -> list[Snippet]:
    """Return the examples of every command's --help, in the order in which a reader needs them."""
    found = []
    for words in ([], *([command] for command in COMMANDS)):
        text = io.StringIO()
        with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit), wide_terminal():
            main([*words, "--help"])
        found += help_examples(" ".join(words), text.getvalue())
    return found


def every_snippet() -> list[Snippet]:
    """Return all that is documented."""
    return [*(snippet for page in PAGES for snippet in snippets(page)), *examples_of_help()]


@contextlib.contextmanager
def wide_terminal() -> Iterator[None]:
    """Let --help print each example in one line."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "250")
        yield


@pytest.fixture(scope="module")
def after_the_readme(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Give a folder in which the README's commands have run."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "tiny.toml").write_text(TINY_PATH)
    (folder / "small.toml").write_text(SMALL_RANGES)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GELGAP_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(Profile, "preset", shorter(Profile.preset))
        coarsen(patch)
        patch.setattr("gelgap.adapt.few_labels.NEW_SENSOR_STEPS", 4)
        shrink_libraries(patch)
        run_all(snippets(README), folder)
        yield folder


def test_the_readme_runs_in_an_empty_folder(after_the_readme: Path) -> None:
    assert (after_the_readme / "contact.png").stat().st_size > 1000
    assert (after_the_readme / "runs/report.html").is_file()


def pages() -> Iterator[Any]:
    """Yield the pages that have something to run, in their slow form if they have one."""
    for page in OTHER_PAGES:
        if snippets(page):
            yield pytest.param(page, False, id=page)
        if any(RUN_SLOWLY.match(snippet.text) for snippet in snippets(page)):
            yield pytest.param(page, True, id=f"{page}, slowly", marks=pytest.mark.slow)


@pytest.mark.parametrize(("page", "slowly"), tuple(pages()))
def test_a_page_runs(page: str, slowly: bool, after_the_readme: Path, tmp_path: Path) -> None:
    shutil.copytree(after_the_readme, tmp_path / "page")
    if any(snippet.text.startswith("gelgap calibrate") for snippet in snippets(page)):
        take_pictures_to_calibrate_with(tmp_path / "page")
    if "gelgap convert" in page_text(page):
        write_recordings_to_convert(tmp_path / "page")
    if "--source monday" in page_text(page):
        for name, folder in (("mb0i0", "monday"), ("wmb1i1", "friday")):
            write_labelled_pictures(tmp_path / "page/data" / name, tmp_path / "page" / folder)
    run_all(snippets(page), tmp_path / "page", slowly)


def test_the_examples_of_help_run(after_the_readme: Path, tmp_path: Path) -> None:
    on_pages = {snippet.text for page in PAGES for snippet in snippets(page)}
    examples = [snippet for snippet in examples_of_help() if snippet.text not in on_pages]
    assert {snippet.where.split()[1] for snippet in examples_of_help()} >= COMMANDS.keys()
    folder = tmp_path / "help"
    shutil.copytree(after_the_readme, folder)
    take_pictures_to_calibrate_with(folder)
    write_recordings_to_convert(folder)
    run_all(examples, folder)


def write_recordings_to_convert(folder: Path) -> None:
    """Write what `gelgap convert` needs: clones in small, and somebody's own clips."""
    write_wedge_clone(folder / "clones/EstimateModulus")
    write_ball_clone(folder / "clones/gelsight", presses=3)
    write_recordings(folder / "mine")
    write_recordings(folder / "later-clips")


def take_pictures_to_calibrate_with(folder: Path) -> None:
    """Write what `gelgap calibrate` needs: a sensor, its reference, and six presses at different points."""
    sensor, state = Sensor.preset("digit-like"), MembraneState.load(folder / "state.npz")
    renderer = MembraneRenderer(sensor, sensor.illumination, (160, 120))
    save_sensor(sensor, folder / "start.toml")
    cv2.imwrite(str(folder / "ref.png"), renderer.reference(markers=False)[..., ::-1])
    tables = []
    for number, (x, y) in enumerate(
        [(1.5, -0.8), (-2, 1), (0.5, 1.5), (-1.5, -1.5), (2.5, 1), (0, -2)], start=1
    ):
        picture = renderer.picture(state.x_mm + x, state.y_mm + y, state.displacement_mm, markers=False)
        cv2.imwrite(str(folder / f"press-{number}.png"), picture[..., ::-1])
        tables.append(
            f'[[presses]]\npicture = "press-{number}.png"\nsphere_diameter_mm = 3.0\ndepth_mm = 0.6\n'
            f"point_mm = [{float(x)}, {float(y)}]\n"
        )
    (folder / "presses.toml").write_text("".join(tables))
    other = (
        '[[presses]]\nindenter = "sphere"\npicture = "press-1.png"\ndepth_mm = 0.6\npoint_mm = [1.5, -0.8]\n'
    )
    (folder / "boxes.toml").write_text(other)
    (folder / "ball-pictures").mkdir()
    for path in (folder / "ref.png", *folder.glob("press-*.png")):
        shutil.copy(path, folder / "ball-pictures")


def test_no_entry_of_the_tables_is_left_over() -> None:
    documented = every_snippet()
    excused = {reason_not_to_run(snippet.text) for snippet in documented}
    run_in_quick_form = [quickest(s.text) for s in documented if reason_not_to_run(s.text) is None]
    needed = set().union(*(patterns for _, patterns in run_in_quick_form))
    assert NOT_RUN.keys() - excused == set()
    assert QUICKEST.keys() - needed == set()
    assert [key for key in SMALLEST if not any(t.startswith(key) for t, _ in run_in_quick_form)] == []


def test_every_block_is_of_a_kind_that_runs_or_shows() -> None:
    languages = {page: {block[1] for block in FENCE.finditer(page_text(page))} for page in PAGES}
    known = {"", "python", "toml", "text", "mermaid"}
    assert {page: found - known for page, found in languages.items() if found - known} == {}
