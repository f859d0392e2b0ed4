"""Frozen configuration objects whose bad values fail with one sentence: field, value, allowed range."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, field_validator

from gelgap.assets import asset_path, load_preset
from gelgap.assets.names import closest_name, one_line, quoted
from gelgap.assets.toml_file import named_in_errors, read_toml

_LACKS = "field required"  # as pydantic has them
_UNKNOWN = "extra inputs are not permitted"
_FROM_VALUE_ERROR = "Value error, "
# Where a field takes one of several models, pydantic says of which a problem is: `Peak`, or `function-after[…, Peak]`.
_MODEL = re.compile(r"(?:^|, )[A-Z]\w*\]?$")


class Settings(BaseModel):
    """A frozen pydantic model that raises ValueError with one plain sentence instead of pydantic's report.

    Values must have the type of their field: neither `true` nor `"0.3"` is a number, and 5.0 is not a whole number.
    A whole number is a float too, a list is a tuple, and NumPy's numbers are numbers.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: Any) -> Any:
        return _plain_value(value)

    __repr__ = __str__ = one_line

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ValueError(one_sentence(error, type(self))) from None


def _plain_value(value: Any) -> Any:
    """Return what TOML and NumPy give as Python's numbers and tuples."""
    if isinstance(value, np.generic):
        return value.item()
    return tuple(map(_plain_value, value)) if isinstance(value, list | tuple) else value


class PresetSettings(Settings):
    """Settings of which gelgap ships presets, TOML files in a folder of its assets; users write others."""

    preset_kind: ClassVar[str]

    @classmethod
    def preset(cls, name: str) -> Self:
        """Return the preset of that name.

        Raises
        ------
        ValueError
            If there is no such preset; the message lists the known ones.
        """
        return cls._of_table(load_preset(cls.preset_kind, name), name, asset_path(cls.preset_kind))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a TOML file.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not valid TOML, a field is unknown or missing, or a value is out of range; the message names it.
        """
        with named_in_errors(path):
            return cls._of_table(read_toml(path), Path(path).stem, Path(path).parent)

    @classmethod
    def named(cls, given: str | Path | Self) -> Self:
        """Return the settings of a preset's name or of a TOML file's, or settings as they are; raises as these do."""
        if isinstance(given, cls):
            return given
        return cls.load(given) if str(given).endswith(".toml") else cls.preset(str(given))

    @classmethod
    def _of_table(cls, values: dict[str, Any], name: str, folder: Path) -> Self:
        """Return what a file in a folder says; its `description` is for its readers, unless it is a field."""
        if "description" not in cls.model_fields:
            values.pop("description", None)
        return cls(**({"name": name} if "name" in cls.model_fields else {}) | values)


def within(low: float, high: float, unit: str, *, high_open: bool = False) -> AfterValidator:
    """Return a pydantic validator that allows values in [low, high], or in [low, high) if `high_open`."""

    def check(value: float) -> float:
        if not low <= value <= high or (high_open and value == high):
            closing = ")" if high_open else "]"
            raise ValueError(f"must lie in [{low:g}, {high:g}{closing} {unit}".rstrip())
        return value

    return AfterValidator(check)


def one_sentence(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """Return field, value and what is allowed for each problem that pydantic found in the values of a model.

    Of a field that takes one of several models, only the problems of the one that was meant are told.
    """
    details = error.errors()
    options: dict[tuple[Any, ...], list[str]] = {}
    sentences: dict[tuple[Any, ...], str] = {}
    for number, detail in enumerate(details):
        place = detail["loc"]
        inside = (other for other in details[:number] if other["loc"][: len(place)] == place)
        if len(place) > 1 and _MODEL.search(str(place[-1])):
            messages = options.setdefault(place[:-1], [])
            messages.append(detail["msg"].removeprefix(_FROM_VALUE_ERROR))
            sentences[place[:-1]] = f"{'.'.join(map(str, place[:-1]))}: {_of_the_meant(messages)}"
        # A list that lost its wrong items is not too short.
        elif detail["type"] != "too_short" or not any(inside):
            sentences[place] = _sentence(detail, model)
    return "; ".join(sentences.values())


def _of_the_meant(messages: Sequence[str]) -> str:
    """Return the problem of the model that lacks the fewest fields, or which fields are needed if all lack some."""
    lacking = [re.findall(rf"(\w+): {_LACKS}", message) for message in messages]
    if all(lacking):
        return f"must have {', or '.join(map(' and '.join, lacking))}"
    return min(messages, key=lambda message: (message.count(_LACKS), message.count(_UNKNOWN)))


def _sentence(detail: Any, model: type[BaseModel] | None) -> str:
    field = ".".join(map(str, detail["loc"])) or "settings"
    # A table given for a field would fill the screen; the field's name says where it stands.
    is_table = isinstance(detail["input"], dict | list | tuple) and "{" in repr(detail["input"])
    has_value = not is_table and detail["type"] not in ("missing", "extra_forbidden")
    message = detail["msg"].removeprefix(_FROM_VALUE_ERROR)
    if detail["type"] == "tuple_type":
        message = "must be several values with commas between"
    if not message[:2].isupper():  # an abbreviation keeps its capitals
        message = message[0].lower() + message[1:]
    if detail["type"] == "extra_forbidden" and model:
        message += closest_name(field, model.model_fields)
    value = f" = {quoted(detail['input'])}" if has_value else ""
    return f"{field}{value}: {message}"
