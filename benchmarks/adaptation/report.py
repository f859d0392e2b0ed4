"""The parts of the adaptation benchmark: each measured by a command, and all shown in one report."""

from pathlib import Path

from gelgap.adapt.result_table import write_page
from gelgap.benchmarks.adaptation import groups, inputs_and_lights, leaderboard
from gelgap.benchmarks.adaptation.study import BOARD, RUNS, Part, Study, is_benchmark

PARTS: dict[str, Part] = {
    "groups": groups.PART,
    "inputs": inputs_and_lights.INPUT_PART,
    "lights": inputs_and_lights.LIGHT_PART,
    "leaderboard": leaderboard.PART,
}
"""In the order of the report."""
_CHOICES = ("seeds", "methods", "groups", "inputs")


def run_groups(quick: bool, out_dir: Path) -> None:
    """Compare all methods with the board's profile, or quickly a few with the smoke profile."""
    folder = out_dir / "adaptation" / ("smoke" if quick else BOARD)
    measure("groups", Study.at(folder, workers=1 if quick else None))


def measure(name: str, study: Study) -> None:
    """Do the missing runs of a part, print its tables and write the report of all parts.

    Raises
    ------
    ValueError
        If the study chooses what this part does not let one choose.
    """
    part = PARTS[name]
    for choice in _CHOICES:
        if getattr(study, choice) and choice not in part.chosen:
            takes = ", ".join(f"--{one}" for one in part.chosen)
            raise ValueError(f"--{choice} does not narrow this part of the benchmark; it takes {takes}")
    part.measure(study)
    for table in part.tables(study.out):
        table.show()
    if is_benchmark(study.out):
        print(f"wrote {write_benchmark_report(study.out)}")


def write_benchmark_report(folder: Path, out_dir: Path | None = None) -> Path:
    """Write adaptation.html of all parts that were run; return its path.

    Raises
    ------
    FileNotFoundError
        If the folder holds no records of the benchmark.
    """
    if not is_benchmark(folder):
        raise FileNotFoundError(
            f"{folder} holds no records of the adaptation benchmark ({RUNS}); "
            "`gelgap benchmark adaptation` writes them"
        )
    tables = [table for part in PARTS.values() for table in part.tables(folder)]
    title = f"Adaptation benchmark, profile {folder.name}"
    return write_page((out_dir or folder) / "adaptation.html", title, tables)
