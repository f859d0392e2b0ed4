"""Recipes of whole domains in one TOML file, with gels and lights of one's own: what `gelgap view` saves."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from gelgap.assets.names import stays_inside
from gelgap.assets.settings import Settings
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.domains.recipe import DomainRecipe, own_recipe
from gelgap.render import Illumination, Sensor
from gelgap.sim import Elastomer


class RecipeEntry(Settings):
    """One domain of the file; a sensor is a preset's name or a table."""

    name: str
    elastomer: Elastomer
    illumination: Illumination
    sensor: str | Sensor = "paper"
    markers: bool = True


class RecipeFile(Settings):
    """The domains of a file and the contact path that they share."""

    path: str = Field("cpu", description="a path preset, or a TOML file below the working folder")
    domains: Annotated[tuple[RecipeEntry, ...], Field(min_length=1)]


def load_recipes(file: str | Path, **settings: object) -> tuple[DomainRecipe, ...]:
    """Read the recipes of a TOML file; settings are further fields of `DomainRecipe`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not valid TOML, a field is unknown or missing, a value is out of range, or two domains share a name.
    """
    values = read_toml(file)
    if isinstance(path := values.get("path"), str) and not stays_inside(path):
        raise ValueError(f"{file}: path = {path!r} must be a preset or a TOML file below the working folder")
    with named_in_errors(file):
        content = RecipeFile(**values)
        names = [entry.name for entry in content.domains]
        if len(set(names)) < len(names):
            raise ValueError(f"a domain is named twice in {', '.join(names)}; name each once")
        return tuple(_recipe(entry, content.path, settings) for entry in content.domains)


def _recipe(entry: RecipeEntry, path: str, settings: dict[str, object]) -> DomainRecipe:
    return own_recipe(
        entry.name,
        path,
        base="mb0i0" if entry.markers else "wmb0i0",
        elastomer=entry.elastomer,
        illumination=entry.illumination,
        **settings | {"sensor": entry.sensor},
    )
