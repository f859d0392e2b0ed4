"""Solves are coarse, and stay in a cache of the session's own; a closed-form dent for marks that are painted out."""

from closed_form_dent import dent, renderer  # noqa: F401
from generated_domains import quick_solves, solve_cache  # noqa: F401
