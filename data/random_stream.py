"""Random numbers that are keyed by seed, domain, frame and what they are for, never by who draws them."""

import hashlib
from functools import lru_cache
from typing import Literal

from numpy.random import Generator, SeedSequence, default_rng

Purpose = Literal["sensor noise", "reference noise", "acquisition", "force noise", "contacts", "split"]


def random_stream(seed: int, domain: str, purpose: Purpose, frame: int = 0) -> Generator:
    """Return the random numbers of one domain, frame and purpose, whoever draws them and whenever."""
    return default_rng(SeedSequence([seed, word(domain), word(purpose), frame]))


@lru_cache(maxsize=64)
def word(text: str) -> int:
    """Return the number that stands for a text among the seeds of random numbers."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
