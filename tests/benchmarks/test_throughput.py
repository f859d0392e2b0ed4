"""How fast domains are read: every way has a rate."""

from pathlib import Path

from gelgap.benchmarks.throughput import reading_rates
from gelgap.data import open_domain


def test_every_way_to_read_a_domain_has_a_rate(valid_files: Path):
    rates = reading_rates(open_domain(valid_files / "data" / "mb0i0"))
    assert len(rates) == rates["way"].nunique() == 6
    assert (rates["frames/s"] > 0).all()
