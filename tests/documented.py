"""What the documentation tells a reader to type: commands, code and files of its pages, and the examples of --help."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = "README.md"
_NOTEBOOKS = "docs/notebooks"
OTHER_PAGES = (
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "docs/results/README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
    *sorted(f"{_NOTEBOOKS}/{path.name}" for path in (ROOT / _NOTEBOOKS).glob("*.md")),
)
PAGES = (README, *OTHER_PAGES)
_PROGRAMS = ("gelgap", "python", "make", "dask", "pip", "git")
_COMMAND = re.compile(rf"({'|'.join(_PROGRAMS)}) \S")
FENCE = re.compile(r"^```(?:\{code-cell\} )?(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE_NAME = re.compile(r"# (\S+\.(?:toml|py))\n")


@dataclass(frozen=True)
class Snippet:
    """Something to run: a command line, Python code, or a file to write (its first line is its name in a comment)."""

    where: str
    kind: str
    text: str

    @property
    def file_name(self) -> str:
        return _FILE_NAME.match(self.text)[1]


def page_text(page: str) -> str:
    """Return the Markdown of a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def snippets(page: str) -> list[Snippet]:
    """Return what a page's fenced blocks hold, from top to bottom; the cells of a notebook are one program."""
    text = page_text(page)
    if page.startswith(_NOTEBOOKS):
        return [Snippet(page, "python", "\n".join(block[2] for block in FENCE.finditer(text)))]
    return [
        snippet
        for block in FENCE.finditer(text)
        for snippet in _of_block(f"{page}:{text.count(chr(10), 0, block.start()) + 2}", *block.groups())
    ]


def _of_block(where: str, language: str, text: str) -> Iterator[Snippet]:
    if language == "python" and _FILE_NAME.match(text):
        yield Snippet(where, "file", text)
    elif language == "python":
        yield Snippet(where, "python", text)
    elif language == "toml" and _FILE_NAME.match(text):
        yield Snippet(where, "file", text)
    elif language in ("", "sh", "bash", "text"):
        for line in text.replace("\\\n", " ").splitlines():
            if _COMMAND.match(line):
                yield Snippet(where, "command", plain(line))


def help_examples(command: str, text: str) -> list[Snippet]:
    """Return the command lines that a --help text gives as examples, one to a line."""
    lines = (line.strip().removeprefix("Example:").strip() for line in text.splitlines())
    return [
        Snippet(f"gelgap {command} --help", "command", plain(line))
        for line in lines
        if line.startswith("gelgap ")
    ]


def plain(line: str) -> str:
    """Return a command line without its comment and with single spaces."""
    return " ".join(line.partition(" # ")[0].split())
