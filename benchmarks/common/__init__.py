"""What all benchmarks share: tables, plots, records, the memory and the limits of processes."""
