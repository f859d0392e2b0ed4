"""How many labels close a gap."""

from functools import partial

from run_records import label_record, write_runs

from gelgap.benchmarks.adaptation import labels
from gelgap.benchmarks.adaptation.board import AT_RANDOM


def test_each_gap_that_a_picture_does_not_show_is_of_one_thing():
    from gelgap.domains import differing_fields

    found = labels.unseen_gaps()
    assert list(found) == [
        "none",
        "modulus × 0.5",
        "modulus × 0.7",
        "modulus × 1.4",
        "friction × 0.5",
        "friction × 2.08333",
    ]
    base = found["none"].configuration()
    for name, recipe in found.items():
        changed = {field.split(".")[0] for field in differing_fields(base, recipe.configuration())}
        assert changed == (set() if name == "none" else {"name", "elastomer"})


def test_labels_that_close_a_gap(tmp_path):
    without = label_record((labels.BASE, labels.BASE), "source-only", {0: 0.1, 1: 0.1}, AT_RANDOM)
    gap = label_record((labels.BASE, "modulus-001"), "source-only", {0: 0.2, 1: 0.12, 5: 0.105}, AT_RANDOM)
    write_runs(tmp_path / labels.RECORD, [gap, without])
    points = labels.load_points(tmp_path / labels.RECORD)
    rows = {tuple(row[:3]): row[3:] for row in labels.gap_table(points).cells}
    assert rows["modulus × 0.5", "source-only", "both"] == ["0.200", "0.120", "0.105", "–", "–", "5"]
    assert rows["none", "source-only", "both"][-1] == "0"
    assert rows["modulus × 0.5", "dsan", "both"] == ["–"] * 6
    assert labels.nine_table(points).cells[0][:5] == ["source-only", "affine", "0.150", "0.110", "0.105"]


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
