"""What the paper compares: its adaptation groups, its methods and their errors."""

GROUPS = (
    ("mb0i0", "wmb0i0"),
    ("wmb0i0", "mb0i0"),
    ("wmb0i0", "wmb1i1"),
    ("wmb0i0", "wmb2i2"),
    ("wmb1i1", "wmb0i0"),
    ("wmb1i1", "wmb2i2"),
    ("mb0i0", "wmb1i1"),
    ("mb0i0", "wmb2i2"),
    ("wmb1i1", "mb0i0"),
)
"""The paper's adaptation groups, source and target (its table I)."""

PAPER_MAE_N = {
    "source-only": (0.276, 0.196, 0.300, 0.384, 0.226, 0.230, 0.323, 0.304, 0.368),
    "dann": (0.098, 0.118, 0.132, 0.162, 0.120, 0.180, 0.143, 0.238, 0.185),
    "daregram": (0.082, 0.091, 0.143, 0.186, 0.102, 0.242, 0.159, 0.198, 0.129),
    "dsan": (0.086, 0.086, 0.138, 0.180, 0.095, 0.167, 0.160, 0.195, 0.105),
}
"""The paper's mean MAE in N, in the order of `GROUPS`; the methods in the paper's order, the worst first."""

PAPER_METHODS = ("dann", "daregram", "dsan")
"""The paper's methods of adaptation."""
