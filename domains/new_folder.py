"""A folder of output that is whole or not there: built beside its place and renamed when it is complete."""

import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gelgap.assets.locks import LOCK, sole_use


@contextmanager
def new_folder(out_dir: Path) -> Iterator[Path]:
    """Give an empty folder to write to; it becomes `out_dir` when the block ends without error.

    Raises
    ------
    ValueError
        If there is something in `out_dir`.
    RuntimeError
        If the disk does not take it, or another process is writing it; nothing of it is left.
    """
    check_is_new(out_dir)
    building = out_dir.with_name(f".{out_dir.name}.building")
    with sole_use(building):
        check_is_new(out_dir)
        try:
            _remove(path for path in building.iterdir() if not path.name.startswith(LOCK))
            yield building
            _remove(building.glob(f"{LOCK}*"))
            if out_dir.exists():
                out_dir.rmdir()
            building.rename(out_dir)
        except OSError as error:
            raise RuntimeError(f"cannot write {out_dir}: {error.strerror or error}") from error
        finally:
            shutil.rmtree(building, ignore_errors=True)


def check_is_new(out_dir: Path) -> None:
    """Raise ValueError if a folder of output has something in it."""
    if out_dir.exists() and any(out_dir.iterdir()):
        raise ValueError(f"{out_dir} is not empty; name a new folder")


def _remove(paths: Iterable[Path]) -> None:
    """Remove files and whole folders, such as those that a killed process has left."""
    for path in list(paths):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
