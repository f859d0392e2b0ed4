"""A stream's sample n is the same whoever draws it, a picture of the press that it tells."""

import pickle
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from quick_solves import SMALL_RANGES

from gelgap.domains import PressStream, PretrainingRanges, stream
from gelgap.domains.stream import PressSample
from gelgap.render import MembraneRenderer

RANGES = PretrainingRanges(**PretrainingRanges.default().model_dump() | tomllib.loads(SMALL_RANGES))
SIZE_PX = (48, 36)


@pytest.fixture(scope="module")
def drawn(few_solves: None, solve_cache: None) -> PressStream:
    return PressStream(RANGES, seed=5, size_px=SIZE_PX, stop=12, batch_size=4)


@pytest.fixture(scope="module")
def samples(drawn: PressStream) -> list[PressSample]:
    return list(drawn)


def assert_same(one: PressSample, other: PressSample) -> None:
    assert one.number == other.number
    assert one.draw == other.draw
    for name in ("picture", "reference", "force_n"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_sample_is_a_picture_of_a_press_and_tells_it(samples: list[PressSample]) -> None:
    assert [sample.number for sample in samples] == list(range(12))
    assert {sample.picture.shape for sample in samples} == {(36, 48, 3)}
    pressed = [sample for sample in samples if sample.draw["depth_mm"] > 0]
    assert len(pressed) > 8
    assert all(sample.force_n[2] < 0 < sample.draw["fz_error_n"] for sample in pressed)
    assert len({sample.draw["depth_mm"] for sample in pressed}) == len(pressed)
    assert 1 < len({sample.draw["look"] for sample in samples}) <= stream._LOOKS_PER_SPAN
    brightness = {sample.reference.mean() for sample in samples}
    assert len(brightness) > 1


def test_sample_n_is_the_same_whatever_came_before(drawn: PressStream, samples: list[PressSample]) -> None:
    resumed = PressStream(RANGES, seed=5, size_px=SIZE_PX, start=7, stop=12)
    for one, other in zip(samples[7:], resumed, strict=True):
        assert_same(one, other)
    assert_same(samples[3], pickle.loads(pickle.dumps(drawn)).sample(3))
    assert not np.array_equal(
        PressStream(RANGES, seed=6, size_px=SIZE_PX).sample(3).picture, samples[3].picture
    )


def test_workers_draw_every_other_batch(
    drawn: PressStream, samples: list[PressSample], monkeypatch: pytest.MonkeyPatch
) -> None:
    shares = []
    for worker in range(2):
        info = SimpleNamespace(id=worker, num_workers=2)
        monkeypatch.setattr(stream, "get_worker_info", lambda info=info: info)
        shares.append(list(drawn))
    assert [[sample.number for sample in share] for share in shares] == [
        [*range(4), *range(8, 12)],
        [*range(4, 8)],
    ]
    for sample in (*shares[0], *shares[1]):
        assert_same(sample, samples[sample.number])


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_batches_are_the_same_whatever_the_workers(drawn: PressStream, workers: int) -> None:
    batches = list(drawn.loader(workers))
    assert [batch.number.tolist() for batch in batches] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]]
    np.testing.assert_array_equal(batches[1].picture[2].numpy(), drawn.sample(6).picture)
    assert batches[2].draw["depth_mm"][1] == drawn.sample(9).draw["depth_mm"]


def test_unseen_contacts_are_drawn_again_and_counted(
    drawn: PressStream, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, calls = MembraneRenderer.picture, []

    def fails_once(*args: object, **more: object) -> np.ndarray:
        calls.append(1)
        if len(calls) == 1:
            raise ValueError("folds")
        return whole(*args, **more)

    monkeypatch.setattr(MembraneRenderer, "picture", fails_once)
    assert drawn.sample(2).draw["tries"] == 2
    monkeypatch.setattr(stream, "_MOST_TRIES", 1)
    calls.clear()
    with pytest.raises(RuntimeError, match="sample 2: 1 drawn contacts cannot be seen; the last: folds"):
        drawn.sample(2)


def test_frames_for_training_are_its_samples(drawn: PressStream, samples: list[PressSample]) -> None:
    frames = drawn.frames(0, 12)
    assert len(frames) == 12
    force_n = np.stack([sample.force_n for sample in samples])
    assert sorted(frames.force_n[:, 2].tolist()) == pytest.approx(sorted(force_n[:, 2].tolist()))


@pytest.mark.parametrize("wrong", [{"start": -1}, {"stop": 2, "start": 3}, {"batch_size": 0}])
def test_wrong_arguments_are_refused(wrong: dict[str, int]) -> None:
    field, value = next(iter(wrong.items()))
    with pytest.raises(ValueError, match=f"{field} = {value}"):
        PressStream(RANGES, **wrong)
