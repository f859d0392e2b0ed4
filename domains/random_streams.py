"""Random numbers keyed by what they are for, so that bytes depend neither on workers nor on their order."""

import hashlib
from functools import lru_cache
from typing import Literal

import numpy as np

Purpose = Literal["sensor noise", "reference noise", "acquisition", "force noise", "contacts", "split"]


def random_stream(seed: int, domain: str, purpose: Purpose, frame: int = 0) -> np.random.Generator:
    """Return the random numbers of one domain, frame and purpose, whoever draws them and whenever."""
    return np.random.default_rng(np.random.SeedSequence([seed, _word(domain), _word(purpose), frame]))


@lru_cache(maxsize=64)
def _word(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
