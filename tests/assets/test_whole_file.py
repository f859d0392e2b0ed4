"""What is said of files that are made again."""

from pathlib import Path

import pytest

from gelgap.assets.whole_file import set_aside
from gelgap.cli.speaking import Speaker


def test_a_damaged_file_is_named_once_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "a.led").write_bytes(b"damaged")
    with Speaker():
        set_aside(tmp_path / "a.led", "is damaged")
    sentence = f"{tmp_path / 'a.led'} is damaged: set aside as a.led.damaged and made again"
    assert capsys.readouterr().err == f"gelgap: {sentence}\n"
    assert (tmp_path / "a.led.damaged").read_bytes() == b"damaged"
