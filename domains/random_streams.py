"""Random numbers keyed by what they are for, so that bytes depend neither on workers nor on their order."""

import hashlib
from typing import Literal

import numpy as np

Purpose = Literal["sensor noise", "reference noise", "acquisition", "force noise", "contacts", "split"]


def random_stream(seed: int, domain: str, purpose: Purpose, frame: int = 0) -> np.random.Generator:
    """Return the random numbers of one domain, frame and purpose, whoever draws them and whenever."""
    words = [
        int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") for text in (domain, purpose)
    ]
    return np.random.default_rng(np.random.SeedSequence([seed, *words, frame]))
