"""What a command says while it works: on standard error, without delay, and what is kept if it is stopped."""

import io
import json
import logging
import threading
import time

import pytest

from gelgap.cli import main as command_line
from gelgap.cli import speaking
from gelgap.cli.main import COMMANDS, main


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A speaker that counts in hundredths of a second."""
    monkeypatch.setattr(speaking, "QUIET_S", 0.03)
    monkeypatch.setattr(speaking, "_LOOK_S", 0.005)


def wait_for(stream: io.StringIO, words: str) -> None:
    deadline = time.monotonic() + 30
    while words not in stream.getvalue():
        assert time.monotonic() < deadline, stream.getvalue()
        time.sleep(0.005)


@pytest.mark.usefixtures("impatient")
def test_long_work_is_announced_by_what_is_known_of_it() -> None:
    stream, log = io.StringIO(), logging.getLogger("gelgap.sim.test")
    with speaking.Speaker("press: preparing", stream):
        wait_for(stream, "press: preparing")
        log.info("solving: %d of 3", 1)
        wait_for(stream, "solving: 1 of 3")
        for step in range(50):
            log.info("solving: %d of 3", step)
    # About the same work there is no second line so soon.
    assert stream.getvalue().splitlines() == ["gelgap: press: preparing", "gelgap: solving: 1 of 3"]


def test_short_work_and_other_users_of_logging_are_left_in_peace() -> None:
    stream, level = io.StringIO(), logging.getLogger("gelgap").level
    with speaking.Speaker("press: preparing", stream):
        logging.getLogger("gelgap.sim").info("solving")
    assert stream.getvalue() == ""
    assert logging.getLogger("gelgap").level == level
    assert not [h for h in logging.getLogger("gelgap").handlers if isinstance(h, speaking.Speaker)]


class SlowStream(io.StringIO):
    """A stream that takes a while for each line, and says when one has begun."""

    def __init__(self) -> None:
        super().__init__()
        self.begun = threading.Event()

    def write(self, text: str) -> int:
        self.begun.set()
        time.sleep(0.1)
        return super().write(text)


@pytest.mark.usefixtures("impatient")
def test_a_line_that_has_begun_is_whole_before_the_command_says_how_it_ended() -> None:
    stream = SlowStream()
    with speaking.Speaker("press: preparing", stream):
        assert stream.begun.wait(30)
    assert stream.getvalue() == "gelgap: press: preparing\n"


def test_a_warning_is_said_at_once() -> None:
    stream = io.StringIO()
    with speaking.Speaker("render: preparing", stream):
        logging.getLogger("gelgap.render").warning("numba compiles")
        assert stream.getvalue() == "gelgap: numba compiles\n"


@pytest.mark.usefixtures("impatient")
def test_a_press_tells_its_load_steps_and_leaves_standard_output_clean(
    capsys: pytest.CaptureFixture[str], tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))
    main(["press", "--depth-mm", "0.3", "--quality", "draft", "--json"])
    captured = capsys.readouterr()
    assert json.loads(captured.out)["converged"]
    assert "solving (draft half disc)" in captured.err
    assert "of 2 load steps" in captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["press"], "start over"),
        (["render", "a.npz", "-o", "b.png"], "start over"),
        (["generate", "mb0i0", "--out", "o"], "finished shards and solves are kept"),
        (["adapt", "--source", "a", "--target", "b"], "finished runs and epochs are kept"),
        (["export", "a", "--out", "o"], "only solved physics is sure to be kept"),
        (["benchmark", "physics", "--quick"], "what keeps records goes on from them"),
    ],
    ids=" ".join,
)
def test_an_interrupted_command_says_what_is_true_of_it(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(self, started: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(COMMANDS[arguments[0]], "run", stop)
    monkeypatch.setattr(command_line, "check_values", lambda command: None)
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == command_line.EXIT_INTERRUPTED
    error = capsys.readouterr().err
    assert error.startswith("gelgap: interrupted; ")
    assert words in error
    assert error.count("\n") == 1
