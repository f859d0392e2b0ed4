"""`make links` tells a page that is gone from a host that cannot be reached."""

import json
from pathlib import Path
from types import ModuleType

import pytest
from loaded_file import load_file

SCRIPT = Path(__file__).parents[1] / "scripts/check_links.py"


@pytest.fixture(scope="module")
def check_links() -> ModuleType:
    return load_file(SCRIPT)


def entry(status: str, info: str = "") -> str:
    """Return a line as Sphinx writes it."""
    return json.dumps(
        {"filename": "docs/a.md", "lineno": 3, "status": status, "uri": "https://a.example", "info": info}
    )


@pytest.mark.parametrize(
    ("status", "info", "gone"),
    [
        ("broken", "404 Client Error: Not Found for url: https://a.example", True),
        ("broken", "HTTPSConnectionPool(host='a.example', port=443): Max retries exceeded with url", False),
        ("broken", "503 Server Error: Service Unavailable for url: https://a.example", False),
    ],
)
def test_a_failing_link_is_gone_or_away(check_links: ModuleType, status: str, info: str, gone: bool) -> None:
    ((is_gone, link),) = check_links.failed_links(entry(status, info))
    assert is_gone is gone
    assert "docs/a.md:3: https://a.example" in link


def test_links_that_work_are_not_named(check_links: ModuleType) -> None:
    lines = "\n".join(entry(status) for status in ("working", "redirected", "unchecked", "ignored"))
    assert check_links.failed_links(lines) == []
