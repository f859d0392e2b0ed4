"""What all benchmarks share: tables, plots, stage clocks and processes with limits."""
