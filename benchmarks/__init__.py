"""Run time against error: every claim of speed or accuracy comes from a command in this package."""
