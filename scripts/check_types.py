"""Run mypy over the modules from which the rooms take their public names, and over the examples that use them.

Rooms are folders at the top level but packages of the namespace `gelgap`: mypy sees them through links.
"""

import ast
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def rooms() -> dict[str, str]:
    """Return the folder of each room by its name."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    return {name.removeprefix("gelgap."): folder for name, folder in settings["package-dir"].items()}


def public_modules() -> list[str]:
    """Return the stubs of the rooms and the modules that they name."""
    found = set()
    for room in rooms():
        stub = ROOT / room / "__init__.pyi"
        if stub.is_file():
            found.add(f"gelgap.{room}")
            tree = ast.parse(stub.read_text(encoding="utf-8"))
            found |= {
                f"gelgap.{room}.{node.module}" for node in tree.body if isinstance(node, ast.ImportFrom)
            }
    return sorted(found)


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        namespace = Path(folder) / "gelgap"
        namespace.mkdir()
        for room, place in rooms().items():
            (namespace / room).symlink_to(ROOT / place, target_is_directory=True)
        (Path(folder) / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
        names = [word for module in public_modules() for word in ("-m", module)]
        names += [
            word
            for path in sorted((ROOT / "examples").glob("*.py"))
            for word in ("-m", f"examples.{path.stem}")
        ]
        options = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]
        command = [sys.executable, "-m", "mypy", *options, *names]
        return subprocess.run(command, cwd=folder, env=os.environ | {"MYPYPATH": folder}).returncode


if __name__ == "__main__":
    sys.exit(main())
