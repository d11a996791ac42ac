"""Short texts about arrays: what `repr` of light fields and results shows instead of their numbers; and their HTML."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu import hooks

UNIT = "px per view step"
"""The unit of disparities."""


def pixels(size: tuple[int, ...]) -> str:
    """ "512 x 640 px (height x width)" of (height, width)."""
    return f"{size[0]} x {size[1]} px (height x width)"


def span(values: NDArray[Any], unit: str) -> str:
    """ "-1.25 to 2.5 UNIT" of a map's finite values, and which share of it is unknown if any is."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "unknown everywhere"
    unknown = 1 - known.size / values.size
    return f"{known.min():.4g} to {known.max():.4g} {unit}" + (f", {unknown:.2%} unknown" if unknown else "")


def are_counted(positions: NDArray[Any]) -> bool:
    """Tell whether positions [n, 2] are columns and rows counted from zero, not distances from a camera."""
    return bool((positions.min(axis=0) == 0).all() and (positions == np.round(positions)).all())


def view_at(position: tuple[float, float], among: NDArray[Any] | None = None) -> str:
    """ "row 4, column 5" of a position (u, v), with a word if positions `among` it do not count from a corner."""
    counted = "" if among is None or are_counted(among) else " (rows and columns count from the camera at 0, 0)"
    return f"row {position[1]:g}, column {position[0]:g}{counted}"


class InNotebooks:
    """A base of whatever notebooks show as HTML."""

    def _repr_html_(self) -> str:
        """Write the HTML for notebooks."""
        return hooks.html(self)
