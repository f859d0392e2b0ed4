"""Frozen configuration objects whose bad values fail with one sentence: field, value, allowed range."""

from typing import Any

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from gelgap.assets.names import quoted


class Settings(BaseModel):
    """A frozen pydantic model that raises ValueError with one plain sentence instead of pydantic's report."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ValueError(one_sentence(error)) from None


def within(low: float, high: float, unit: str, *, high_open: bool = False) -> AfterValidator:
    """Return a pydantic validator that allows values in [low, high], or in [low, high) if `high_open`."""

    def check(value: float) -> float:
        if not low <= value <= high or (high_open and value == high):
            closing = ")" if high_open else "]"
            raise ValueError(f"must lie in [{low:g}, {high:g}{closing} {unit}".rstrip())
        return value

    return AfterValidator(check)


def one_sentence(error: ValidationError) -> str:
    """Return field, value and what is allowed for each problem that pydantic found."""
    return "; ".join(_sentence(detail) for detail in error.errors())


def _sentence(detail: Any) -> str:
    field = ".".join(str(part) for part in detail["loc"]) or "settings"
    # A table given for a field would fill the screen; the field's name says where it stands.
    is_table = isinstance(detail["input"], dict | list | tuple) and "{" in repr(detail["input"])
    value = (
        ""
        if is_table or detail["type"] in ("missing", "extra_forbidden")
        else f" = {quoted(detail['input'])}"
    )
    message = detail["msg"].removeprefix("Value error, ")
    if not message[:2].isupper():  # an abbreviation keeps its capitals
        message = message[0].lower() + message[1:]
    return f"{field}{value}: {message}"
