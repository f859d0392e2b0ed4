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


@pytest.mark.parametrize(("loss", "case"), losses.KNOWN_LIMITS)
def test_a_known_limit_is_a_jump_of_the_published_form_too_and_not_of_the_ridge(loss: str, case: str) -> None:
    """Changes of 1e-9, far above rounding, so that no processor's rounding decides which side of a jump is seen."""

    def relative_spread(name: str) -> float:
        values = []
        for seed in range(6):
            noise = torch.randn(
                source.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
            )
            values.append(float(losses.LOSSES[name](source + 1e-9 * noise, target, True)))
        return (max(values) - min(values)) / max(values)

    source, target = trap(case).source.double(), trap(case).target.double()
    assert relative_spread(loss) > 1e-4
    assert relative_spread(f"{loss} published") > 1e-4
    assert relative_spread(f"{loss}-tikhonov") < 1e-7


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
