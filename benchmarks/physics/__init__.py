"""Forces and membranes against finite elements of other codes."""
