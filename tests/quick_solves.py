"""Fewer and coarser solves, for tests that ask nothing of their accuracy."""

from dataclasses import replace
from functools import lru_cache

import pytest

from gelgap.sim.problem import QUALITIES
from gelgap.view import state

FEWEST_POSES = {
    "sim.library._DEPTHS": 2,
    "sim.library.MOST_SOLVES": 4,
    "sim.library._STICKING_TRAVELS": 1,
    "sim.library._SLIDING_TRAVELS": 1,
    "sim.library._HELD_OUT_TRAVELS": (0.0, 1.5),
    "domains.stream._DEPTHS": 2,
}


SMALL_RANGES = """
presses = 1
depths = 1
sphere_diameter_mm = [3.0, 3.0]
deepest_by_thickness = [0.05, 0.05]
"""
"""A file for `gelgap pretrain --ranges`: one shallow press of a small sphere."""


def coarsen(patch: pytest.MonkeyPatch) -> None:
    """Make draft solves take half their time, a third of it where MuJoCo solves alone, and standard ones as long."""
    wider = {"across": 2.0, "ring_growth": 2.6, "layer_growth": 2.4}
    draft = QUALITIES["draft"]
    meshes = {name: replace(getattr(draft, name), **wider) for name in ("disc", "pad")}
    for name in ("draft", "standard"):
        patch.setitem(QUALITIES, name, replace(draft, name=name, **meshes))
    # Names of solves that are known by now are those of other meshes.
    patch.setattr(state, "_library_keys", lru_cache(state._library_keys.__wrapped__))


def shrink_libraries(patch: pytest.MonkeyPatch) -> None:
    """Give libraries two depths, two drags at each, and a held-out depth between."""
    for name, value in FEWEST_POSES.items():
        patch.setattr(f"gelgap.{name}", value)
