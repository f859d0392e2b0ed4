"""What a command says on standard error: what the rooms log, and what is kept if it is stopped."""

import json
import logging

import pytest

from gelgap.cli import main as command_line
from gelgap.cli import speaking
from gelgap.cli.main import COMMANDS, main


def test_what_rooms_log_is_said_and_the_same_work_not_again_so_soon(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speaking, "SPOKEN", logging.INFO)
    log = logging.getLogger("gelgap.domains.test")
    level = logging.getLogger("gelgap").level
    with speaking.Speaker():
        for number in range(3):
            log.info("converting %d of 3", number)
            log.warning("clip %d has no label", number % 2)
    log.info("nobody listens")
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "gelgap: converting 0 of 3",
        *(f"gelgap: clip {number} has no label" for number in range(2)),
    ]
    assert logging.getLogger("gelgap").level == level


def test_a_press_shows_its_load_steps_and_leaves_standard_output_clean(
    capsys: pytest.CaptureFixture[str], tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))
    main(["press", "--depth-mm", "0.3", "--quality", "draft", "--json"])
    captured = capsys.readouterr()
    assert json.loads(captured.out)["converged"]
    assert "load steps (draft half disc): 0 of 2" in captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["press"], "start over"),
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
