"""The adaptation benchmark: methods over groups, seeds, gaps and costs."""
