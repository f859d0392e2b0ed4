"""The user's cache folder, which rooms share without knowing each other."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """Return $GELGAP_CACHE, or `gelgap` in the user's cache folder.

    Raises
    ------
    ValueError
        If $GELGAP_CACHE names a file, or a place below one.
    """
    chosen = os.environ.get("GELGAP_CACHE")
    if chosen:
        there = next((path for path in (Path(chosen), *Path(chosen).parents) if path.exists()), None)
        if there is not None and not there.is_dir():
            raise ValueError(f"GELGAP_CACHE = {chosen!r}: {there} is a file; name a folder")
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("gelgap", appauthor=False)
