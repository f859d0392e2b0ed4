"""A small domain, really solved and rendered once a session, for all rooms that read one."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args

import pytest
from quick_solves import coarsen, shrink_libraries

from gelgap.data.formats.optional_columns import OptionalColumn
from gelgap.domains.generation.generate import GenerationReport, generate
from gelgap.sim import ContactPath

# One shallow level and one radius: a single cheap solve serves all 26 frames.
TINY = ContactPath(
    name="tiny",
    points_x_mm=(-0.75, 0.75),
    points_y_mm=(0.0,),
    depths_mm=(0.2,),
    radii_mm=(0.1,),
    angles_deg=tuple(30.0 * k for k in range(12)),
)
SETTINGS = {"quality": "draft", "render_quality": "draft", "size_px": (80, 60)}
EVERY_COLUMN = get_args(OptionalColumn)


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


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four shards a domain."""
    monkeypatch.setattr("gelgap.domains.generation.plan.FRAMES_PER_SHARD", 8)


@pytest.fixture(scope="session")
def make() -> Callable[..., GenerationReport]:
    """Generate domains on the tiny path in this process."""

    def generate_tiny(out: Path, domains: tuple[str, ...] = ("mb0i0",), **changes) -> GenerationReport:
        with pytest.MonkeyPatch.context() as patch:  # the session's data are made before a module's fixtures
            coarsen(patch)
            return generate(domains, TINY, out, **{"scheduler": "synchronous", **SETTINGS, **changes})

    return generate_tiny


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory, make: Callable[..., GenerationReport]) -> Path:
    """A folder with mb0i0 (every optional column), wmb0i0 (inpainted) and mb0i1; not to be changed."""
    out = tmp_path_factory.mktemp("data")
    make(out, columns=EVERY_COLUMN)
    make(out, ("wmb0i0", "mb0i1"))
    return out


@pytest.fixture(scope="module")
def few_solves() -> Iterator[None]:
    """Libraries of few poses."""
    with pytest.MonkeyPatch.context() as patch:
        shrink_libraries(patch)
        yield
