"""Runs on other labels than the three axes of the force: they train, are judged, kept, reported and asked for."""

import json
from dataclasses import replace
from html import unescape
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.adapt import (
    ForceModel,
    adapt_folders,
    affine_correction,
    fine_tune,
    load_predictions,
    load_run,
    split_for_training,
    train_source,
    write_report,
)
from gelgap.adapt.evaluation import Evaluation
from gelgap.adapt.report import axis_table, error_table, force_scatter
from gelgap.assets.checksums import SUMS
from gelgap.cli.main import main
from gelgap.data import ArrayFrames, Labels, with_labels


def on(frames: ArrayFrames, *axes: str, **columns) -> ArrayFrames:
    """Return the frames with only these axes of the force, and further columns."""
    kept = {
        name: values
        for name, values in frames.columns.items()
        if name in (*axes, "contact_class", "point_id")
    }
    return ArrayFrames(frames.name, frames.images(), frames.reference, None, **kept, **columns)


@pytest.fixture(scope="module")
def fz_runs(source, target, short, tmp_path_factory):
    methods = ["source-only", "cdan", "uga", "dsan", "supervised", "constant-mean"]
    out = tmp_path_factory.mktemp("fz")
    return adapt_folders(on(source, "fz_n"), on(target, "fz_n"), methods, short, out_dir=out)


def test_absent_axes_are_absent(fz_runs, source, target, short):
    for run in fz_runs:
        for error in (
            run.target_test,
            run.target_constant_mean,
            run.source_held_out,
            run.source_constant_mean,
        ):
            assert error.labels == ("fz_n",)
            assert np.isfinite([*error.mae, *error.mae_percent, *error.r2]).all()
            assert len(error.mae) == 1
            assert error.mean_mae_n == error.mae[0]
    truth = load_predictions(fz_runs[0])["target_true_n"]
    expected = split_for_training(source, target, short, 0).target_test.columns["fz_n"]
    np.testing.assert_array_equal(truth, expected[:, None])


def test_a_network_that_learns_fz_alone_learns_it(source, target, profile):
    frames = split_for_training(source, target, profile, 0, labels=["fz_n"])
    model = train_source(frames.source_train, profile)
    predicted, truth = (
        model.predict_frames(frames.source_held_out)[:, 0],
        frames.source_held_out.columns["fz_n"],
    )
    assert np.abs(predicted - truth).mean() < 0.4 * np.abs(truth - truth.mean()).mean()
    with pytest.raises(ValueError, match="the model predicts fz_n, not Fx, Fy and Fz"):
        model.predict_n(frames.source_held_out)


def test_records_name_other_labels_and_only_those(fz_runs, source, target, short, tmp_path):
    record = json.loads((fz_runs[0].folder / "run.json").read_text())
    assert list(record["target_test"]) == ["n", "mae", "mae_percent", "r2", "labels"]
    assert load_run(fz_runs[0].folder) == fz_runs[0]
    (run,) = adapt_folders(source, target, ["constant-mean"], short, out_dir=tmp_path)
    record = json.loads((run.folder / "run.json").read_text())
    assert record["labels"] == ["fx_n", "fy_n", "fz_n"]
    assert "stratify_by" not in record["profile"]
    assert load_run(run.folder).target_test == run.target_test


def test_the_report_has_tables_of_each_set_of_labels(fz_runs, source, target, short):
    (forces,) = adapt_folders(source, target, ["constant-mean"], short, out_dir=fz_runs[0].folder.parent)
    text = unescape(write_report(fz_runs[0].folder.parent).read_text())
    assert "<h2>Mean error on the target's test frames (Fz), N</h2>" in text
    assert "<h2>Mean error on the target's test frames, N</h2>" in text
    assert "<th>seed</th><th>Fz, N</th><th>R² z</th><th>constant mean, N</th></tr>" in text
    assert "mb0i0 → wmb1i1, seed 0 (Fz): predicted against true force" in text
    assert forces.labels == ("fx_n", "fy_n", "fz_n")


def test_a_run_of_generated_domains_keeps_oracles_and_what_no_picture_shows(source, target, short, tmp_path):
    (run,) = adapt_folders(source, target, ["constant-mean"], short, out_dir=tmp_path)
    assert (run.oracles, run.unseen) == ({}, ())
    told = replace(run, oracles={"pose oracle": run.target_test}, unseen=("modulus 1 and 2 MPa",))
    record = json.loads((run.folder / "run.json").read_text())
    record |= {"oracles": {"pose oracle": record["target_test"]}, "unseen": list(told.unseen)}
    (run.folder / "run.json").write_text(json.dumps(record))
    (run.folder / SUMS).unlink()
    assert load_run(run.folder) == told
    text = write_report(tmp_path).read_text()
    assert "<td>mb0i0 → wmb1i1</td><td>modulus 1 and 2 MPa</td>" in text
    assert "pose oracle" in text


def test_pictures_are_not_shifted_where_a_contact_point_is_learnt(source, target, short, tmp_path):
    x_mm = np.random.default_rng(0).uniform(-4, 4, len(source))
    pair = [on(frames, "fz_n", x_mm=x_mm) for frames in (source, target)]
    with pytest.raises(ValueError, match="shift_px = 3: a shifted picture shows another x_mm than its label"):
        adapt_folders(*pair, ["adabn"], short.replace(shift_px=3), labels=["x_mm", "fz_n"], out_dir=tmp_path)


def test_labels_of_several_units_are_not_averaged(source, target, short, tmp_path):
    x_mm = np.random.default_rng(0).uniform(-4, 4, len(source))
    pair = [on(frames, "fz_n", x_mm=x_mm) for frames in (source, target)]
    ranges = {"fz_n": (-5.0, 0.0)}
    (run,) = adapt_folders(
        *pair, ["constant-mean"], short, labels=["x_mm", "fz_n"], ranges=ranges, out_dir=tmp_path
    )
    assert run.target_test.mean_mae is None
    assert run.target_test.mae_percent[1] == pytest.approx(100 * run.target_test.mae[1] / 5)
    with pytest.raises(ValueError, match="x_mm, fz_n are not all forces"):
        _ = run.target_test.mae_n
    assert error_table([run]).title == "Mean error on the target's test frames (x, Fz), % of the range"
    assert list(axis_table([run]).columns)[3:] == ["x, mm", "Fz, N", "R² x", "R² z", "constant mean, %"]
    arrays = load_predictions(run)
    figure = force_scatter({"a": (arrays["target_true_n"], arrays["target_predicted_n"])}, run.labels)
    assert [axes.get_xlabel() for axes in figure.axes] == ["true x, mm", "true force, N"]


def test_keys_tell_labels_and_ranges_apart(source, target, short):
    def key(**choice) -> str:
        return adapt_folders(source, target, ["constant-mean"], short, **choice)[0].key

    forces = ["fx_n", "fy_n", "fz_n"]
    keys = [key(), key(labels=["fz_n"]), key(ranges={"fz_n": (-4.0, 0.0)}), key(labels=forces)]
    assert len(set(keys)) == 3
    assert keys[0] == keys[3]


def test_a_model_of_other_labels_is_saved_corrected_and_fine_tuned(source, target, short, tmp_path):
    frames = split_for_training(source, target, short, 0, labels=["fz_n"], ranges={"fz_n": (-4.0, 0.5)})
    model = train_source(frames.source_train, short)
    few = frames.target_train.take(np.arange(12))
    for changed in (model, affine_correction(model, few), fine_tune(model, few, steps=2)):
        changed.save(tmp_path / "model.pt")
        loaded = ForceModel.load(tmp_path / "model.pt")
        assert loaded.labels == Labels(("fz_n",), ((-4.0, 0.5),))
        np.testing.assert_array_equal(loaded.predict_frames(few), changed.predict_frames(few))
    with pytest.raises(ValueError, match=r"has the labels fx_n=-0.75:0.75 .*, the model fz_n=-4:0.5"):
        fine_tune(model, target)
    assert np.isfinite(fine_tune(model, with_labels(target, model.labels), steps=1).predict_frames(few)).all()


def test_a_checkpoint_of_other_labels_gives_the_outputs_in_common(source, short, tmp_path):
    one_epoch = short.replace(source_epochs=1, source_learning_rate=1e-9)
    train_source(source, one_epoch, seed=1).save(tmp_path / "forces.pt")
    forces = ForceModel.load(tmp_path / "forces.pt").network.state_dict()
    frames = on(source, "fz_n", x_mm=np.linspace(0, 1, len(source)))
    both = with_labels(frames, Labels.of({"x_mm": (0, 1), "fz_n": (-3, 0)}))
    started = train_source(both, one_epoch, weights=tmp_path / "forces.pt").network.state_dict()
    np.testing.assert_allclose(started["regressor.0.weight"][1], forces["regressor.0.weight"][2], atol=1e-6)
    np.testing.assert_allclose(started["bottleneck.0.weight"], forces["bottleneck.0.weight"], atol=1e-6)


def test_a_record_with_other_numbers_than_labels_is_damaged(fz_runs, tmp_path):
    content = json.loads((fz_runs[0].folder / "run.json").read_text())
    content["target_test"]["labels"] = ["fz_n", "x_mm"]
    (tmp_path / "run.json").write_text(json.dumps(content))
    with pytest.raises(RuntimeError, match="other than 2 numbers for the labels fz_n, x_mm"):
        load_run(tmp_path)


def test_the_unit_is_that_of_all_labels():
    assert Evaluation(1, (1.0, 2.0), (1.0, 2.0), (0.0, 0.0), ("x_mm", "depth_mm")).mean_mae == 1.5
    assert Evaluation(1, (1.0, 2.0, 3.0), (1.0,) * 3, (0.0,) * 3).unit == "N"


def picture_folder(folder: Path, frames: ArrayFrames, session: str) -> Path:
    """Write some frames as clips of four pictures, with a rest picture for each clip and no force but Fz."""
    rows = ["picture,fz_n,clip,object,session"]
    for index in range(40):
        clip = f"{session}-{index // 4}"
        rows.append(
            f"{clip}/{index}.png,{4 * frames.columns['fz_n'][index]},{clip},ball{index // 4 % 2},{session}"
        )
        (folder / clip).mkdir(parents=True, exist_ok=True)
        (folder / "references").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / clip / f"{index}.png"), frames.picture(index))
        cv2.imwrite(str(folder / "references" / f"{clip}.png"), frames.reference)
    (folder / "labels.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_the_command_adapts_folders_of_one_axis_by_clips(source, target, short, tmp_path, capsys):
    lists = {"image_size_px": "[40, 32]", "target_split": "[0.6, 0.2, 0.2]"}
    values = short.model_dump(exclude={"settings", "name", *lists})
    lines = [f"{name} = {json.dumps(value)}" for name, value in values.items()]
    (tmp_path / "tiny.toml").write_text("\n".join([*lines, *(f"{k} = {v}" for k, v in lists.items())]))
    folders = [
        picture_folder(tmp_path / name, frames, name)
        for name, frames in (("one", source), ("two", source), ("late", target))
    ]
    first, second, late = map(str, folders)
    arguments = f"adapt --source {first} {second} --target {late} --profile {tmp_path}/tiny.toml".split()
    arguments += f"--method dsan --out {tmp_path}/runs".split()
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--set", "split_by=clip"])
    assert stop.value.code == 2
    assert "needs contact classes" in capsys.readouterr().err
    choice = ["--labels", "fz_n", "--range", "fz_n=-12:0.5", "--classes", "from-force", "4"]
    main([*arguments, *choice, "--set", "split_by=clip", "stratify_by=object"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "one+two → late, 8 target test frames"
    assert lines[1].split() == ["MAE", "Fz/N", "mean", "R²", "Fz"]
    assert lines[2].startswith("constant mean")
    (record,) = (tmp_path / "runs").glob("*/run.json")
    run = json.loads(record.read_text())
    assert run["profile"]["split_by"] == "clip"
    assert run["profile"]["stratify_by"] == "object"
    assert run["n_target"] == 24
    assert ForceModel.load(record.parent / "model.pt").n_classes == 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--range", "fz_n=-3"], "must be a label and its two bounds, as fz_n=-30:0"),
        (["--range", "fz_n=-3:0", "fz_n=-4:0"], "one stands twice"),
    ],
)
def test_wrong_choices_are_refused(options, message, files, refused):
    pictures = files / "pictures"
    assert message in refused("adapt", "--source", pictures, "--target", pictures, *options)


def test_target_labels_beyond_the_range_stop_what_trains_on_them(source, target, short, tmp_path, caplog):
    deep = on(target, fz_n=2 * target.columns["fz_n"])
    with pytest.raises(ValueError, match=r"domain wmb1i1: .* outside the declared range; .*never clipped"):
        adapt_folders(on(source, "fz_n"), deep, ["source-only", "supervised"], short, out_dir=tmp_path)
    assert not list(tmp_path.iterdir())
    adapt_folders(on(source, "fz_n"), deep, ["constant-mean"], short)
    assert "frames of wmb1i1 have a label beyond the range (fz_n=-3:0)" in caplog.messages[-1]
