"""Pages and cards made of templates."""

from base64 import b64encode
from functools import cache
from typing import Any

from gelgap.assets import asset_path


def html_page(template: str, **values: Any) -> str:
    """Return the page that a template makes of the values; in `.html`, they are escaped unless marked safe.

    A picture within the page is the bytes of its file, which the filter `base64` embeds.
    """
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=FileSystemLoader(asset_path("templates")),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["base64"] = lambda data: b64encode(data).decode()
    return environment
