"""Check the site's links to other sites with Sphinx: a page that is gone is an error, a host out of reach is not.

python scripts/check_links.py
"""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUTPUT = ROOT / "build/links"
# What Sphinx says of a page that answered, and is not there.
_GONE = ("404 ", "410 ", "Anchor ")


@dataclass(frozen=True)
class Link:
    """A link that could not be followed, where it stands, and why; `gone` if its host knows no such page."""

    place: str
    address: str
    reason: str

    @property
    def gone(self) -> bool:
        return self.reason.startswith(_GONE)

    def __str__(self) -> str:
        return f"{self.place}: {self.address}: {self.reason[:120]}"


def failed_links(found: str) -> list[Link]:
    """Return the links that could not be followed, from the lines of Sphinx's output.json."""
    entries = map(json.loads, found.splitlines())
    return [
        Link(f"{entry['filename']}:{entry['lineno']}", entry["uri"], entry["info"])
        for entry in entries
        if entry["status"] in ("broken", "timeout")
    ]


def main() -> int:
    """Follow all links, print those that fail, and return 1 if a page is gone."""
    words = ("--quiet", "--builder", "linkcheck", "--conf-dir", "docs", "--doctree-dir", "build/doctrees")
    subprocess.run([sys.executable, "-m", "sphinx", *words, ".", str(OUTPUT)], cwd=ROOT, capture_output=True)
    failed = failed_links((OUTPUT / "output.json").read_text(encoding="utf-8"))
    gone = [link for link in failed if link.gone]
    for link in failed:
        print(f"{'GONE' if link.gone else 'not reached'}: {link}")
    print(f"{len(gone)} links lead to nothing, {len(failed) - len(gone)} could not be tried from here")
    return 1 if gone else 0


if __name__ == "__main__":
    sys.exit(main())
