"""`run.jsonl`: when, where and what; the one file that may differ between equal data sets."""

import json
import platform
import time
from pathlib import Path
from typing import Any

RUN_LOG = "run.jsonl"


class RunLog:
    """Appends events to the run log of an output folder."""

    def __init__(self, out_dir: Path):
        self._path = out_dir / RUN_LOG

    def event(self, what: str, **values: Any) -> None:
        line = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "host": platform.node(),
            "event": what,
        }
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line | values) + "\n")
        except OSError:
            # A log that cannot be written, on a full disk, must not hide the original error.
            pass
