"""A closed-form dent, and renderers that tests share."""

from closed_form_dent import dent, renderer  # noqa: F401
