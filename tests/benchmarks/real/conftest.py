"""A small clone of the grasps, written once; not to be changed."""

from pathlib import Path

import pytest
from real_clones import write_wedge_clone


@pytest.fixture(scope="session")
def wedge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_wedge_clone(tmp_path_factory.mktemp("clones") / "EstimateModulus")
