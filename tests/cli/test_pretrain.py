"""`gelgap pretrain`: drawn domains, one network, and a checkpoint that training starts from."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from quick_solves import SMALL_RANGES, shrink_libraries

from gelgap.adapt import ForceModel, Profile, train_source
from gelgap.cli.main import main
from gelgap.data import open_domain
from gelgap.data.frames.folders import domain_folders


def small_pretraining(folder: Path) -> str:
    """Return a command that takes seconds and learns little; its files are in the folder."""
    (folder / "profile.toml").write_text(
        'base = "smoke"\nwidth = 0.125\nfeature_dim = 16\nsource_epochs = 2\n'
    )
    (folder / "small.toml").write_text(SMALL_RANGES)
    sizes = f"--domains 2 --frames 12 --size 64 48 --ranges {folder}/small.toml"
    return f"pretrain {sizes} --profile {folder}/profile.toml --out {folder}/out"


def test_training_starts_from_a_pretrained_network(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    command = f"{small_pretraining(tmp_path)} --workers synchronous"
    main(command.split())
    printed = capsys.readouterr().out
    assert printed.startswith("domains  pretraining-0000, pretraining-0001")
    assert "trained on 12 frames" in printed
    assert "pretrained, unseen domains" in printed
    checkpoint = tmp_path / "out" / "pretrained.pt"
    first = checkpoint.read_bytes()

    main(command.split())
    printed = capsys.readouterr().out
    assert "now written 0 frames" in printed
    assert checkpoint.read_bytes() == first

    folders = domain_folders(tmp_path / "out" / "domains")
    assert [folder.name for folder in folders] == ["pretraining-0000", "pretraining-0001"]
    frames = open_domain(folders[0])
    assert (len(frames), frames.size_px) == (12, (64, 48))
    profile = Profile.load(tmp_path / "profile.toml").replace(source_epochs=1, source_learning_rate=1e-9)
    started = train_source(frames, profile, weights=checkpoint)
    pretrained = ForceModel.load(checkpoint)
    np.testing.assert_array_equal(started.force_range_n, pretrained.force_range_n)
    for one, other in zip(started.network.parameters(), pretrained.network.parameters(), strict=True):
        np.testing.assert_allclose(one.detach().cpu(), other.detach().cpu(), atol=1e-4)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ("--profile paper", "--size = 160 120: must be at least the 256 × 256 px of profile paper"),
        ("--frames 8", "frames_per_domain = 8: must be 9 or more"),
    ],
)
def test_what_cannot_be_trained_on_is_refused_before_it_is_made(
    refused: Callable[..., str], tmp_path: Path, options: str, sentence: str
) -> None:
    assert sentence in refused("pretrain", *options.split(), "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_network_is_pretrained_on_a_stream_without_a_data_set(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shrink_libraries(monkeypatch)
    command = f"{small_pretraining(tmp_path)} --stream"
    main([*command.split(), "--dry-run"])
    assert "training 2 epochs of 24 new frames each" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()

    main(command.split())
    assert "trained on 48 frames" in capsys.readouterr().out
    assert len(list((tmp_path / "out").iterdir())) == 2
    first = (tmp_path / "out" / "pretrained.pt").read_bytes()
    model = ForceModel.load(tmp_path / "out" / "pretrained.pt")
    assert [record["epoch"] for record in model.history] == [1, 2]

    main(command.split())
    assert (tmp_path / "out" / "pretrained.pt").read_bytes() == first

    main([*command.split(), "--seed", "1"])
    assert (tmp_path / "out" / "pretrained.pt").read_bytes() != first

    more_presses = re.sub(r"presses = \d+", "presses = 9", SMALL_RANGES)
    (tmp_path / "small.toml").write_text(more_presses)
    main(command.split())
    # Though no epoch comes to the last of them.
    assert len(list((tmp_path / "out").glob("stream-state-*.pt"))) == 3
