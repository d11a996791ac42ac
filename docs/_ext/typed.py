"""Types and defaults in the lists of parameters of the reference, from the annotations of functions and classes.

A docstring says what a parameter is; the annotation says its type, in the names that the source uses (`Float32Array`,
`PresetName`). Both stand together in the site, as `name : type, default value`.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any

from sphinx.application import Sphinx

_UNDERLINE = re.compile(r"^-{3,}$")
_NAME = re.compile(r"^\*{0,2}\w+(?:, \*{0,2}\w+)*$")


def add_types(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Write ` : type, default value` behind the names in the section Parameters of a docstring."""
    if "Parameters" not in lines:
        return
    types, defaults = _annotations(obj), _defaults(obj)
    place = lines.index("Parameters") + 2
    while place < len(lines) and not (place + 1 < len(lines) and _UNDERLINE.match(lines[place + 1])):
        names = [part.lstrip("*") for part in lines[place].split(", ")]
        if _NAME.match(lines[place]) and names[0] in types:
            said = [types[names[0]]] if len({types.get(part) for part in names}) == 1 else []
            if len(names) == 1 and names[0] in defaults:
                said.append(f"default {defaults[names[0]]}")
            lines[place] += f" : {', '.join(said)}" if said else ""
        place += 1


def _annotations(obj: Any) -> dict[str, str]:
    """Return annotations as they stand in the source: modules have `from __future__ import annotations`."""
    holder = obj
    if inspect.isclass(obj) and not dataclasses.is_dataclass(obj):
        holder = obj.__init__
    found = getattr(holder, "__annotations__", {})
    return {name: value.replace("bool_", "bool") for name, value in found.items() if isinstance(value, str)}  # no link


def _defaults(obj: Any) -> dict[str, str]:
    try:
        parameters = inspect.signature(obj).parameters.values()
    except (TypeError, ValueError):
        return {}
    plain = (bool, int, float, str, tuple, type(None))
    return {p.name: f"`{p.default!r}`" for p in parameters if isinstance(p.default, plain)}


def setup(app: Sphinx) -> dict[str, bool]:
    """Add types before numpydoc reads the docstrings."""
    app.connect("autodoc-process-docstring", add_types, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
