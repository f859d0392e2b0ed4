"""Rules of a few numbers, without a network: what any method should beat.

Fitted on the source's training frames, they see differences to the reference of at most 64 px along the longer side.
"""

import numpy as np

from gelgap.adapt.data import SplitFrames
from gelgap.adapt.evaluation import Evaluation, evaluate_constant_mean, evaluate_frames
from gelgap.domains import LabelledFrames

CONSTANT, QUADRATIC, RIDGE = "constant mean", "quadratic in mean difference", "ridge on area and depth"
BASELINES = (CONSTANT, QUADRATIC, RIDGE)
_SIZE_PX = 64
# Of a picture in [0, 1]: what differs more is the dent, and its deepest part is where most differs.
_DENT, _DEEPEST = 0.03, 99.0
_PENALTY = 1e-3


def evaluate_baselines(frames: SplitFrames) -> dict[str, Evaluation]:
    """Return the errors of all baselines on the target's test frames, by name.

    The constant is the source's mean. The quadratic is one in the mean absolute difference of a picture. The ridge is
    quadratic, too, in the share of pixels that belong to the dent, and in the difference where it is deepest.
    """
    from sklearn.linear_model import Ridge
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    train, test = frames.source_train, frames.target_test
    size_px = min(_SIZE_PX, *(max(frames.size_px) for frames in (train, test)))
    mean, area, depth = zip(*(_numbers(frames, size_px) for frames in (train, test)), strict=True)
    found = {CONSTANT: evaluate_constant_mean(train, test)}
    for name, columns in ((QUADRATIC, (mean,)), (RIDGE, (area, depth))):
        known, wanted = (np.stack([column[k] for column in columns], axis=1) for k in (0, 1))
        ridge = make_pipeline(PolynomialFeatures(2), StandardScaler(), Ridge(_PENALTY * len(train)))
        # Of a single label it predicts (m,).
        predicted = ridge.fit(known, train.label_values).predict(wanted).reshape(test.label_values.shape)
        found[name] = evaluate_frames(test, predicted)
    return found


def _numbers(frames: LabelledFrames, size_px: int) -> list[np.ndarray]:
    """Return mean absolute difference, share of the dent's pixels and largest difference of each picture (n,)."""
    references, images, rows = frames.references_at(size_px).astype(np.float32), frames.images(size_px), []
    for image, own in zip(images, frames.reference_id, strict=True):
        difference = np.abs(image - references[own]).mean(axis=2) / 255
        rows.append((difference.mean(), (difference > _DENT).mean(), np.percentile(difference, _DEEPEST)))
    return list(np.array(rows).T)
