"""Targets without labels or with some, several targets and profiles, and a choice among runs without labels."""

import json

import numpy as np
import pandas as pd
import pytest
from picture_folders import write_pictures

from gelgap.adapt import adapt_folders, evaluate, finetune, load_predictions, load_run, split_for_training
from gelgap.adapt.report import selection_table, write_report
from gelgap.cli.main import main
from gelgap.data import ArrayFrames, Labels, open_domain


def pictures(frames: ArrayFrames, name: str, **columns) -> ArrayFrames:
    """Return the frames with no labels but these columns."""
    return ArrayFrames(name, frames.images(), frames.reference, None, **columns)


def some_labels(frames: ArrayFrames, name: str, labelled: int, **columns) -> ArrayFrames:
    """Return the frames, of which the first ones alone have labels."""
    force_n = frames.force_n.astype(float)
    force_n[labelled:] = np.nan
    return ArrayFrames(name, frames.images(), frames.reference, force_n, **columns)


def test_pictures_alone_have_no_labels(target):
    alone = pictures(target, "alone", fz_n=np.full(len(target), np.nan))
    assert alone.labels == Labels((), ())
    assert alone.label_values.shape == (len(target), 0)
    assert not alone.is_labelled.any()
    assert alone.torch(32).inputs([0]).shape == (1, 6, 26, 32)
    with pytest.raises(ValueError, match="alone has no labels"):
        alone.check_labels()


def test_a_target_without_labels_is_adapted_to_as_a_whole(source, target, short, tmp_path):
    methods = ["source-only", "adabn", "constant-mean"]
    runs = adapt_folders(source, pictures(target, "alone"), methods, short, out_dir=tmp_path)
    for run in runs:
        assert (run.n_target, run.labels) == (96, ("fx_n", "fy_n", "fz_n"))
        assert (run.target_test, run.target_constant_mean, run.baselines) == (None, None, {})
        assert load_run(run.folder) == run
        assert (run.folder / "model.pt").is_file()
        arrays = load_predictions(run)
        assert "target_true_n" not in arrays
        middle = np.quantile(arrays["target_predicted_n"], 0.5, axis=0)
        np.testing.assert_allclose([at[1] for at in run.label_free.quantiles.values()], middle, atol=1e-4)
    plain, adabn, constant = (run.label_free for run in runs)
    assert plain.scores == plain.scores_before == adabn.scores_before
    assert adabn.scores["feature-mmd"] != plain.scores["feature-mmd"]
    assert (plain.alarm, constant.alarm, constant.scores_before) == (False, True, {})
    text = write_report(tmp_path).read_text()
    assert "<td>mb0i0 → alone</td><td>before</td><td>0</td>" in text
    assert "constant-mean on mb0i0 → alone may predict a constant" in text
    assert "how often which force are predicted" in text
    assert ">nan<" not in text


def test_methods_that_need_labels_of_the_target_are_refused_before_any_work(source, target, short, tmp_path):
    for wrong in (pictures(target, "alone"), some_labels(target, "few", 1)):
        with pytest.raises(
            ValueError, match=f"supervised learns from labels of the target, and 0 .* of {wrong.name}"
        ):
            adapt_folders(source, [target, wrong], ["adabn", "supervised"], short, out_dir=tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("labelled", "trained", "tested"), [(1, 95, 1), (60, 57, 39), (95, 57, 39)])
def test_frames_without_labels_are_trained_on_first(source, target, short, labelled, trained, tested):
    frames = split_for_training(source, some_labels(target, "some", labelled), short, 0)
    assert (len(frames.target_train), len(frames.target_test)) == (trained, tested)
    assert frames.target_test.is_labelled.all()
    assert not len(frames.target_validation)
    assert f"{labelled} of 96 frames of some have fx_n, fy_n, fz_n" in frames.notes[0]
    assert f"{trained} are trained on without them, {tested} are tested on" in frames.notes[0]


def test_a_group_stays_whole_where_some_frames_lack_labels(source, target, short):
    clip = np.array([f"c{index // 8}" for index in range(96)], dtype=object)
    by_clip = short.replace(split_by="clip")
    named = ArrayFrames("s", source.images(), source.reference, source.force_n, clip=clip + "s")
    frames = split_for_training(named, some_labels(target, "some", 80, clip=clip), by_clip, 0)
    assert not set(frames.target_train.columns["clip"]) & set(frames.target_test.columns["clip"])
    with pytest.raises(
        ValueError, match="none of its 3 frames with labels is in the test part; take another seed"
    ):
        split_for_training(named, some_labels(target, "some", 3, clip=clip), by_clip, 0)


def test_a_random_split_of_clips_or_of_stated_parts_is_said(source, target, short, valid_files):
    stated = np.repeat(np.array(["train", "test"], dtype=object), 48)
    clips = some_labels(target, "some", 96, clip=stated, split=stated)
    at_random = short.replace(split_by="random")
    of_parts, of_clips = split_for_training(source, clips, at_random, 0).notes
    assert "split_by=given" in of_parts
    assert "split_by=clip" in of_clips
    assert not split_for_training(clips, clips, short.replace(split_by="given"), 0).notes
    generated = open_domain(valid_files / "data" / "mb0i0")  # states a split at random
    for own in (target, generated):
        assert not split_for_training(source, own, at_random, 0).notes


def test_source_frames_without_labels_are_left_out_and_counted(source, target, short):
    gaps = some_labels(source, "gaps", 70)
    frames = split_for_training(gaps, target, short, 0)
    assert len(frames.source_train) + len(frames.source_held_out) == 70
    assert "26 of 96 frames of gaps lack fx_n, fy_n, fz_n: left out" in frames.notes
    with pytest.raises(ValueError, match="source none: none of its 96 frames has a label to learn from"):
        split_for_training(some_labels(source, "none", 0), target, short, 0)
    empty = pictures(source, "empty", fz_n=np.zeros(96), x_mm=np.full(96, np.nan))
    with pytest.raises(ValueError, match="source empty: none of its 96 frames has x_mm to learn from"):
        split_for_training(empty, target, short, 0, labels=["x_mm"])


def test_labels_that_the_target_lacks_may_be_predicted(source, target, short):
    fz = pictures(target, "fz", fz_n=target.columns["fz_n"], fx_n=np.full(96, np.nan))
    assert split_for_training(source, fz, short, 0).source_train.labels.names == ("fz_n",)
    everything = split_for_training(source, fz, short, 0, labels=["fx_n", "fz_n"])
    assert everything.source_train.labels.names == ("fx_n", "fz_n")
    assert not len(everything.target_test)
    placed = pictures(target, "placed", x_mm=np.zeros(96))
    assert split_for_training(source, placed, short, 0).source_train.labels.names == ("fx_n", "fy_n", "fz_n")


def test_errors_are_of_the_labelled_frames(source, target, stage1):
    some = some_labels(target, "some", 30)
    found, expected = evaluate(stage1, some), evaluate(stage1, target.take(np.arange(30)))
    assert found.n == expected.n == 30
    assert found.mae == pytest.approx(expected.mae, rel=1e-5)
    with pytest.raises(ValueError, match="none of the 96 frames has all labels"):
        evaluate(stage1, some_labels(target, "none", 0))


@pytest.mark.parametrize("count", [1, 2])
def test_a_target_needs_two_pictures(source, target, short, count):
    few = pictures(target.take(np.arange(count)), "few")
    methods = ["source-only", "adabn", "dan", "dann", "daregram"]
    if count == 1:
        with pytest.raises(
            ValueError, match="target few: 1 of 1 pictures would be trained on; adaptation needs 2"
        ):
            adapt_folders(source, few, methods, short, progress=pytest.fail)
        return
    for run in adapt_folders(source, few, methods, short):
        assert run.problem is not None or np.isfinite(list(run.label_free.scores.values())).all()


def test_several_targets_and_profiles_share_stage_1_and_one_run_is_chosen_for_each_target(
    source, target, tinted, short, tmp_path
):
    longer = short.replace(name="longer", adapt_epochs=2)
    titles = []
    runs = adapt_folders(
        source,
        [target, pictures(tinted, "alone")],
        ["source-only", "dan"],
        [short, longer],
        out_dir=tmp_path,
        progress=lambda title, *_: titles.append(title),
    )
    assert titles.count("source mb0i0") == 2
    assert [(run.target, run.profile["name"], run.method) for run in runs] == [
        (name, profile, method)
        for name in ("wmb1i1", "alone")
        for profile in ("test", "longer")
        for method in ("source-only", "dan")
    ]
    table = selection_table(runs, "feature-mmd")
    for _, group in table.groupby("group"):
        assert group["chosen"].sum() == 1
        assert group["feature-mmd"][group["chosen"]].item() == group["feature-mmd"].min()
    text = write_report(tmp_path).read_text()
    assert "dan, longer" in text
    with pytest.raises(ValueError, match="alone, alone: results are filed by name"):
        adapt_folders(source, 2 * [pictures(tinted, "alone")], ["adabn"], short)


def test_the_command_takes_folders_of_pictures(source, target, short, tmp_path, capsys):
    learnt = write_pictures(tmp_path / "learnt", source, fz_n=source.columns["fz_n"])
    alone = write_pictures(tmp_path / "alone", target)
    some = write_pictures(tmp_path / "some", target, fz_n=some_labels(target, "some", 12).columns["fz_n"])
    (tmp_path / "tiny.toml").write_text(
        'base = "smoke"\nwidth = 0.125\nimage_size_px = [40, 32]\nsource_epochs = 1\nadapt_epochs = 1\n'
    )
    words = ["adapt", "--source", learnt, "--target", alone, some, "--profile", tmp_path / "tiny.toml"]
    words += ["--method", "source-only", "adabn", "--out", tmp_path / "runs"]
    main([*map(str, words), "--select", "feature-mmd"])
    said = capsys.readouterr().out
    assert "A target without labels (Fz)" in said
    assert "learnt → some, 12 target test frames" in said
    assert "nan" not in said.lower()
    scores = pd.read_csv(tmp_path / "runs" / "selection.csv")
    assert scores["chosen"].sum() == 2
    for folder in scores["folder"][scores["chosen"]]:
        assert json.loads((tmp_path / "runs" / folder / "run.json").read_text())["labels"] == ["fz_n"]
        assert f"is chosen: {tmp_path / 'runs' / folder}" in said.replace("\n", "")


def test_few_labels_are_drawn_from_the_frames_that_have_them(stage1, target, tmp_path):
    stage1.save(tmp_path / "model.pt")
    some = write_pictures(tmp_path / "some", target, fz_n=some_labels(target, "some", 12).columns["fz_n"])
    found = finetune(tmp_path / "model.pt", some, some, frames=5)
    assert (found.frames, found.after.n, found.unlabelled) == (5, 7, 84)
    assert "84 frames without labels" in str(found)
    with pytest.raises(ValueError, match="k = 13 labelled frames of some: must be 1 to 12"):
        finetune(tmp_path / "model.pt", some, some, frames=13)
    alone = write_pictures(tmp_path / "alone", target)
    with pytest.raises(ValueError, match="predicts fx_n, fy_n, fz_n, none of which both alone and some have"):
        finetune(tmp_path / "model.pt", alone, some, frames=3)


def test_labels_that_do_not_vary_have_no_r2(source, target, short, capsys, tmp_path):
    same = pictures(target, "same", fz_n=np.full(96, -1.0))
    (run,) = adapt_folders(source, same, ["adabn"], short, out_dir=tmp_path)
    assert np.isnan(run.target_test.r2).all()
    assert np.isnan(load_run(run.folder).target_test.r2).all()
    assert ">nan<" not in write_report(tmp_path).read_text()
