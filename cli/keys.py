"""`--set KEY=VALUE`: single fields of settings, by the names that they have in TOML files."""

import contextlib
import re
import tomllib
from collections.abc import Mapping
from itertools import chain
from typing import Annotated, Any

import tyro

from gelgap.assets.names import quoted, unknown_name

Meanings = dict[str, str]
"""What each key means, with its unit and range."""
Words = tuple[tuple[str, ...], ...]
"""What stands behind each `--set`."""

_LIKE_A_NUMBER = re.compile("(?P<number>[-+]?[0-9]+[.,]?[0-9]*)(?P<unit>([µumc]?m|m?N|deg|°|px|s)?)")
Set = Annotated[
    Words, tyro.conf.UseAppendAction, tyro.conf.arg(metavar="KEY=VALUE ...", help_behavior_hint="")
]


def given(words: Words, keys: Mapping[str, Meanings]) -> dict[str, dict[str, Any]]:
    """Return the values that are set, by what they belong to.

    Raises
    ------
    ValueError
        If a word is not KEY=VALUE, or its key is unknown or set twice.
    """
    if () in words:
        raise ValueError("--set needs KEY=VALUE behind it, as in: --set friction=0.4")
    owner = {key: whose for whose, meanings in keys.items() for key in meanings}
    values: dict[str, dict[str, Any]] = {whose: {} for whose in keys}
    for word in chain.from_iterable(words):
        key, _, text = word.partition("=")
        key = key.strip().replace("-", "_")
        if not text:
            raise ValueError(f"--set {quoted(word)}: must be KEY=VALUE, as in: --set friction=0.4")
        if key not in owner:
            raise ValueError(f"--set {word}: {unknown_name('key', key, owner)}")
        if key in values[owner[key]]:
            raise ValueError(f"--set {word}: {key} is set twice")
        values[owner[key]][key] = _value(text.strip())
    return values


def _value(text: str) -> Any:
    """Return what a text is in TOML; a list needs only its commas, and words no quotes."""
    if "," in text and text[0] not in "[{'\"":
        return [_value(part.strip()) for part in text.split(",")]
    with contextlib.suppress(tomllib.TOMLDecodeError):
        return tomllib.loads(f"value = {text}")["value"]
    with contextlib.suppress(ValueError):
        return float(text)  # TOML does not allow .5 or 5.
    return text


def keys_listing(keys: Mapping[str, Meanings]) -> str:
    """Return the keys as --help shows them, a line each."""
    width = max(len(key) for meanings in keys.values() for key in meanings)
    lines = []
    for whose, meanings in keys.items():
        lines.append(f"\nKeys of --set for the {whose}:")
        lines += [f"  {key:<{width}}  {meaning}" for key, meaning in meanings.items()]
    return "\n".join(lines)


def advice_on(words: tuple[str, ...], keys: Mapping[str, Meanings]) -> str:
    """Return how a value is set that is given as if its key was an option, or how numbers are written; else nothing."""
    known = {key for meanings in keys.values() for key in meanings}
    said = []
    for number, word in enumerate(words):
        option, _, value = word.partition("=")
        if (like := _LIKE_A_NUMBER.fullmatch(value or word)) and ("," in word or like["unit"]):
            plain = like["number"].replace(",", ".")
            return f"{like[0]}: write {plain}, with a decimal point and no unit; a space parts two numbers"
        key = option.removeprefix("--").replace("-", "_")
        if option.startswith("--") and key in known:
            value = value or next(iter(words[number + 1 :]), "VALUE")
            said.append(f"{key}={value}")
    return f"write --set {' '.join(said)}" if said else ""
