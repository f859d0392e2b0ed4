"""Frozen configuration objects whose bad values fail with one sentence: field, value, allowed range."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Self, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from gelgap.assets import asset_path, load_preset
from gelgap.assets.names import closest_name, quoted
from gelgap.assets.toml_file import named_in_errors, read_toml

# As pydantic has them.
_LACKS, _UNKNOWN, _FROM_VALUE_ERROR = "field required", "extra inputs are not permitted", "Value error, "


class Settings(BaseModel):
    """A frozen pydantic model that raises ValueError with one plain sentence instead of pydantic's report."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ValueError(one_sentence(error, type(self))) from None


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
    sentences: dict[tuple[Any, ...], list[tuple[type[BaseModel] | None, Any]]] = {}
    found = error.errors()
    for number, detail in enumerate(found):
        place = detail["loc"]
        # A list that lost its wrong items is not too short.
        lost = detail["type"] == "too_short" and any(
            other["loc"][: len(place)] == place for other in found[:number]
        )
        option = None if model is None else _option(model, place)
        if not lost:
            sentences.setdefault(place[:-1] if option else (number,), []).append((option, detail))
    return "; ".join(
        _of_the_meant(group) if group[0][0] else _sentence(group[0][1], model) for group in sentences.values()
    )


def _option(model: type[BaseModel], place: Sequence[Any]) -> type[BaseModel] | None:
    """Return which of several models a problem is of; None where the field takes one kind of value."""
    field = model.model_fields.get(place[0]) if place else None
    options = [] if field is None else _models(field.annotation)
    tag = str(place[-1]) if place else ""
    names = (option for option in options if tag == option.__name__ or tag.endswith(f", {option.__name__}]"))
    return next(names, None) if len(options) > 1 else None


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _of_the_meant(group: Sequence[tuple[type[BaseModel], Any]]) -> str:
    """Return the problems of the model that lacks the fewest fields, or which fields are needed if all lack some."""
    _, nearest = min(group, key=lambda one: (one[1]["msg"].count(_LACKS), one[1]["msg"].count(_UNKNOWN)))
    place = ".".join(map(str, nearest["loc"][:-1]))
    if _LACKS not in nearest["msg"]:
        return f"{place}: {nearest['msg'].removeprefix(_FROM_VALUE_ERROR)}"
    needed = [
        " and ".join(n for n, f in option.model_fields.items() if f.is_required()) for option, _ in group
    ]
    return f"{place}: must have {', or '.join(needed)}"


def _sentence(detail: Any, model: type[BaseModel] | None = None) -> str:
    field = ".".join(str(part) for part in detail["loc"]) or "settings"
    # A table given for a field would fill the screen; the field's name says where it stands.
    is_table = isinstance(detail["input"], dict | list | tuple) and "{" in repr(detail["input"])
    value = (
        ""
        if is_table or detail["type"] in ("missing", "extra_forbidden")
        else f" = {quoted(detail['input'])}"
    )
    message = detail["msg"].removeprefix(_FROM_VALUE_ERROR)
    if not message[:2].isupper():  # an abbreviation keeps its capitals
        message = message[0].lower() + message[1:]
    if detail["type"] == "extra_forbidden" and model and (near := closest_name(field, model.model_fields)):
        message += f",{near}"
    return f"{field}{value}: {message}"
