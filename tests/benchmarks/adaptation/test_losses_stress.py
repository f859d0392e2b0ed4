"""The stress of the losses: what fails is a failure of the command, or explained."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from gelgap.benchmarks.adaptation import losses
from gelgap.cli.main import main


def trap(name: str) -> losses.Trap:
    torch.manual_seed(0)
    return next(found for found in losses.traps() if found.name == name)


def test_the_median_bandwidth_is_exact_beside_an_outlier() -> None:
    assert losses.stress("dan, median", trap("one outlier at 1e4")).verdict == "ok"


def test_known_limits_are_limits_still_and_of_the_published_form_too() -> None:
    for loss, case in losses.KNOWN_LIMITS:
        assert losses.stress(loss, trap(case)).verdict.isupper()
        assert losses.stress(f"{loss} published", trap(case)).verdict.isupper()


@pytest.mark.parametrize("fails", [False, True])
def test_a_loss_that_fails_ends_with_exit_code_1(
    fails: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(source: Tensor, target: Tensor, common: bool) -> Tensor:
        return source.sum() * float("nan")

    monkeypatch.setattr(losses, "traps", lambda: [trap_now])
    trap_now = losses.Trap("random", torch.rand(8, 16), torch.rand(8, 16))
    monkeypatch.setattr(losses, "LOSSES", {"coral": broken if fails else losses.LOSSES["coral"]})
    command = ["benchmark", "stability", "--what", "losses", "--quick", "--out", str(tmp_path)]
    if fails:
        with pytest.raises(SystemExit) as stop:
            main(command)
        assert stop.value.code == 1
        assert "1 of 1 cases of our losses failed: coral in random" in capsys.readouterr().err
    else:
        main(command)
    assert (tmp_path / "stability-losses.json").is_file()
