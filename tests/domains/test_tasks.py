"""Tasks in processes of this machine: each after what it needs, and again where a worker dies."""

import os
import weakref
from pathlib import Path
from types import SimpleNamespace

import pytest

from gelgap.assets.progress import hidden_progress
from gelgap.domains.generation import run, tasks
from gelgap.domains.generation.tasks import Task

OF_WORKERS = """
import os
from pathlib import Path

def number(made):
    return 2 + sum(made.values())

def threads(made):
    return os.getpid(), [os.environ[f"{name}_NUM_THREADS"] for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")]

def dies(made):
    os._exit(1)

def dies_once(made):
    if not (file := Path(os.environ["DIED"])).exists():
        file.touch()
        os._exit(1)
    return "alive"

def refuses(made):
    raise ValueError("what cannot be solved")
"""


@pytest.fixture
def of_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A module that worker processes find, too."""
    (tmp_path / "of_workers.py").write_text(OF_WORKERS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("DIED", str(tmp_path / "died"))
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    import of_workers

    return of_workers


def task(key: str, make, *needs: str, kind: str = "solve") -> Task:
    return Task(kind, key, needs, make)


def made_by(listed: list[Task], processes: int = 2) -> dict[str, object]:
    return {task.key: made for task, made in run._finished_by_processes(listed, processes)}


def test_each_task_gets_what_it_needs_in_processes_of_one_thread(of_workers) -> None:
    number = of_workers.number
    listed = [task("a", number), task("b", number, "a"), task("c", number, "a", "b")]
    assert made_by(listed) == {"a": 2, "b": 4, "c": 8}
    (told,) = made_by([task("threads", of_workers.threads)]).values()
    assert told[0] != os.getpid()
    assert told[1] == ["1"] * 4
    assert os.environ["OMP_NUM_THREADS"] == "3"


def test_a_task_whose_worker_died_is_done_by_another(of_workers, tmp_path: Path) -> None:
    listed = [task("first", of_workers.dies_once), task("second", of_workers.number)]
    assert made_by(listed) == {"first": "alive", "second": 2}
    assert (tmp_path / "died").exists()


def test_a_task_that_no_worker_outlives_is_one_sentence(of_workers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "RETRIES_AFTER_WORKER_DEATH", 1)
    monkeypatch.setattr(tasks, "RETRIES_AFTER_WORKER_DEATH", 1)
    with pytest.raises(RuntimeError, match=r"workers died 2 times at one task; .*start fewer"):
        made_by([task("deadly", of_workers.dies)], 1)


def test_what_a_task_raises_is_raised_here(of_workers) -> None:
    with pytest.raises(ValueError, match="what cannot be solved"):
        made_by([task("wrong", of_workers.refuses), task("a", of_workers.number)])


def test_a_solution_is_dropped_after_the_last_batch_that_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    class Solution:
        pass

    def solve() -> Solution:
        alive.add(solution := Solution())
        return solution

    alive = weakref.WeakSet()
    batches = [SimpleNamespace(solve_keys=tuple(keys), key=f"batch {keys}") for keys in ("ab", "b", "c")]
    sources = {key: SimpleNamespace(solves=[SimpleNamespace(key=key, run=solve)]) for key in "abc"}
    plan = SimpleNamespace(batches=batches, solves="abc", sources=sources)
    monkeypatch.setattr(tasks, "render_batch", lambda *_: [len(alive)])
    assert list(run.run(plan, hidden_progress, "synchronous", None)) == [2, 1, 1]


def test_no_worker_is_started_that_has_nothing_to_do(
    make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def none_starts(listed: list[Task], processes: int):
        asked.append(processes)
        raise RuntimeError("none starts")

    monkeypatch.setattr(run, "_finished_by_processes", none_starts)
    with pytest.raises(RuntimeError, match="none starts"):
        make(tmp_path, ("mb1i2",), scheduler=None, workers=64)
    assert 1 <= asked[0] < 64
