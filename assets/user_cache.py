"""The user's cache folder, which rooms share without knowing each other."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """Return $GELGAP_CACHE, or `gelgap` in the user's cache folder."""
    chosen = os.environ.get("GELGAP_CACHE")
    if chosen:
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("gelgap", appauthor=False)
