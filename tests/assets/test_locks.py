"""A lock for each key of a cache: one process makes what the others wait for, and a killed one holds nothing."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from gelgap.assets.locks import key_lock

HOLDER = """
import sys, time
from pathlib import Path
from gelgap.assets.locks import key_lock
with key_lock(Path(sys.argv[1]), sys.argv[2]):
    print("held", flush=True)
    time.sleep(600)
"""
COUNTER = """
import sys
from pathlib import Path
from gelgap.assets.locks import key_lock
folder = Path(sys.argv[1])
for _ in range(20):
    with key_lock(folder, "count"):
        value = int((folder / "count").read_text())
        (folder / "count").write_text(str(value + 1))
"""


def start(code: str, *arguments: str) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, text=True)


def test_processes_take_turns_and_leave_no_file(tmp_path: Path) -> None:
    (tmp_path / "count").write_text("0")
    children = [start(COUNTER, str(tmp_path)) for _ in range(10)]
    assert [child.wait(timeout=120) for child in children] == [0] * 10
    assert (tmp_path / "count").read_text() == "200"
    assert [path.name for path in tmp_path.iterdir()] == ["count"]


def test_the_kernel_gives_the_lock_of_a_killed_process_back(tmp_path: Path) -> None:
    holder = start(HOLDER, str(tmp_path), "a")
    assert holder.stdout.readline() == "held\n"
    waited = threading.Event()

    def kill() -> None:
        waited.set()
        os.kill(holder.pid, signal.SIGKILL)

    with key_lock(tmp_path, "b", kill):
        assert not waited.is_set()
    with key_lock(tmp_path, "a", kill):
        assert waited.is_set()
    holder.wait()
    holder.stdout.close()


def test_threads_of_one_process_take_turns(tmp_path: Path) -> None:
    inside, most = [], []

    def enter() -> None:
        for _ in range(50):
            with key_lock(tmp_path, "a"):
                inside.append(1)
                most.append(len(inside))
                inside.pop()

    threads = [threading.Thread(target=enter) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(most) == 1


def test_a_folder_that_takes_no_lock_is_used_without_and_says_so(tmp_path: Path, caplog) -> None:
    (tmp_path / "file").write_text("no folder")
    with key_lock(tmp_path / "file", "a"):
        pass
    assert "file takes no locks" in caplog.text
