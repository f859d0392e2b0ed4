"""Packages that only some jobs need, and that are installed with an extra of gelgap."""

from importlib.util import find_spec


def need_extra(what: str, extra: str, *packages: str) -> None:
    """Raise ValueError with the command that installs an extra, if one of its packages is missing for `what`."""
    if missing := [package for package in packages if find_spec(package) is None]:
        word = "package" if len(missing) == 1 else "packages"
        raise ValueError(
            f"{what} needs the {word} {' and '.join(missing)}; install with: pip install 'gelgap[{extra}]'"
        )
