"""Calibrations that are run by hand, and whose results stand in the code."""
