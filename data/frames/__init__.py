"""Labelled frames as programs use them: data sets in memory and on disk, labels, splits, network inputs."""
