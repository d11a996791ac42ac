"""Pages: the templates in `lfgpu/templates`, filled in."""

from functools import cache
from typing import Any

import jinja2


def rendered(template: str, **values: Any) -> str:
    """Fill in a template; texts are escaped, those of type `markupsafe.Markup` excepted."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("lfgpu", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
