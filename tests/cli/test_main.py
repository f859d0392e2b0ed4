"""The command line: what it prints, its exit codes, and one-line errors that say what would be right."""

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.cli.main import COMMANDS, main


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = 0
    try:
        main(arguments)
    except SystemExit as stop:
        code = stop.code or 0
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["press", "--depth-mm", "-0.1"], ("depth_mm", "-0.1")),
        (["press", "--depth-mm", "2.9"], ("depth_mm", "2.9")),
        (["press", "--depth-mm", "0.2", "--force-n", "0.2"], ("depth_mm", "force_n")),
        (["press", "--force-n", "-1"], ("--force-n", "-1")),
        (["press", "--mesh", "out.stl"], (".glb, .ply",)),
        (["press", "--set", "poisson_ratio=0.5"], ("poisson_ratio", "0.5")),
        (["press", "--point-mm", "13", "0"], ("point_x_mm", "12")),
        (["press", "--set", "young_modulus_mpa=0"], ("young_modulus_mpa", "0.001")),
        (["press", "--elastomer", "b7"], ("b7", "b0, b1, b2")),
        (["press", "--elastomer", "gel.toml"], ("gel.toml does not exist",)),
        (["press", "--indenter", "tip.stl"], ("tip.stl does not exist",)),
        (["generate", "--out", "never"], ("data set", "TOML")),
        (["generate", "huge", "--out", "never"], ("huge", "smoke")),
        (["generate", "mb0i0", "smoke", "--out", "never"], ("smoke", "name it alone")),
        (["generate", "s.toml", "--out", "never"], ("s.toml", "does not exist")),
        (["generate", "mb0i0", "--seed", "-1", "--out", "never"], ("--seed", "-1", "0")),
        (["generate", "mb0i0", "--dry-run", "--workers", "0", "--out", "never"], ("--workers", "0", "1")),
        (["generate", "mb0i0", "--elastomer", "b1", "--out", "never"], ("--name",)),
        (["generate", "--name", "mb0i0", "--elastomer", "b1", "--out", "never"], ("mb0i0", "presets")),
        (["adapt", "--source", ".", "--target", ".", "--out", "x", "--method"], ("--method", "dsan")),
        (["generate", "papre", "--out", "never"], ("papre", "did you mean paper?")),
        (["press", "--save", "/proc/state.npz"], ("--save", "/proc cannot be written to")),
        (["press", "--save", "state.csv"], ("--save", "must end in .npz")),
        (["press", "--save="], ("a value is empty", "press --save=")),
        (["adapt", "--method", "dan", "--method", "dsan"], ("--method is given twice",)),
        (["render", "state.npz", "-o", "a.png", "--out=b.png"], ("--out is given twice",)),
        (["generate", "mb0i0", "--dry-run", "--name", "ä", "--elastomer", "b1", "--out", "x"], ("accents",)),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    words: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run(arguments, capsys)
    assert code == 2
    assert out == ""
    assert err.startswith("gelgap: ")
    assert err.count("\n") == 1
    assert all(word in err for word in words), err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["press", "--quality", "superb"], ("superb", "standard")),
        (["press", "--depth-mm", "deep"], ("--depth-mm", "deep")),
        (["press", "--depth-mm", "0,6"], ("0,6: write 0.6, with a decimal point", "a space parts two")),
        (["press", "--depth-mm=0.6mm"], ("0.6mm: write 0.6, ", "no unit")),
        (["press", "--depht-mm", "1"], ("--depht-mm", "--depth-mm")),
        (["press", "--shear-mm", "1"], ("--shear-mm", "2 values")),
        (["generate", "mb0i0"], ("Missing", "--out")),
        (["generate", "--out"], ("Missing value", "--out")),
        (["generat"], ("generat", "press", "generate")),
    ],
)
def test_words_that_do_not_parse_are_told_by_tyro_with_exit_code_2(arguments, words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    code, out, err = run(arguments, capsys)
    assert (code, out) == (2, "")
    assert all(word in err for word in words), err


SCRIPT = (sys.executable, "-m", "gelgap.cli.start")


@pytest.mark.parametrize(
    ("arguments", "unbuffered"),
    [(["--version"], "1"), (["generate", "--help"], ""), (["presets"], "")],
    ids=str,
)
def test_output_that_nobody_reads_or_that_finds_no_room_is_no_traceback(arguments, unbuffered, monkeypatch):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    reader, closed = os.pipe()
    os.close(reader)
    ended = subprocess.run([*SCRIPT, *arguments], stdout=closed, stderr=subprocess.PIPE, text=True)
    os.close(closed)
    assert ended.returncode == 0 or arguments == ["presets"]
    assert "Traceback" not in ended.stderr
    with open("/dev/full", "w") as full:
        ended = subprocess.run([*SCRIPT, *arguments], stdout=full, stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 1
    assert ended.stderr.startswith("gelgap: what is printed cannot be written (No space left on device)")
    assert ended.stderr.count("\n") == 1


def test_a_result_that_could_not_be_told_is_not_computed(tmp_path):
    command = f"{' '.join(SCRIPT)} press --save {tmp_path / 'state.npz'} >&-"
    ended = subprocess.run(command, shell=True, stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr) == (
        2,
        "gelgap: standard output is closed, and results are printed there; open it\n",
    )
    assert not list(tmp_path.iterdir())


def test_an_ascii_terminal_gets_the_result(monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    ended = subprocess.run([*SCRIPT, "presets"], capture_output=True)
    assert ended.returncode == 0, ended.stderr
    assert rb"\xd7" in ended.stdout


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        ValueError("Error: engine error: Could not allocate memory"),
        ImportError("a.so: failed to map segment from shared object"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_little_memory_is_no_bad_input(error, capsys, monkeypatch):
    def solve(self, started):
        raise error

    monkeypatch.setattr(COMMANDS["press"], "run", solve)
    code, _, err = run(["press"], capsys)
    assert code == 1
    assert err.startswith("gelgap: out of memory (")


def test_a_cache_that_is_a_file_is_refused_first(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cache").write_text("")
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    code, out, err = run(["press"], capsys)
    assert (code, out) == (2, "")
    assert f"GELGAP_CACHE = '{tmp_path / 'cache'}'" in err


def test_bad_names_are_refused_without_torch(tmp_path: Path) -> None:
    """Importing torch takes seconds."""
    program = (
        "import sys\nfrom gelgap.cli.main import main\n"
        "try: main('adapt --source . --target . --method dsn'.split())\n"
        "except SystemExit as stop: sys.exit(0 if stop.code == 2 and 'torch' not in sys.modules else 1)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "did you mean dsan?" in done.stderr


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"], capsys) == (0, f"gelgap {version('gelgap')}\n", "")


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="depth_mm"):
        main(["press", "--depth-mm", "-1", "--debug"])


def test_press_prints_the_contract_and_render_draws_what_it_saved(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    state, picture, linear = tmp_path / "state.npz", tmp_path / "out.png", tmp_path / "linear.npy"
    press = ["press", "--depth-mm", "0.4", "--shear-mm", "0.2", "0", "--quality", "draft", "--json"]
    code, out, _ = run([*press, "--save", str(state)], capsys)
    report = json.loads(out)
    assert code == 0
    assert {"force_n", "converged", "contact_radius_mm", "wall_s", "settings"} <= report.keys()
    assert report["converged"]
    assert report["force_n"][2] < 0 < report["force_n"][0]
    with np.load(state) as arrays:
        assert arrays["displacement_mm"].shape == (len(arrays["y_mm"]), len(arrays["x_mm"]), 3)
        np.testing.assert_allclose(arrays["force_n"], report["force_n"])
        assert arrays["contact"].any()
    render = ["render", str(state), "--illumination", "i1", "--size", "160", "120"]
    code, _, _ = run([*render, "-o", str(picture), "--linear", str(linear)], capsys)
    assert code == 0
    assert cv2.imread(str(picture)).shape == (120, 160, 3)
    values = np.load(linear)
    assert values.dtype == np.float32
    assert values.shape == (120, 160, 3)


def test_render_writes_the_height_map(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    x_mm, y_mm = 0.1 * np.arange(-70, 71), 0.1 * np.arange(-55, 56)
    dent = -0.8 * np.exp(-(x_mm**2) - y_mm[:, None] ** 2)
    state, picture = str(tmp_path / "state.npz"), str(tmp_path / "picture.png")
    for deep, name, expected in ((1.0, "heights.npy", 0), (1.0, "heights.png", 0), (9.0, "deep.png", 2)):
        displacement = np.stack([0 * dent, 0 * dent, deep * dent], axis=-1)
        converged = deep < 9
        np.savez(state, x_mm=x_mm, y_mm=y_mm, displacement_mm=displacement, converged=converged)
        size = ["--size", "80", "60", "--quality", "draft"]
        code, _, err = run(
            ["render", state, *size, "--height-map", str(tmp_path / name), "-o", picture], capsys
        )
        assert code == expected
        assert ("did not converge" in err) is not converged
    assert "a 16-bit height map holds -0.5 to 6.05 mm, and heights are" in err
    assert not (tmp_path / "deep.png").exists()
    height_mm = np.load(tmp_path / "heights.npy")
    assert height_mm.shape == (60, 80)
    assert 0.7 < height_mm.max() < 0.81
    codes = cv2.imread(str(tmp_path / "heights.png"), cv2.IMREAD_UNCHANGED)
    assert codes.dtype == np.uint16
    np.testing.assert_allclose(-0.5 + 1e-4 * codes, height_mm, atol=1e-4)


def test_render_says_what_file_it_needs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.npz"
    wrong.write_bytes(b"plain text")
    code, _, err = run(["render", str(wrong), "-o", str(tmp_path / "out.png")], capsys)
    assert code == 2
    assert "is not an .npz file" in err
    assert "displacement_mm (ny, nx, 3), as written by: gelgap press --save state.npz" in err


def test_every_preset_is_listed_with_what_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(["presets"], capsys)
    assert code == 0
    assert all(name in out for name in ("b0", "b2", "i0", "i2", "paper", "sparse"))
    presets = [line for line in out.splitlines() if line.startswith("  ")]
    assert presets
    assert [line for line in presets if len(line.split(maxsplit=1)) < 2] == []


def test_help_tells_defaults_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    for command in ([], *([name] for name in COMMANDS if name != "benchmark")):
        code, out, _ = run([*command, "--help"], capsys)
        assert code == 0
        noise = [word for word in ("{None", "None)", "False)", "Default ") if word in out]
        assert noise == [], command


def test_a_sweep_file_is_planned(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    sweep = tmp_path / "light.toml"
    sweep.write_text('base = "mb0i0"\npath = "smoke"\n[[factors]]\nfield = "markers"\nvalues = [false]\n')
    command = ["generate", str(sweep), "--size", "64", "48", "--out", str(tmp_path / "data")]
    code, out, err = run([*command, "--dry-run"], capsys)
    assert code == 0, err
    assert "mb0i0, light-001" in out
    assert not (tmp_path / "data").exists()


def test_a_home_that_takes_no_cache_is_named(capsys, monkeypatch):
    monkeypatch.delenv("GELGAP_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    code, out, err = run(["press"], capsys)
    assert (code, out) == (2, "")
    assert "the folder of the cache, '/proc/nowhere/gelgap': /proc cannot be written to" in err
    assert "name another in GELGAP_CACHE" in err


def test_a_command_stopped_while_it_reads_its_arguments_ends_with_a_sentence(monkeypatch, capsys):
    def stopped(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("gelgap.cli.main.parse", stopped)
    assert run(["press"], capsys) == (130, "", "gelgap: interrupted; run the same command again\n")
