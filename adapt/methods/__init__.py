"""Adaptation methods; those that share a mechanism share a file."""
