"""Facts about light fields and results, one line of text each."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from lfgpu.data.summary import view_at

if TYPE_CHECKING:
    from datetime import datetime

    from lfgpu.config import Config
    from lfgpu.data import Geometry, LightField

_NAMED = 8  # missing views that are named


def rows(lf: LightField) -> list[tuple[str, str]]:
    """Describe all that is known of a light field: labels and lines of text."""
    lost = missing(lf)
    return [
        ("views", views(lf)),
        *((("missing", lost),) if lost else ()),
        ("size", size(lf)),
        ("reference", reference(lf)),
        ("offsets", offsets(lf)),
        ("geometry", geometry(lf.geometry)),
        ("ground truth", truth(lf)),
        *lf.reading.lines(),
    ]


def typeset_rows(lf: LightField) -> list[tuple[str, str]]:
    """Describe a light field as `rows` does, with true signs of multiplication and minus, and its notes."""
    signed = ((label, re.sub(r"(?<![\w.])-(?=\d)", "\u2212", text)) for label, text in rows(lf))
    return [
        *((label, text.replace(" x ", " \u00d7 ")) for label, text in signed),
        *(("note", note) for note in lf.notes),
    ]


def views(lf: LightField) -> str:
    """Describe the number and arrangement of the views: "81 of 81 in a 9 x 9 grid"."""
    if lf.grid_shape is None:
        return f"{len(lf.views)}, not in a grid"
    rows, columns = lf.grid_shape
    made = pattern(lf)
    of = f", a {made}" if made else ""
    return f"{len(lf.views)} of {rows * columns} in a {rows} x {columns} grid (rows x columns){of}"


def missing(lf: LightField) -> str:
    """List the empty places of the grid, the first few by name; "" if there are none, or if they are meant to be empty.

    A cross, a star, a row and a column are meant, as is any choice of at most half of the places.
    """
    if not lf.missing or pattern(lf) or len(lf.missing) >= len(lf.views):
        return ""
    named = "; ".join(f"row {row}, column {column}" for row, column in lf.missing[:_NAMED])
    more = "; ..." if len(lf.missing) > _NAMED else ""
    return f"{len(lf.missing)}: {named}{more} (counted from 0)"


def pattern(lf: LightField) -> str:
    """Return "cross", "star", "row" or "column" if some places of the grid are meant to be empty; else ""."""
    from lfgpu.io.grid import pattern_of

    if lf.grid_shape is None or not lf.missing:
        return ""
    return pattern_of([(round(v), round(u)) for u, v in lf.positions], lf.grid_shape) or ""


def size(lf: LightField) -> str:
    """Describe width, height, colour and dtype of the views."""
    height, width = lf.size
    return f"{width} x {height} px (width x height), {'grey' if lf.channels == 1 else 'colour'}, {lf.views.dtype}"


def reference(lf: LightField) -> str:
    """Describe the position of the reference view."""
    return view_at(lf.positions[lf.reference_index], lf.positions)


def offsets(lf: LightField) -> str:
    """Describe the range of the offsets from the reference view."""
    (left, top), (right, bottom) = lf.offsets.min(axis=0), lf.offsets.max(axis=0)
    return f"{left:g} to {right:g} view steps across (du), {top:g} to {bottom:g} down (dv), from the reference view"


def geometry(known: Geometry | None) -> str:
    """Describe baseline, focal length and focus distance."""
    if known is None:
        return "unknown: disparity only, no metric depth"
    focus = "at infinity" if math.isinf(known.focus_distance_m) else f"at {known.focus_distance_m:.4g} m"
    short = known.baseline_m < 1
    baseline = f"{1000 * known.baseline_m:.4g} mm" if short else f"{known.baseline_m:.4g} m"
    return f"baseline {baseline}, focal length {known.focal_length_px:.5g} px, plane of disparity 0 {focus}"


def truth(lf: LightField) -> str:
    """Describe the view whose ground truth is known, its range, and the share of it that is scored."""
    import numpy as np

    if lf.truth is None:
        return "none"
    known = np.isfinite(lf.truth.disparity)
    if not known.any():
        return f"of the view at {view_at(lf.truth.position)}, but undefined everywhere"
    low, high = lf.truth.disparity[known].min(), lf.truth.disparity[known].max()
    scored = known if lf.truth.mask is None else known & lf.truth.mask
    mask = "no mask" if lf.truth.mask is None else "within the mask"
    return (
        f"of the view at {view_at(lf.truth.position)}, {low:.3f} to {high:.3f} px per view step, "
        f"{100 * scored.mean():.1f} % of it scored ({mask})"
    )


def preset(config: Config) -> str:
    """Describe the preset that parameters are nearest to, and how many differ: "fast with 2 parameters changed"."""
    from lfgpu.methods import nearest_preset

    name, different = nearest_preset(config)
    changed = f" with {len(different)} parameter{'s' * (len(different) > 1)} changed" if different else ""
    weights = getattr(config, "weights", "")
    return f"{name}{changed}{f', weights {weights}' if weights else ''}"


def device(name: str, product: str | None) -> str:
    """Describe a device and its product name, if that is known: "cuda:0 (NVIDIA H200)"."""
    return f"{name} ({product})" if product else name


def date(moment: datetime) -> str:
    """Describe a date in words: "22 November 2026, 09:30 UTC"."""
    return f"{moment.day} {moment:%B %Y, %H:%M %Z}".rstrip()
