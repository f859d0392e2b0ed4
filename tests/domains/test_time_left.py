"""Estimates of the time left in simulated generations, whose true time is known."""

from collections.abc import Iterator

import pytest

from gelgap.domains.time_left import SolveSize, TimeLeft, Workload

AIM = 1.5


def simulated(
    load: Workload, slower: float, frames_slower: float = 1.0, batch: int = 64
) -> Iterator[tuple[float, float]]:
    """Run a load in simulated time, twice a second; yield the time and the estimated time left after each event.

    Every second of a core takes `slower` times as long, those of frames `frames_slower` times longer still.
    """
    left = TimeLeft(load)
    now_s, tick_s = load.start_s * slower, 0.5
    yield 0.0, left.left_s(0.0)
    waiting = dict(load.solves)
    done = dict.fromkeys(waiting, 0.0)
    while waiting:
        now_s += tick_s
        for key in list(waiting)[: load.workers]:
            size = waiting[key]
            done[key] += tick_s / slower
            if done[key] >= size.core_s:
                left.solve(key, now_s)
                del waiting[key]
            else:
                left.step(key, int(size.load_steps * done[key] / size.core_s), now_s)
            yield now_s, left.left_s(now_s)
    for _ in range(0, load.frames, batch * load.renderers):
        now_s += batch * load.frame_core_s * slower * frames_slower
        for _ in range(load.renderers):
            left.write(batch, now_s)
        yield now_s, left.left_s(now_s)


def worst_ratio(told: list[tuple[float, float]], from_share: float) -> float:
    """Return the worst ratio of estimated to true time left between a share of the whole time and its last tenth."""
    end_s = told[-1][0]
    ratios = [left_s / (end_s - now_s) for now_s, left_s in told if from_share * end_s <= now_s < 0.9 * end_s]
    assert len(ratios) > 10
    return max(max(ratio, 1 / ratio) for ratio in ratios)


SOLVES = {
    "a": SolveSize(40, 30.0),
    "b": SolveSize(60, 50.0),
    "c": SolveSize(50, 45.0),
    "d": SolveSize(30, 20.0),
}


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_what_goes_as_expected_is_told_rightly_from_the_beginning(workers: int) -> None:
    load = Workload(SOLVES, 3840, 0.01, workers, workers, start_s=3.0)
    assert worst_ratio(list(simulated(load, slower=1.0)), from_share=0.0) < AIM


@pytest.mark.parametrize("workers", [1, 2])
def test_a_machine_known_to_be_busy_is_told_rightly_from_the_beginning(workers: int) -> None:
    load = Workload(SOLVES, 3840, 0.01, workers, workers, start_s=3.0, busy=4.0)
    assert worst_ratio(list(simulated(load, slower=4.0)), from_share=0.0) < AIM


@pytest.mark.parametrize("slower", [0.5, 2.0, 3.0])
def test_a_wrong_expectation_is_corrected_by_what_is_seen(slower: float) -> None:
    load = Workload(SOLVES, 3840, 0.01, 2, 2, start_s=3.0)
    told = list(simulated(load, slower))
    assert worst_ratio(told, from_share=0.0) > AIM
    assert worst_ratio(told, from_share=0.45) < AIM


def test_frames_have_a_pace_of_their_own_and_need_no_solves() -> None:
    load = Workload({}, 12800, 0.01, 2, 2, start_s=3.0)
    told = list(simulated(load, slower=1.0, frames_slower=2.0))
    assert told[0][1] == pytest.approx(3.0 + 64.0)
    assert worst_ratio(told, from_share=0.5) < AIM


def test_one_long_solve_is_not_shared_and_time_passes_between_events() -> None:
    left = TimeLeft(Workload({"long": SolveSize(10, 100.0), "short": SolveSize(10, 10.0)}, 0, 0.01, 4, 4))
    assert left.left_s(0.0) == pytest.approx(100.0)
    left.step("long", 5, 50.0)
    left.step("long", 4, 50.0)  # events of a cluster may come late
    assert left.steps == 5
    assert left.left_s(50.0) == pytest.approx(50.0)
    assert left.left_s(60.0) == pytest.approx(40.0)
    left.solve("of the cache", 60.0)
    assert left.steps == 5
    assert TimeLeft(Workload(SOLVES, 0, 0.01, workers=None, renderers=1)).left_s(0.0) is None


def test_a_machine_that_turns_out_to_be_very_slow_is_believed_early() -> None:
    load = Workload(SOLVES, 3840, 0.01, 2, 2, start_s=3.0)
    assert worst_ratio(list(simulated(load, slower=20.0)), from_share=0.1) < AIM
