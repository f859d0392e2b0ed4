"""A small domain drawn with NumPy, whose pictures determine the force, a profile that learns it, and valid files."""

import logging
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from generated_domains import data, few_solves, make, small_shards  # noqa: F401
from hypothesis import HealthCheck, settings
from quick_solves import coarsen

from gelgap.adapt.profile import Profile
from gelgap.data import ArrayFrames

# How long an example takes says how busy the machine is.
settings.register_profile("gelgap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("gelgap")


@pytest.fixture(scope="session", autouse=True)
def interruptible():
    """Ctrl-C ends what tests start, although a shell has what it runs in the background ignore it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def users_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What tests solve is solved once by all test processes together, and the user's own cache is left alone."""
    folder = tmp_path_factory.getbasetemp()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(
            "XDG_CACHE_HOME",
            str((folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "cache"),
        )
        yield


@pytest.fixture(scope="session", autouse=True)
def quiet_commands():
    """Commands say what goes wrong, not what they begin."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gelgap.cli.speaking.SPOKEN", logging.WARNING)
        yield


def draw_domain(
    name: str, n: int = 96, seed: int = 0, tint: tuple[float, float, float] = (1, 1, 1)
) -> ArrayFrames:
    """Return n frames of a shaded dimple; its size says Fz, its asymmetry Fx and Fy."""
    rng = np.random.default_rng(seed)
    height, width = 32, 40
    y, x = np.mgrid[0:height, 0:width]
    depth, radius, angle = rng.integers(0, 5, n), rng.integers(0, 6, n), rng.integers(0, 12, n)
    point = rng.integers(0, 4, n)
    press = (depth + 1) / 5
    shear_x, shear_y = ((radius + 1) / 6 * f(np.pi / 6 * angle) for f in (np.cos, np.sin))
    force = np.stack([0.6 * shear_x * press, 0.6 * shear_y * press, -2.5 * press], axis=1)
    reference = (np.array([100, 110, 120]) * np.array(tint) * np.ones((height, width, 1))).clip(0, 255)
    right = (x - (12 + 16 * (point % 2))[:, None, None]) / 8
    down = (y - (10 + 12 * (point // 2))[:, None, None]) / 8
    dimple = press[:, None, None] * np.exp(-(right**2 + down**2) / (0.5 + press[:, None, None]))
    slope_x, slope_y = right + 1.5 * shear_x[:, None, None], down + 1.5 * shear_y[:, None, None]
    light = np.stack([slope_x, slope_y, 1 - slope_x], axis=-1)
    images = (
        reference + 60 * dimple[..., None] * light * np.array(tint) + rng.normal(0, 1, (n, height, width, 3))
    )
    return ArrayFrames(
        name=name,
        images=images.clip(0, 255).astype(np.uint8),
        reference=reference.astype(np.uint8),
        force_n=force.astype(np.float32),
        contact_class=1 + 72 * depth + 12 * radius + angle,
        point_id=point,
    )


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that ends with an exit code and one line on standard error; return the line."""

    def run(*words: str | Path, code: int = 2) -> str:
        from gelgap.cli.main import main

        with pytest.raises(SystemExit) as stop:
            main([str(word) for word in words])
        said = capsys.readouterr().err
        assert (stop.value.code, said.count("\n")) == (code, 1), said
        return said

    return run


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solves on a coarser mesh."""
    coarsen(monkeypatch)


@pytest.fixture(scope="session")
def source() -> ArrayFrames:
    return draw_domain("mb0i0")


@pytest.fixture(scope="session")
def target() -> ArrayFrames:
    return draw_domain("wmb1i1", seed=1, tint=(0.7, 1.2, 1.0))


@pytest.fixture(scope="session")
def tinted() -> ArrayFrames:
    """A domain whose pictures anyone can tell from the source's."""
    return draw_domain("tinted", seed=1, tint=(0.3, 1.9, 1.0))


@pytest.fixture(scope="session")
def profile() -> Profile:
    return Profile(
        name="test",
        width=0.125,
        feature_dim=32,
        image_size_px=(40, 32),
        pairing="difference",
        batch_size=16,
        source_epochs=25,
        source_learning_rate=0.05,
        adapt_epochs=2,
        backbone_rate_factor=1,
        transfer_weight=0.1,
        source_holdout=0.2,
    )


@pytest.fixture(scope="session")
def valid_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One valid file of every kind that people exchange."""
    from valid_files import make_valid_files

    folder = tmp_path_factory.mktemp("valid") / "files"
    make_valid_files(folder)
    return folder


@pytest.fixture
def files(valid_files: Path, tmp_path: Path) -> Path:
    """A copy to be changed."""
    return Path(shutil.copytree(valid_files, tmp_path / "files"))
