"""A network on a few labelled frames or clips of other data, as somebody's own recordings."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from picture_folders import write_pictures

from gelgap.adapt import ForceModel, evaluate, finetune
from gelgap.adapt.evaluation import Evaluation
from gelgap.adapt.few_labels import Pretraining
from gelgap.cli.main import main
from gelgap.data import open_domain


@pytest.fixture(scope="module")
def checkpoint(stage1, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("checkpoint") / "pretrained.pt"
    stage1.save(path)
    return path


@pytest.fixture(scope="module")
def recordings(target, tmp_path_factory) -> Path:
    """Eight clips of a softer gel, whose table has nothing but Fz."""
    clips = [f"clip-{number % 8}" for number in range(len(target))]
    fz_n = (0.6 * target.force_n[:, 2]).round(4)
    return write_pictures(tmp_path_factory.mktemp("recordings"), target, fz_n=fz_n, clip=clips)


def test_a_few_labelled_clips_lower_the_error_on_the_others(checkpoint, recordings):
    found = finetune(checkpoint, recordings, recordings, clips=2)
    assert found.model.labels.names == ("fz_n",)
    assert found.model.labels.ranges == ((-3.0, 0.0),)
    assert (found.frames, found.after.n) == (24, 72)
    assert found.after.mae[0] < 0.7 * found.before.mae[0]
    assert found.after.mae[0] < found.constant_mean.mae[0]
    assert "no better" not in str(found)
    assert "fill little" not in str(found)
    small = replace(found, after=found.constant_mean, range_used=(0.012,))
    assert "labels fill little of the network's ranges (Fz 1.2 % of fz_n=-3:0)" in str(small)
    assert "fine-tuning is no better than the mean of the labelled frames" in str(small)


def test_a_pretrained_network_that_learnt_nothing_says_so(checkpoint):
    good, poor = (Evaluation(9, (e,) * 3, (100 * e,) * 3, (0.5,) * 3) for e in (0.1, 0.2))
    assert "no better than the constant mean" in str(Pretraining(checkpoint, 90, 0, poor, good))
    assert "no better" not in str(Pretraining(checkpoint, 90, 0, good, poor))


def test_frames_beyond_the_range_of_the_network_are_left_out_and_counted(checkpoint, recordings, tmp_path):
    own = Path(shutil.copytree(recordings, tmp_path / "own"))
    header, *rows = (recordings / "table.csv").read_text().splitlines()
    for row in (3, 90):
        name, _, clip = rows[row].split(",")
        rows[row] = f"{name},0.14,{clip}"
    (own / "table.csv").write_text("\n".join([header, *rows]))
    found = finetune(checkpoint, own, own, frames=12)
    assert found.left_out == 2
    assert found.frames + found.after.n == 94
    assert "left out: 2 frames with a label outside fz_n=-3:0" in str(found)


def test_the_command_prints_errors_and_keeps_the_network(checkpoint, recordings, tmp_path, capsys):
    words = [str(checkpoint), "--on", str(recordings), "--test", str(recordings)]
    main(["finetune", *words, "--frames", "10", "--out", str(tmp_path / "tuned.pt")])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "errors on 86 other frames"
    assert lines[1].split() == ["MAE", "Fz/N", "mean", "R²", "Fz"]
    assert [line.split()[0] for line in lines[2:]] == ["mean", "no", "fine-tuned", "wrote"]
    after = float(lines[4].split()[1])
    drawn_too = evaluate(ForceModel.load(tmp_path / "tuned.pt"), open_domain(recordings)).mae[0]
    assert drawn_too == pytest.approx(after, rel=0.3)


def test_pictures_of_another_aspect_are_squeezed_and_said_to_be(checkpoint, recordings, caplog):
    network = replace(ForceModel.load(checkpoint), size_px=(40, 40))
    network.save(other := checkpoint.with_name("square.pt"))
    with pytest.raises(ValueError, match="must be 1 to 96"):
        finetune(other, recordings, recordings, frames=999)
    assert f"{recordings.name} has another aspect than the model: it is squeezed" in caplog.messages


def test_bad_choices_are_refused(checkpoint, recordings):
    with pytest.raises(ValueError, match=r"clips = 9 of .*: must be 1 to 8"):
        finetune(checkpoint, recordings, recordings, clips=9)
    with pytest.raises(ValueError, match="all of its 96 frames are drawn"):
        finetune(checkpoint, recordings, recordings, frames=96)
    with pytest.raises(ValueError, match="give one of the two"):
        finetune(checkpoint, recordings, recordings, frames=3, clips=1)
