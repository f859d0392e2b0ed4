"""Commands solve on a coarse mesh: none of their tests asks how accurate it is."""

import pytest
from quick_solves import coarsen


@pytest.fixture(autouse=True)
def quick_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    coarsen(monkeypatch)
