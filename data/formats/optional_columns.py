"""What a domain may hold beyond its labels and pictures, by name; nothing else is imported with these names."""

from typing import Literal

OptionalColumn = Literal[
    "height_map",
    "contact_mask",
    "marker_rest_mm",
    "marker_px",
    "diagnostics",
    "indenter",
    "torque",
    "traction",
    "turn",
]
"""What a domain may hold beyond its labels and pictures."""
