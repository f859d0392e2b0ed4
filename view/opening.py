"""Opening the page, which alone needs viser."""

from typing import TYPE_CHECKING

from gelgap.view.state import Configuration

if TYPE_CHECKING:
    from gelgap.view.page import Page


def open_page(start: Configuration, host: str = "127.0.0.1", port: int = 8080) -> "Page":
    """Open the page of a configuration; port 0 takes any free one, and `close` ends it.

    Raises
    ------
    ValueError
        If the gel is too thin for a path, the port is taken, or the host is not this machine's.
    ImportError
        If viser is not installed.
    """
    from gelgap.view.page import Page

    return Page(start, host, port)
