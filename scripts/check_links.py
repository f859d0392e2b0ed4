"""Check the site's links to other sites with Sphinx: a page that is gone is an error, a host out of reach is not.

python scripts/check_links.py
"""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUTPUT = ROOT / "build/links"
# What Sphinx says of a page that answered, and is not there.
_GONE = ("404 ", "410 ", "Anchor ")


def failed_links(found: str) -> list[tuple[bool, str]]:
    """Return the links that could not be followed, from the lines of Sphinx's output.json: whether gone, and which."""
    entries = [json.loads(line) for line in found.splitlines()]
    return [
        (
            one["info"].startswith(_GONE),
            f"{one['filename']}:{one['lineno']}: {one['uri']}: {one['info'][:120]}",
        )
        for one in entries
        if one["status"] in ("broken", "timeout")
    ]


def main() -> int:
    """Follow all links, print those that fail, and return 1 if a page is gone."""
    words = ("--quiet", "--builder", "linkcheck", "--conf-dir", "docs", "--doctree-dir", "build/doctrees")
    subprocess.run([sys.executable, "-m", "sphinx", *words, ".", str(OUTPUT)], cwd=ROOT, capture_output=True)
    failed = failed_links((OUTPUT / "output.json").read_text(encoding="utf-8"))
    for is_gone, link in failed:
        print(f"{'GONE' if is_gone else 'not reached'}: {link}")
    gone = sum(is_gone for is_gone, _ in failed)
    print(f"{gone} links lead to nothing, {len(failed) - gone} could not be tried from here")
    return 1 if gone else 0


if __name__ == "__main__":
    sys.exit(main())
