"""Self-contained HTML pages from the templates in assets/templates; every value is escaped unless marked safe."""

from functools import cache
from typing import Any

from gelgap.assets import asset_path


def html_page(template: str, **values: Any) -> str:
    """Return the page that a template (`report.html`, say) makes of the values."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(asset_path("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
