"""What gelgap keeps for itself and can no longer read is made anew, and nothing in it is run."""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hostile_bytes import Bait, pickled, torch_bait
from network_weights import weights
from valid_files import PROFILE

from gelgap.adapt import train_source
from gelgap.domains import open_domain
from gelgap.render.light.spectra import camera_response


def npy_of_bait(folder: Path) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.array([Bait(folder / "bait")] * 3000, dtype=object))
    return buffer.getvalue()


def check_made_anew(
    file: Path, make: Callable[[], np.ndarray], expected: np.ndarray, bait: bytes, folder: Path
) -> None:
    whole = file.read_bytes()
    for content in (b"", whole[: len(whole) // 2], bait):
        file.write_bytes(content)
        assert np.array_equal(make(), expected)
        assert not (folder / "bait").exists()


def test_a_cameras_response(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))

    def make() -> np.ndarray:
        return camera_response("Nikon 5100 (NPL)")

    expected = make()
    (file,) = tmp_path.glob("*.led")
    check_made_anew(file, make, expected, pickled(tmp_path), tmp_path)


def test_decoded_pictures(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GELGAP_CACHE", raising=False)

    def make() -> np.ndarray:
        return np.array(open_domain(files / "pictures").images())

    expected = make()
    (file,) = (files / "pictures" / ".cache").glob("*.npy")
    check_made_anew(file, make, expected, npy_of_bait(files), files)


def test_a_state_of_training(files: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = files / "resume.pt"

    def make() -> np.ndarray:
        return weights(train_source(open_domain(files / "pictures"), PROFILE, resume_file=file))

    expected = make()
    check_made_anew(file, make, expected, torch_bait(files), files)
    assert caplog.text.count("resume.pt cannot be resumed from") == 3
    assert caplog.text.count("training begins anew") == 3
