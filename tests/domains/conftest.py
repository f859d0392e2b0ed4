"""Solves are coarse, and stay in a cache of the session's own."""

from generated_domains import quick_solves, solve_cache  # noqa: F401
