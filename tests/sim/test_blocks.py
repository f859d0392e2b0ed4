"""Blocks between lines: they fill what lies between without gaps, and are finer at the box, above and beside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelgap.sim.blocks import Coarsening, blocks_between, split_blocks

LAYERS = np.array([0.0, -0.1, -0.3, -0.7, -1.5, -2.4, -3.0])


def lines_from(seed: int, count: int) -> np.ndarray:
    """Return lines that are dense around 0."""
    place = np.sort(np.random.default_rng(seed).uniform(-1, 1, count))
    return np.unique(np.concatenate([[-4.0], 4 * place**3, [0.0, 5.0]]).round(6))


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.integers(1, 24), st.floats(0.05, 1.0))
def test_blocks_fill_what_lies_between_the_lines(seed: int, count: int, growth: float) -> None:
    lines = lines_from(seed, count), lines_from(seed + 1, count)
    box = np.array([[-0.5, 0.5], [-0.3, 0.4]])
    vertices, tetrahedra = split_blocks(lines, LAYERS, Coarsening(box, 0.1, growth, 2.5))
    corners = vertices[tetrahedra]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(9 * 9 * 3)
    faces = np.sort(np.concatenate([np.delete(tetrahedra, k, axis=1) for k in range(4)]), axis=1)
    unique, shared = np.unique(faces, axis=0, return_counts=True)
    assert shared.max() == 2
    open_faces = vertices[unique[shared == 1]]
    at_rim = [(np.abs(open_faces - bound) < 1e-9).all(axis=1) for bound in ([-4, -4, -3], [5, 5, 0])]
    assert np.concatenate(at_rim, axis=1).any(axis=1).all()


def test_blocks_are_no_wider_than_they_may_be_and_nested() -> None:
    lines = np.linspace(-4, 4, 65), np.linspace(-4, 4, 65)
    coarsening = Coarsening(np.array([[-1.0, 1.0], [-1.0, 1.0]]), 0.15, 0.4, 2.0)
    at_top, below = (blocks_between(lines, coarsening, depth) for depth in (0.0, 1.0))
    assert len(below) < len(at_top) / 2
    x, y = lines
    for i, j, k, m in at_top:
        widest = coarsening.widest_mm(np.array([x[i], y[j]]), np.array([x[k], y[m]]), 0.0)
        assert max(k - i, m - j) == 1 or max(x[k] - x[i], y[m] - y[j]) <= widest
    for i, j, k, m in at_top:
        assert any(i >= a and j >= b and k <= c and m <= d for a, b, c, d in below)


def test_blocks_between_mirrored_lines_are_mirror_images() -> None:
    half = np.array([0.1, 0.25, 0.45, 0.8, 1.3, 2.2, 4.0])
    line = np.concatenate([-half[::-1], [0.0], half])
    lines = line, line[1:-1]
    coarsening = Coarsening(np.array([[-0.5, 0.5], [-0.5, 0.5]]), 0.2, 0.4, 2.0)
    vertices, _ = split_blocks(lines, LAYERS, coarsening)
    for mirror in ([-1, 1, 1], [1, -1, 1]):
        own, image = (
            {tuple(v) for v in (points.round(6) + 0.0).tolist()} for points in (vertices, vertices * mirror)
        )
        assert own == image


def test_thin_layers_are_one_where_blocks_are_wide() -> None:
    lines = np.concatenate([np.linspace(-1, 1, 11), [1.6, 2.6, 4.2, 6.0]]), np.linspace(-1, 1, 11)
    vertices, _ = split_blocks(lines, LAYERS, Coarsening(np.array([[-1.0, 1.0], [-1.0, 1.0]]), 0.2, 0.4, 2.0))
    near, far = (
        {*vertices[np.abs(vertices[:, 0] - x_mm) < 1e-9, 2].round(9).tolist()} for x_mm in (0.0, 6.0)
    )
    assert {*LAYERS.tolist()} <= near
    assert {0.0, -3.0} <= far < near | {-0.15}
    assert -0.1 not in far
