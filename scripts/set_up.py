"""Install gelgap with its tested dependencies; say before what is downloaded, then let pip show how far it is.

python scripts/set_up.py '.[test]'
"""

import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.request import Request, urlopen

ROOT = Path(__file__).parents[1]
NAMED = 5
PIP = (sys.executable, "-m", "pip", "install", "--disable-pip-version-check")


def file_size(url: str) -> int | None:
    """Return the bytes of a file at a web or file address."""
    if url.startswith("file://") and Path(url[7:]).is_dir():
        return 0  # gelgap itself
    try:
        with urlopen(Request(url, method="HEAD"), timeout=10) as answer:
            return int(answer.headers["Content-Length"])
    except (OSError, TypeError, ValueError):
        return None


def missing_packages(what: list[str]) -> dict[str, int | None]:
    """Return what pip would install and the size of each file, None where the index does not tell it."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        subprocess.run([*PIP, "--quiet", "--dry-run", "--report", str(report), *what], check=True)
        entries = json.loads(report.read_text(encoding="utf-8"))["install"]
    with ThreadPoolExecutor(16) as pool:
        sizes = pool.map(lambda entry: file_size(entry["download_info"]["url"]), entries)
        return {entry["metadata"]["name"]: size for entry, size in zip(entries, sizes, strict=True)}


def announcement(packages: dict[str, int | None]) -> str:
    """Return what will be downloaded, in words: how many packages, their size, and the largest of them."""
    known = {name: size for name, size in packages.items() if size}
    total = f"{sum(known.values()) / 1e6:.0f} MB"
    if None in packages.values():
        total = f"at least {total}" if known else "of unknown size"
    largest = sorted(known, key=known.get, reverse=True)[:NAMED]
    named = f" ({', '.join(f'{name} {known[name] / 1e6:.0f} MB' for name in largest)}, …)" if largest else ""
    return f"to install: {len(packages)} packages, {total}{named}"


def main(extras: str) -> None:
    """Announce what is missing, and install it."""
    what = ["--constraint", str(ROOT / "constraints.txt"), "--editable", f"{ROOT}{extras.removeprefix('.')}"]
    print("asking the package index what is missing (a minute or two)", flush=True)
    print(announcement(missing_packages(what)), flush=True)
    subprocess.run([*PIP, *what], check=True)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)
