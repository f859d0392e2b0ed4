"""Requests are answered by another process; the newest wins, and a failure is an answer as well."""

import os
import queue
import signal

import pytest

from gelgap.sim import Elastomer, Pose, Sphere
from gelgap.sim.solved import NoContact
from gelgap.view.solver import Answer, Failed, Progress, SolvedAlone, Solver, Superseded, answer_to
from gelgap.view.state import LibraryRequest, PoseRequest

GEL = Elastomer.preset("e04")
UNTOUCHED = PoseRequest(GEL, Sphere(), Pose(depth_mm=0.0), "draft")
SHALLOW = PoseRequest(GEL, Sphere(), Pose(depth_mm=0.1), "draft")
PATIENCE_S = 300.0


class Line:
    """A connection on which a newer request waits or does not."""

    def __init__(self, newer: bool = False) -> None:
        self.sent: list[Answer] = []
        self._newer = newer

    def poll(self) -> bool:
        return self._newer

    def send(self, answer: Answer) -> None:
        self.sent.append(answer)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))


def test_a_pose_is_solved_with_progress() -> None:
    line = Line()
    answer = answer_to(SHALLOW, line)
    assert isinstance(answer, SolvedAlone)
    assert answer.result.force_n[2] < 0
    assert answer.result.pressure_mpa.max() > 0
    done = [progress.done for progress in line.sent]
    assert done == sorted(done)
    assert all(isinstance(progress, Progress) for progress in line.sent)
    assert line.sent[-1].done == line.sent[-1].total


def test_a_newer_request_ends_a_solve() -> None:
    with pytest.raises(Superseded):
        answer_to(LibraryRequest(GEL, Sphere()), Line(newer=True))


def test_what_fails_is_an_answer() -> None:
    off = PoseRequest(GEL, Sphere(), Pose(depth_mm=0.1, point_x_mm=99.0), "draft")
    answer = answer_to(off, Line())
    assert isinstance(answer, Failed)
    assert "lies off the pad" in answer.reason


def test_a_process_that_dies_is_reported_and_replaced() -> None:
    answers: queue.Queue[Answer] = queue.Queue()
    solving = Solver(answers.put)
    try:
        solving.request(UNTOUCHED)
        answer = answers.get(timeout=PATIENCE_S)
        assert isinstance(answer, SolvedAlone)
        assert isinstance(answer.result, NoContact)
        solving.request(LibraryRequest(GEL, Sphere()))
        os.kill(solving._process.pid, signal.SIGKILL)
        found = answers.get(timeout=PATIENCE_S)
        while isinstance(found, Progress):
            found = answers.get(timeout=PATIENCE_S)
        assert isinstance(found, Failed)
        assert "ended before it was done" in found.reason
        solving.request(UNTOUCHED)
        assert isinstance(answers.get(timeout=PATIENCE_S), SolvedAlone)
    finally:
        solving.close()


def test_only_the_newest_request_is_answered() -> None:
    answers: queue.Queue[Answer] = queue.Queue()
    solving = Solver(answers.put)
    try:
        solving.request(LibraryRequest(GEL, Sphere()))
        solving.request(UNTOUCHED)
        answer = answers.get(timeout=PATIENCE_S)
        assert answer.request == UNTOUCHED
    finally:
        solving.close()


def test_nothing_is_started_after_the_end() -> None:
    solving = Solver(lambda answer: None)
    solving.close()
    solving.request(UNTOUCHED)
    assert solving._process is None
