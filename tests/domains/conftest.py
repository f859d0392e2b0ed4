"""Solves are coarse, and stay in a cache of the session's own."""

from collections.abc import Iterator

import pytest
from quick_solves import coarsen


@pytest.fixture(scope="session", autouse=True)
def solve_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GELGAP_CACHE", str(tmp_path_factory.mktemp("solves")))
        yield


@pytest.fixture(scope="module", autouse=True)
def quick_solves() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        coarsen(patch)
        yield
