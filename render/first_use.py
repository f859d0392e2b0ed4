"""Saying so, once, when numba compiles the renderer: a machine's first use takes a minute and looks like a hang."""

import logging
from typing import Any

from numba.core import event

LOG = logging.getLogger(__name__)
MESSAGE = "numba compiles the renderer, which takes a minute the first time on a machine"


class _Announcement(event.Listener):
    """Warns at the first compilation of a function of gelgap; one that is loaded from numba's cache is none."""

    def __init__(self) -> None:
        self._made = False

    def on_start(self, event: Any) -> None:
        function = getattr(event.data.get("dispatcher"), "py_func", None)
        if not self._made and getattr(function, "__module__", "").startswith("gelgap."):
            self._made = True
            LOG.warning(MESSAGE)

    def on_end(self, event: Any) -> None:
        """Say nothing: what is compiled next follows at once."""


event.register("numba:compile", _Announcement())
