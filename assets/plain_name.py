"""Names from tables, manifests and records that become names of files: none leads out of its folder."""

from pathlib import PurePosixPath, PureWindowsPath


def is_plain_name(name: object) -> bool:
    """Return whether a value is a text that names one file or folder, without control characters."""
    return (
        isinstance(name, str)
        and 0 < len(name) <= 255
        and name not in (".", "..")
        and not any(letter in "/\\" or not letter.isprintable() for letter in name)
    )


def stays_inside(name: str) -> bool:
    """Return whether a relative path leads to nothing outside of the folder it starts from."""
    paths = PurePosixPath(name), PureWindowsPath(name)
    return (
        bool(name)
        and "\0" not in name
        and not any(path.is_absolute() or path.anchor or ".." in path.parts for path in paths)
    )
