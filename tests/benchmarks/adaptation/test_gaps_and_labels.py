"""Gap curves, factorial effects, and how many labels close a gap."""

from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from run_records import crossed, label_record, record, write_runs

from gelgap.benchmarks.adaptation import gaps, labels
from gelgap.benchmarks.adaptation.board import AT_RANDOM
from gelgap.benchmarks.adaptation.study import load_runs


def test_gap_design_changes_one_thing_at_a_time():
    from gelgap.domains import differing_fields

    found = gaps.design()
    base = found.recipes["mb0i0"]
    changed = {
        name: {
            field.split(".")[0] for field in differing_fields(base.configuration(), recipe.configuration())
        }
        for name, recipe in found.recipes.items()
    }
    assert changed["friction-001"] == {"name", "elastomer"}
    assert changed["noise-002"] == changed["markers-001"] == {"name", "sensor"}
    assert changed["crossed-111"] == {"name", "elastomer", "illumination", "markers"}
    sizes = found.gaps.set_index(["panel", "domain"])["size"]
    assert sizes["modulus", "modulus-001"] == 0.5
    assert sizes["markers", "no-markers-001"] == 100
    assert sizes["light", "mb0i1"] > sizes["light", "light-001"] > 5
    assert len(found.cells.drop_duplicates(gaps.CROSSED)) == 8
    # Cells that a curve has already are taken from there: the base, the modulus, the light and the missing markers.
    assert found.cells["domain"].str.startswith("crossed").sum() == 4


def test_effects_are_those_of_the_factorial_design():
    results = crossed(lambda c: 0.1 + 0.2 * c.modulus + 0.05 * c.light - 0.04 * c.light * c.markers)
    found = gaps.effects(gaps.errors_of(results, results.cells))["dsan"]
    assert found["mean"] == pytest.approx(0.1 + 0.1 + 0.025 - 0.01)
    assert found["modulus"] == pytest.approx(0.2)
    assert found["light"] == pytest.approx(0.05 - 0.02)
    assert found["light × markers"] == pytest.approx(-0.02)
    assert found["modulus × light × markers"] == pytest.approx(0)


def test_gap_errors_are_means_over_seeds(source, monkeypatch, tmp_path):
    monkeypatch.setattr("gelgap.domains.open_domain", lambda folder: source)
    runs = [
        record(("mb0i0", "a"), "dsan", mae_n, seed, changes=(), constant_mean_n=(4 * mae_n,) * 3)
        for seed, mae_n in enumerate((0.1, 0.3))
    ]
    write_runs(tmp_path / "runs.jsonl", runs)
    sizes = pd.DataFrame([("modulus", "a", 2.0)], columns=["panel", "domain", "size"])
    found = gaps.collect(
        gaps.Design({}, sizes, pd.DataFrame()), load_runs(tmp_path / "runs.jsonl"), Path("x")
    )
    assert found.errors_n["a"]["dsan"] == pytest.approx(0.2)
    assert found.errors_n["a"]["constant mean"] == pytest.approx(0.8)
    assert gaps.gap_table(found).rows == [["modulus", "2", "0.800", "0.200", "0.000"]]
    assert "Mean over 2 seed" in gaps.gap_table(found).note


def test_labels_that_close_a_gap(tmp_path):
    without = label_record((gaps.BASE, gaps.BASE), "source-only", {0: 0.1, 1: 0.1}, AT_RANDOM)
    gap = label_record((gaps.BASE, "modulus-001"), "source-only", {0: 0.2, 1: 0.12, 5: 0.105}, AT_RANDOM)
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
