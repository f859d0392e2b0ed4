"""The rigid bodies that can be pressed into the gel, one file per shape, and their registry."""
