"""Run mypy over the rooms and the examples; pyproject.toml lists the modules that are left out.

Rooms are folders at the top level but packages of the namespace `gelgap`: mypy sees them through links.
"""

import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> int:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    with tempfile.TemporaryDirectory() as folder:
        namespace = Path(folder) / "gelgap"
        namespace.mkdir()
        for room, place in settings["package-dir"].items():
            (namespace / room.removeprefix("gelgap.")).symlink_to(ROOT / place, target_is_directory=True)
        (Path(folder) / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
        options = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]
        command = [sys.executable, "-m", "mypy", *options, "-p", "gelgap", "-p", "examples"]
        return subprocess.run(command, cwd=folder, env=os.environ | {"MYPYPATH": folder}).returncode


if __name__ == "__main__":
    sys.exit(main())
