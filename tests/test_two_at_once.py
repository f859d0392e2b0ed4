"""Real processes at the same time on one cache or one output: each thing is made once, and none of them fails."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from picture_folders import forces_of, write_pictures

from gelgap.cli.main import main
from gelgap.data import ArrayFrames

PROCESSES = 2
SOLVE = """
import sys
from gelgap.sim import Elastomer, Pose, Sphere, solve_pose
from gelgap.sim import newton
solve, solved = newton.solve, []
newton.solve = lambda problem, progress: (solved.append(1), solve(problem, progress))[1]
gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
state = solve_pose(gel, Sphere(), Pose(depth_mm=0.1), "draft")
print(len(solved), float(state.force_n[2]))
"""


def several_processes(code: str, cache: Path) -> list[list[str]]:
    """Run processes at the same time and return the words that each printed."""
    children = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env=os.environ | {"GELGAP_CACHE": str(cache)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(PROCESSES)
    ]
    ended = [child.communicate(timeout=300) for child in children]
    assert [child.returncode for child in children] == [0] * PROCESSES, ended
    return [out.split() for out, _ in ended]


def test_several_processes_on_a_cold_cache_solve_once(tmp_path: Path) -> None:
    printed = several_processes(SOLVE, tmp_path)
    assert sorted(count for count, _ in printed) == ["0"] * (PROCESSES - 1) + ["1"]
    assert len({force for _, force in printed}) == 1
    assert [path.suffix for path in tmp_path.iterdir()] == [".solution"]


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """A folder of pictures with a table."""
    images = np.random.default_rng(0).integers(0, 255, (40, 96, 128, 3), dtype=np.uint8)
    frames = ArrayFrames("pictures", images, images[0], np.tile([0.0, 0.0, -0.5], (40, 1)))
    return write_pictures(tmp_path / "pictures", frames, **forces_of(frames))


def held(folder: Path, name: str = ".lock") -> subprocess.Popen:
    """Return a process that holds the lock of an output folder."""
    code = (
        "import sys, pathlib\nfrom gelgap.assets.locks import sole_use\n"
        f"with sole_use(pathlib.Path({str(folder)!r}), {name!r}):\n    print('held', flush=True); sys.stdin.read()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "held\n"
    return child


@pytest.mark.parametrize(
    ("arguments", "folder", "lock"),
    [
        (["benchmark", "physics", "--quick", "--out", "OUT"], "", ".lock-physics"),
        (["report", "OUT"], "", ".lock"),
        (["export", "DATA", "--out", "OUT/export"], ".export.building", ".lock"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_second_process_on_one_output_is_refused_and_says_by_whom(
    arguments: list[str],
    folder: str,
    lock: str,
    pictures: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture,
) -> None:
    out = tmp_path / "out"
    (out / "run").mkdir(parents=True)
    (out / "run" / "run.json").write_text("{}")
    first = held(out / folder, lock)
    try:
        places = {"OUT": str(out), "DATA": str(pictures), "OUT/export": str(out / "export")}
        with pytest.raises(SystemExit) as stop:
            main([places.get(argument, argument) for argument in arguments])
    finally:
        first.communicate("")
    assert stop.value.code == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert f"another process (pid {first.pid}) is writing to {out / folder}" in error, json.dumps(error)


PAUSED = """
import importlib, sys
module = importlib.import_module({module!r})
whole = module.{function}
def pausing(*given, **named):
    print("at work", flush=True)
    sys.stdin.readline()
    return whole(*given, **named)
module.{function} = pausing
from gelgap.cli.main import main
main({arguments!r})
"""
SMALL_PROFILE = """
base = "smoke"
width = 0.125
source_epochs = 1
adapt_epochs = 1
"""


def paused(arguments: list[str], module: str, function: str) -> subprocess.Popen:
    """Return a real command that has come to a function, and goes on when it is sent a line."""
    code = PAUSED.format(arguments=arguments, module=module, function=function)
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    child = subprocess.Popen([sys.executable, "-c", code], text=True, **streams)
    assert child.stdout.readline() == "at work\n", child.communicate("")
    return child


def second(arguments: list[str], capsys: pytest.CaptureFixture) -> tuple[int, str, str]:
    """Run a command in this process at the same time; return its exit code, its output and its errors."""
    code = 0
    try:
        main(arguments)
    except SystemExit as stop:
        code = stop.code
    return code, *capsys.readouterr()


@pytest.fixture
def two_domains(pictures: Path) -> tuple[Path, Path]:
    """Folders of pictures with forces that differ."""
    lines = [f"{number}.png,{number % 5 / 50},{number % 7 / -50},{number / -40}" for number in range(40)]
    (pictures / "table.csv").write_text("\n".join(["image,fx_n,fy_n,fz_n", *lines]))
    target = pictures.with_name("target")
    shutil.copytree(pictures, target)
    return pictures, target


@pytest.mark.slow
def test_two_adaptations_on_one_output(
    two_domains: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    source, target = map(str, two_domains)
    profile, runs = tmp_path / "small.toml", tmp_path / "runs"
    profile.write_text(SMALL_PROFILE)
    adapting = ["adapt", "--source", source, "--target", target, "--method", "source-only"]
    adapting += ["--profile", str(profile), "--out", str(runs)]
    first = paused(adapting, "gelgap.adapt.runs", "train_source")
    code, _, refused = second(adapting, capsys)
    out, err = first.communicate("\n", timeout=300)
    assert code == 1
    (sentence,) = (line for line in refused.splitlines() if "another process" in line)
    assert f"(pid {first.pid}) is writing to {runs}" in sentence
    assert first.returncode == 0, err
    code, again, err = second(adapting, capsys)
    assert code == 0, err
    assert again.strip() == out.strip()
