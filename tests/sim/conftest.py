"""Quick solves for what does not depend on how fine a mesh is."""

from dataclasses import replace

import pytest

from gelgap.sim.problem import QUALITIES


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draft on a coarser mesh: half the time, and a third of it where MuJoCo solves alone."""
    wider = {"across": 2.0, "ring_growth": 2.6, "layer_growth": 2.4}
    draft = QUALITIES["draft"]
    changed = replace(draft, disc=replace(draft.disc, **wider), pad=replace(draft.pad, **wider))
    monkeypatch.setitem(QUALITIES, "draft", changed)
