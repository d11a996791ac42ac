"""Pages: the templates in `lfgpu/templates`, filled in."""

import os
from functools import cache
from typing import Any

import jinja2

from lfgpu.io.atomic import atomic_write


def rendered(template: str, **values: Any) -> str:
    """Fill in a template; texts are escaped, those of type `markupsafe.Markup` excepted."""
    return _environment().get_template(template).render(**values)


def write_page(path: str | os.PathLike[str], page: str) -> None:
    """Write a page whole or not at all. Names in it that are no text, as those of files may be, are written out."""
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("lfgpu", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
