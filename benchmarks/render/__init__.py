"""Pictures against a path tracer."""
