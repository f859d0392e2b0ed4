"""Install gelgap with its tested dependencies; say before what is downloaded, and meanwhile how far it is.

python scripts/set_up.py '.[test]'
"""

import json
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.request import Request, urlopen

ROOT = Path(__file__).parents[1]
SECONDS_BETWEEN_LINES = 5.0
NAMED = 5
PIP = (sys.executable, "-m", "pip", "install", "--disable-pip-version-check")


@dataclass(frozen=True)
class Package:
    """A package that is not there yet, and the size of its file; None where the index does not tell it."""

    name: str
    version: str
    size: int | None


def file_size(url: str) -> int | None:
    """Return the bytes of a file at a web or file address."""
    if url.startswith("file://") and Path(url[7:]).is_dir():
        return 0  # gelgap itself
    try:
        with urlopen(Request(url, method="HEAD"), timeout=10) as answer:
            return int(answer.headers["Content-Length"])
    except (OSError, TypeError, ValueError):
        return None


def missing_packages(what: list[str]) -> list[Package]:
    """Return what pip would install; it asks the index, and installs nothing."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        asking = Asking()
        with told(asking):
            run_pip(["--dry-run", "--report", str(report), *what], asking.hear)
        entries = json.loads(report.read_text(encoding="utf-8"))["install"]
    with ThreadPoolExecutor(16) as pool:
        sizes = list(pool.map(lambda entry: file_size(entry["download_info"]["url"]), entries))
    return [
        Package(entry["metadata"]["name"], entry["metadata"]["version"], size)
        for entry, size in zip(entries, sizes, strict=True)
    ]


def announcement(packages: list[Package]) -> str:
    """Return what will be downloaded, in words: how many packages, their size, and the largest of them."""
    known = sorted((package for package in packages if package.size), key=lambda package: -package.size)
    total = f"{sum(package.size for package in known) / 1e6:.0f} MB"
    if any(package.size is None for package in packages):
        total = f"at least {total}" if known else "of unknown size"
    largest = ", ".join(f"{package.name} {package.size / 1e6:.0f} MB" for package in known[:NAMED])
    return f"to install: {len(packages)} packages, {total}" + (f" ({largest}, …)" if largest else "")


@contextmanager
def told(progress: object) -> Iterator[None]:
    """Print a progress now and then, while something is done."""
    ended = threading.Event()

    def tell() -> None:
        while not ended.wait(SECONDS_BETWEEN_LINES):
            print(progress, flush=True)

    threading.Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        ended.set()


class Asking:
    """How many packages pip has looked up in the index, by what it says."""

    def __init__(self) -> None:
        self._looked_up, self._start = 0, time.monotonic()

    def hear(self, line: str) -> None:
        """Take note of a line of pip's."""
        self._looked_up += line.startswith(("Collecting ", "Requirement already satisfied: "))

    def __str__(self) -> str:
        return f"{time.monotonic() - self._start:6.0f} s: {self._looked_up} packages looked up"


class Progress:
    """What pip has done of a list of packages, by what it says and by what lies in the environment."""

    def __init__(self, packages: list[Package], site: Path):
        self._packages, self._site = packages, site
        self._fetched, self._installing = 0, False
        self._start = time.monotonic()

    def hear(self, line: str) -> None:
        """Take note of a line of pip's."""
        words = line.split()
        if words[:1] in (["Downloading"], ["Processing"]) or words[:2] == ["Using", "cached"]:
            self._fetched += ".metadata" not in line
        # Not the build dependencies of gelgap itself, which pip installs elsewhere before it fetches anything.
        self._installing |= words[:2] == ["Installing", "collected"]

    def __str__(self) -> str:
        count = self._in_place() if self._installing else min(self._fetched, len(self._packages))
        doing = "installed" if self._installing else "fetched"
        return f"{time.monotonic() - self._start:6.0f} s: {count} of {len(self._packages)} packages {doing}"

    def _in_place(self) -> int:
        """Return how many packages have arrived in the environment: pip writes each one's metadata last."""
        there = {plain(path.name) for path in self._site.glob("*.dist-info")}
        return len(
            {plain(f"{package.name}-{package.version}.dist-info") for package in self._packages} & there
        )


def plain(name: str) -> str:
    """Return a name in the one spelling that packages, folders and indexes agree on."""
    return name.lower().replace("-", "_").replace(".", "_")


def run_pip(arguments: list[str], hear: Callable[[str], None] = lambda line: None) -> None:
    """Run pip; what it says is only for `hear`, unless it fails: then its last words are printed."""
    last: deque[str] = deque(maxlen=40)
    command = [*PIP, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as pip:
        for line in pip.stdout or ():
            last.append(line)
            hear(line)
    if pip.returncode:
        sys.stderr.writelines(last)
        raise subprocess.CalledProcessError(pip.returncode, command)


def install(what: list[str], progress: Progress) -> None:
    """Install, and tell the progress meanwhile."""
    with told(progress):
        run_pip(["--progress-bar", "off", *what], progress.hear)
    print(progress, flush=True)


def main(extras: str) -> None:
    what = ["--constraint", str(ROOT / "constraints.txt"), "--editable", f"{ROOT}{extras.removeprefix('.')}"]
    print("asking the package index what is missing", flush=True)
    packages = missing_packages(what)
    print(announcement(packages), flush=True)
    install(what, Progress(packages, Path(sysconfig.get_path("purelib"))))


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)
