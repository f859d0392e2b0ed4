"""Which methods the headline compares, and which of them are also run with the paper's split."""

from gelgap.benchmarks.adaptation.paper import PAPER_METHODS

METHODS = (
    *("source-only", "adabn", "no-transfer", "classifier-only"),
    *("coral", "dan", "jan", "dann", "cdan", "rsd", "daregram", "cod", "dsan", "dsan-soft"),
    *("mean-teacher", "uga", "importance-weighting", "tasfar", "ssa", "supervised"),
)
"""All methods: controls, alignment of distributions, other ways to adapt, source-free ones, and the ceiling."""

MAIN_METHODS = ("source-only", "adabn", "no-transfer", "classifier-only", *PAPER_METHODS, "supervised")
"""The paper's methods, their controls and the ceiling."""

SOURCE_FREE = ("ssa", "tasfar")
"""Methods that adapt without source frames: AdaBN is what they must beat."""
