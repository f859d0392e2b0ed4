"""Labelled domains: what a domain is, how it is generated, stored and read."""

from gelgap.domains.dataset import open_domain

__all__ = ["open_domain"]
