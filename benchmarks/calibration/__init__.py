"""Calibrations that are run by hand, and whose results are constants in the code."""
