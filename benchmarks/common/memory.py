"""Peak memory of this process and the processes that it starts."""

import threading
import time

SAMPLING_PERIOD_S = 0.2
MIB = 1024**2


class MemorySampler:
    """Samples the resident memory of this process and all its children until it is left.

    `peak_bytes` is the most that all had together, `peak_child_bytes` the most that one child had, `own_s` the
    processor time that the sampling itself took.
    """

    def __init__(self) -> None:
        self.peak_bytes = 0
        self.peak_child_bytes = 0
        self.own_s = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> "MemorySampler":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _sample(self) -> None:
        import psutil

        process = psutil.Process()
        while True:
            total = 0
            for member in [process, *process.children(recursive=True)]:
                try:
                    resident = member.memory_info().rss
                except psutil.NoSuchProcess:
                    continue
                total += resident
                if member is not process:
                    self.peak_child_bytes = max(self.peak_child_bytes, resident)
            self.peak_bytes = max(self.peak_bytes, total)
            self.own_s = time.thread_time()
            if self._done.wait(SAMPLING_PERIOD_S):
                return
