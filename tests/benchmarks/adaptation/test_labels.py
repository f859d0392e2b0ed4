"""How many labels close a gap."""

from functools import partial

from run_records import label_record, write_runs

from gelgap.benchmarks.adaptation import labels
from gelgap.benchmarks.adaptation.board import GROUPS


def test_errors_by_the_number_of_labels(tmp_path):
    runs = [label_record(GROUPS[0], "source-only", {0: 0.2, 1: 0.12, 5: 0.105})]
    write_runs(tmp_path / labels.RECORD, [*runs, label_record(GROUPS[1], "source-only", {0: 0.1, 1: 0.1})])
    (table,) = labels.PART.tables(tmp_path)
    rows = {tuple(row[:2]): row[2:] for row in table.cells}
    assert rows["source-only", "both"] == ["0.150", "0.110", "0.105", "–", "–"]
    assert rows["dsan", "both"] == ["–"] * 5


def test_labels_are_drawn_from_the_targets_training_frames(source, target, profile, monkeypatch):
    from gelgap.adapt import fine_tune, split_for_training, train_source

    monkeypatch.setattr("gelgap.adapt.fine_tune", partial(fine_tune, steps=5))

    frames = split_for_training(source, target, profile.replace(source_epochs=1), 0)
    model = train_source(frames.source_train, profile.replace(source_epochs=1))
    points = list(labels.label_points(model, frames, 0))
    assert [(point["way"], point["labels"]) for point in points[:4]] == [
        ("none", 0),
        ("affine", 1),
        ("fine-tuning", 1),
        ("both", 1),
    ]
    assert max(point["labels"] for point in points) == 20  # it has no hundred
    assert len({tuple(point["mae_n"]) for point in points}) == len(points) == 10
