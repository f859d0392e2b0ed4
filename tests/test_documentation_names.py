"""What the documentation names exists: commands and flags in its sentences, dotted names, files and links."""

import contextlib
import functools
import io
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

from documented import FENCE, ROOT, page_text

from gelgap.cli.main import COMMANDS, main

PAGES = (
    "README.md",
    "CONTRIBUTING.md",
    *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")),
)
ROOMS = (
    "sim|render|data/frames|data/formats|domains|calibrate|view|adapt|benchmarks|assets"
    "|cli|tests|examples|scripts|docs"
)


OF_ANOTHER_COMMIT = re.compile(
    r"at\s+commit\s+[0-9a-f]{7}\s+by\s+`[^`]+`|`[^`]+`\s+at\s+commit\s+[0-9a-f]{7}"
)
"""A command of a study that has left: made at commit 1234567 by `…`."""


def text_of_today(page: str) -> str:
    """Return a page without the commands that run at another commit alone."""
    return OF_ANOTHER_COMMIT.sub("", page_text(page))


def inline_commands(page: str) -> set[str]:
    """Return the `gelgap …` commands that a page's sentences name between backticks."""
    sentences = FENCE.sub("", text_of_today(page))
    return {" ".join(found.split()) for found in re.findall(r"`(gelgap [^`]+)`", sentences)}


def named_objects(page: str) -> set[str]:
    """Return the dotted names under gelgap that a page mentions."""
    return set(re.findall(r"\bgelgap(?:\.[a-zA-Z_]\w*)+", text_of_today(page)))


def linked_files(page: str) -> set[str]:
    """Return the files of the project that a page links to or names between backticks."""
    text = page_text(page)
    links = {link.partition("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link}
    named = re.findall(rf"`((?:{ROOMS})/[\w./-]*)`", text)
    folder = (ROOT / page).parent
    return {str(folder / link) for link in links if link} | {str(ROOT / name) for name in named}


def test_what_pages_name_exists() -> None:
    """Commands and their flags, dotted names, files, and the sections that they link to."""
    missing = {page: list(missing_names(page)) for page in PAGES}
    assert {page: names for page, names in missing.items() if names} == {}


def missing_names(page: str) -> Iterator[str]:
    """Yield what a page names and is not there."""
    for line in inline_commands(page):
        _, command, *words = line.split()
        flags = {word for word in words if word.startswith("--")}
        if not (command.startswith("-") or (command in COMMANDS and flags <= flags_of(command) | {"--help"})):
            yield line
    yield from (name for name in named_objects(page) if not exists(name))
    yield from (path for path in linked_files(page) if not Path(path).exists())
    for target, section in re.findall(r"\]\(([\w./-]*)#([\w-]+)\)", page_text(page)):
        path = (ROOT / page).parent / target if target else ROOT / page
        headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        if section not in {slug(heading) for heading in headings}:
            yield f"{target}#{section}"


@functools.cache
def flags_of(command: str) -> set[str]:
    """Return the flags that a command's --help names."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        main([command, "--help"])
    return set(re.findall(r"--[a-z][a-z-]*", text.getvalue()))


def exists(name: str) -> bool:
    """Whether a dotted name is something of gelgap."""
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def test_every_picture_has_its_command_or_settings() -> None:
    made_by = r"(?:`gelgap|`python scripts/|\[none, a study's settings\]\(docs/)"
    table = re.findall(rf"^\| (`docs/.*?) \| {made_by}", page_text("CONTRIBUTING.md"), re.MULTILINE)
    told = {name for cell in table for name in re.findall(r"`([^`]+)`", cell)}
    pictures = {path for kind in ("*.png", "*.jpg", "*.svg") for path in (ROOT / "docs").rglob(kind)}
    shown = {str(path.relative_to(ROOT)) for path in pictures if "gallery" not in path.parts}
    assert told == shown


def slug(heading: str) -> str:
    """Return a heading's anchor, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def test_the_site_has_every_page_of_the_documentation() -> None:
    listed = set(re.findall(r"^([\w./-]+)$", page_text("docs/index.md"), re.MULTILINE))
    pages = {path.relative_to(ROOT / "docs").with_suffix("") for path in (ROOT / "docs").rglob("*.md")}
    pages |= {
        path.relative_to(ROOT / "docs").with_suffix("") for path in (ROOT / "docs/reference").glob("*.rst")
    }
    in_gallery = {page for page in pages if page.parts[0] == "gallery"}
    assert {str(page) for page in pages - in_gallery} - listed == {"index"}
    assert [
        name
        for name in listed
        if not any((ROOT / "docs" / f"{name}{end}").is_file() for end in (".md", ".rst"))
    ] in ([], ["gallery/index"])
