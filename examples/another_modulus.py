"""
Another modulus
===============

A harder gel looks the same at equal dents. Five loads along z tell a network how much harder, for all axes.
"""

import sys
from pathlib import Path

import numpy as np

from gelgap.adapt import (
    Profile,
    affine_correction,
    draw_labelled,
    evaluate,
    fine_tune,
    fit_modulus_ratio,
    split_for_training,
    train_source,
    with_modulus_ratio,
)
from gelgap.data import open_domain


def main(source: Path, target: Path, profile: str | Profile = "smoke", loads: int = 5, seed: int = 0) -> None:
    profile = Profile.named(profile)
    frames = split_for_training(open_domain(source), open_domain(target), profile, seed)
    model = train_source(frames.source_train, profile, seed)
    forces_n, (low_n, high_n) = frames.target_train.force_n, model.force_range_n.T
    learnable = ((low_n <= forces_n) & (forces_n <= high_n)).all(axis=1) & (forces_n[:, 2] < 0)
    few = draw_labelled(frames.target_train.take(np.flatnonzero(learnable)), loads, seed)
    ratio, error = fit_modulus_ratio(few.force_n[:, 2], model.predict_n(few)[:, 2])
    print(f"the gel is {ratio:.3f} ± {error:.3f} times as stiff")
    models = {
        "source-only": model,
        f"{loads} loads along z": with_modulus_ratio(model, ratio),
        f"{loads} labels, corrected": affine_correction(model, few),
        f"{loads} labels, fine-tuned": fine_tune(model, few),
    }
    for name, own in models.items():
        found = evaluate(own, frames.target_test)
        print(f"{name:<22} mean error on the target {found.mean_mae_n:.3f} N")


if __name__ == "__main__":
    folders = sys.argv[1:3] if len(sys.argv) > 2 else ("data/wmb0i0", "data/hard")
    main(Path(folders[0]), Path(folders[1]), sys.argv[3] if len(sys.argv) > 3 else "smoke")
