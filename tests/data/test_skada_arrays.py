from pathlib import Path

import numpy as np
import pytest

from gelgap.data import ArrayFrames, LabelledFrames, open_domain, to_skada


@pytest.fixture
def source() -> LabelledFrames:
    return coloured(30, seed=0, offset=0)


@pytest.fixture
def target() -> LabelledFrames:
    """As the source, but every channel answers to other forces."""
    return coloured(20, seed=1, offset=40)


def coloured(n: int, seed: int, offset: int, size_px: tuple[int, int] = (8, 6)) -> LabelledFrames:
    """Pictures of noise whose left, middle and right thirds brighten with the three forces."""
    rng = np.random.default_rng(seed)
    force_n = rng.uniform([-0.5, -0.5, -2], [0.5, 0.5, 0], (n, 3))
    width, height = size_px
    reference = np.full((height, width, 3), 80 + offset, np.uint8)
    pictures = np.tile(reference.astype(float), (n, 1, 1, 1)) + rng.normal(0, 2, (n, height, width, 3))
    for axis, columns in enumerate(np.array_split(np.arange(width), 3)):
        pictures[:, :, columns] += 40 * force_n[:, axis, None, None, None] + offset / 4
    return ArrayFrames(
        f"offset-{offset}", np.rint(pictures).clip(0, 255).astype(np.uint8), reference, force_n
    )


def test_arrays_are_the_source_then_the_target_with_its_labels_masked(source, target):
    X, y, sample_domain = to_skada(source, target, axis="y", size_px=4)
    assert (X.shape, X.dtype) == ((50, 3 * 4 * 3), np.float32)
    assert (y.shape, y.dtype) == ((50,), np.float64)
    assert (sample_domain > 0).tolist() == [True] * 30 + [False] * 20
    assert (sample_domain < 0).tolist() == [False] * 30 + [True] * 20
    assert np.array_equal(y[:30], source.force_n[:, 1])
    assert np.isnan(y[30:]).all()


@pytest.mark.parametrize(("axis", "column"), [("x", "fx_n"), ("z", "fz_n")])
def test_to_evaluate_both_domains_have_the_labels_of_the_axis(source, target, axis: str, column: str):
    _, y, _ = to_skada(source, target, axis, mask_target_labels=False, size_px=8)
    assert np.array_equal(y, np.concatenate([source.columns[column], target.columns[column]]))


def test_features_are_differences_to_each_domains_own_reference(data: Path):
    domains = open_domain(data / "mb0i0"), open_domain(data / "mb0i1")
    X, _, sample_domain = to_skada(*domains, axis="z", size_px=(20, 12))
    for frames, rows in zip(domains, (X[sample_domain > 0], X[sample_domain < 0]), strict=True):
        pictures = rows.reshape(-1, 12, 20, 3) * 255 + frames.references_at((20, 12))[0]
        np.testing.assert_allclose(pictures, frames.images((20, 12)), atol=1e-3)


def test_a_pipeline_of_skada_learns_from_the_source_and_predicts_the_target(source, target):
    from skada import CORALAdapter, make_da_pipeline
    from sklearn.linear_model import Ridge

    X, y, sample_domain = to_skada(source, target, axis="x", size_px=8)
    model = make_da_pipeline(CORALAdapter(reg=0.1), Ridge(0.1)).fit(X, y, sample_domain=sample_domain)
    _, true_n, _ = to_skada(source, target, axis="x", size_px=8, mask_target_labels=False)
    of_target = sample_domain < 0
    found_n = model.predict(X[of_target], sample_domain=sample_domain[of_target])
    assert found_n.shape == (20,)
    assert np.abs(found_n - true_n[of_target]).mean() < 0.5 * np.abs(true_n[of_target]).mean()


def test_skada_masks_labels_in_the_same_way(source, target):
    """Its own packing of two domains with the same labels gives the same mask, signs and order."""
    from skada.datasets import DomainAwareDataset

    X, y, sample_domain = to_skada(source, target, axis="z", size_px=8)
    own = [(X[sample_domain > 0], source.force_n[:, 2]), (X[sample_domain < 0], target.force_n[:, 2])]
    packed = DomainAwareDataset([(*own[0], "source"), (*own[1], "target")]).pack(
        as_sources=["source"], as_targets=["target"], mask_target_labels=True, return_type="array"
    )
    for theirs, ours in zip(packed, (X, y, sample_domain), strict=True):
        np.testing.assert_array_equal(theirs, ours)


def test_an_unknown_axis_and_pictures_of_two_shapes_are_refused(source, target):
    with pytest.raises(ValueError, match="has no label ffz_n; its labels: fx_n, fy_n, fz_n"):
        to_skada(source, target, axis="fz", size_px=8)
    square = coloured(5, seed=2, offset=10, size_px=(8, 8))
    with pytest.raises(ValueError, match=r"offset-0 and offset-10 become 4×3 and 4×4 px with size_px = 4"):
        to_skada(source, square, axis="z", size_px=4)
    assert to_skada(source, square, axis="z", size_px=(4, 4))[0].shape == (35, 48)


def test_pictures_are_not_enlarged(source, target):
    with pytest.raises(ValueError, match="only down-sampled"):
        to_skada(source, target, axis="z", size_px=16)
