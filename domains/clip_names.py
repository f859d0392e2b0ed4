"""What the name of a clip says: the object that was pressed, and a running number behind it."""

import re

_NUMBER = re.compile(r"[\s_-]*(t=)?\d+$")


def object_of(clip: str) -> str:
    """Return a clip's name without the number at its end: `golf_ball` of `golf_ball_2`."""
    return _NUMBER.sub("", clip) or clip
