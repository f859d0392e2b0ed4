"""What gelgap keeps for itself and can no longer read is made anew."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from network_weights import weights
from valid_files import PROFILE

from gelgap.adapt import train_source
from gelgap.data import open_domain


def check_made_anew(file: Path, make: Callable[[], np.ndarray], expected: np.ndarray) -> None:
    whole = file.read_bytes()
    for content in (b"", whole[: len(whole) // 2]):
        file.write_bytes(content)
        assert np.array_equal(make(), expected)


def test_decoded_pictures(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GELGAP_CACHE", raising=False)

    def make() -> np.ndarray:
        return np.array(open_domain(files / "pictures").images())

    expected = make()
    (file,) = (files / "pictures" / ".cache").glob("*.npy")
    check_made_anew(file, make, expected)


def test_a_state_of_training(files: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = files / "resume.pt"

    def make() -> np.ndarray:
        return weights(train_source(open_domain(files / "pictures"), PROFILE, resume_file=file))

    expected = make()
    check_made_anew(file, make, expected)
    assert caplog.text.count("resume.pt cannot be resumed from") == 2
    assert caplog.text.count("training begins anew") == 2
