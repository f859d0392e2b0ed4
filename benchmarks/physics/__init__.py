"""Forces and membranes: their errors and cost, and whether random scenes obey physics."""
