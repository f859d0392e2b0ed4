"""`gelgap cache`: lists what is kept, says what is damaged, clears."""

from pathlib import Path

import pytest

from gelgap.cli.main import main


def test_cache_lists_entries_and_clears_them(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))
    main(["press", "--depth-mm", "0.05", "--quality", "draft"])
    (tmp_path / f"{'0' * 64}.solution").write_bytes(b"half a file")
    capsys.readouterr()
    main(["cache"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    (sound,) = [line for line in lines if "sphere 3 mm" in line]
    assert all(part in sound for part in ("draft", "MB", "deepest 0.05 mm", "gel 3 mm", "friction 0.8"))
    assert any("damaged" in line for line in lines)
    assert "holds 2 solutions" in lines[-1]
    main(["cache", "--clear"])
    assert "deleted 2 solutions" in capsys.readouterr().out
    main(["cache"])
    assert "holds 0 solutions" in capsys.readouterr().out
