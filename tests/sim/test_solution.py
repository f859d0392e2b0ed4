"""Solutions on disk: every bit comes back, and what cannot be read is solved anew."""

import pickle
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from gelgap.cli.cache import cache_entries
from gelgap.sim.indenter import Sphere
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Elastomer, Scene, Sharing
from gelgap.sim.solution import (
    Record,
    Solution,
    SolveDiagnostics,
    cached_files,
    clear_cache,
    load_solution,
    solution_bytes,
    store_solution,
)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def solution() -> Solution:
    gel = Elastomer(young_modulus_mpa=0.1, poisson_ratio=0.45, friction=0.3, mount_stiffness_n_per_mm=7.0)
    scene = Scene(gel, Sphere(diameter_mm=2.2), "standard", Sharing())
    way = ((0, 0, -0.1), (1 / 3, -0.0, -0.1))
    problem = ContactProblem.of(scene, (-12.0, 11.9, -0.1, 0.3), way, (-1, 0))
    rng = np.random.default_rng(0)
    records = tuple(
        Record(
            displacement_mm=rng.normal(size=(5, 3)).astype(np.float32),
            normal_force_n=rng.normal(size=5).astype(np.float32),
            contact_force_n=rng.normal(size=(5, 3)).astype(np.float32),
            indenter_mm=rng.normal(size=3),
            torque_n_mm=rng.normal(size=3),
            force_n=np.array([-0.0, np.nan, 1e-310]),
            converged=converged,
            diagnostics=SolveDiagnostics(*rng.normal(size=1), 7, *rng.normal(size=7)),
        )
        for converged in (True, False)
    )
    return Solution(problem, (rng.normal(size=(5, 2)),), records)


def test_every_bit_comes_back(solution: Solution) -> None:
    store_solution(solution)
    loaded = load_solution(solution.problem.key)
    assert loaded.problem == solution.problem
    assert loaded.problem.key == solution.problem.key
    assert type(loaded.problem.indenter) is Sphere
    assert loaded.rest_mm[0].tobytes() == solution.rest_mm[0].tobytes()
    for found, record in zip(loaded.records, solution.records, strict=True):
        for name in (
            "displacement_mm",
            "normal_force_n",
            "contact_force_n",
            "indenter_mm",
            "torque_n_mm",
            "force_n",
        ):
            assert getattr(found, name).dtype == getattr(record, name).dtype
            assert getattr(found, name).tobytes() == getattr(record, name).tobytes()
        assert found.converged is record.converged
        assert astuple(found.diagnostics) == astuple(record.diagnostics)
        assert type(found.diagnostics.iterations) is int


def test_damaged_and_foreign_files_are_listed_counted_and_cleared(cache: Path, solution: Solution) -> None:
    store_solution(solution)
    key = solution.problem.key
    (cache / f"{'0' * 64}.solution").write_bytes(b"half a file")
    (cache / f"{'1' * 64}.solution").write_bytes((cache / f"{key}.solution").read_bytes())
    entries = {entry.key[0]: entry for entry in cache_entries() if entry.key != key}
    assert (entries["0"].problem, entries["0"].current) == (None, False)
    # A solution under another key is one of another version.
    assert (entries["1"].problem, entries["1"].current) == (solution.problem, False)
    assert load_solution("1" * 64) is None
    assert [entry.current for entry in cache_entries() if entry.key == key] == [True]
    assert len(cached_files()) == 3
    clear_cache()
    assert len(cached_files()) == 0


def test_a_solution_goes_between_processes(solution: Solution) -> None:
    sent = pickle.loads(pickle.dumps(solution))
    assert sent == solution
    assert solution_bytes(sent) == solution_bytes(solution)


def test_a_disk_that_takes_no_file_is_an_error(solution: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GELGAP_CACHE", "/proc/takes-no-file")
    with pytest.raises(RuntimeError, match="cannot write"):
        store_solution(solution)
