"""The HTML of light fields and results in notebooks."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from lfgpu.viz import panels as frames
from lfgpu.viz.figures import scale_limits

if TYPE_CHECKING:
    from lfgpu.data.lightfield import LightField
    from lfgpu.data.result import DepthResult

_WIDE, _TALL = 640, 420  # pixels of a picture


def light_field_html(lf: LightField) -> str:
    """The reference view with the EPIs through its middle, and a table of facts."""
    height, width = lf.size
    picture = frames.view_with_epis(lf, lf.reference_index, width // 2, height // 2, None, wide=_WIDE, tall=_TALL)
    u, v = lf.positions[lf.reference_index]
    grid = "not in a grid" if lf.grid_shape is None else f"in a grid of {lf.grid_shape[0]} × {lf.grid_shape[1]}"
    truth = "none" if lf.truth is None else "known" if lf.reference_truth() is not None else "of another view"
    rows = [
        ("views", f"{len(lf.views)}, {grid}"),
        ("size", f"{width} × {height} px, {'grey' if lf.channels == 1 else 'colour'}, {lf.views.dtype}"),
        ("reference", f"row {v:g}, column {u:g}"),
        ("depth in metres", "yes" if lf.geometry is not None else "no, because the cameras are unknown"),
        ("ground truth", truth),
        *(("note", note) for note in lf.notes),
    ]
    return _page(lf.name, [picture], rows)


def result_html(result: DepthResult) -> str:
    """Disparity and confidence with their scales, and a table of facts."""
    pictures = [
        frames.map_picture(frames.Shown(values, kind), kind, limits, wide=_WIDE, tall=_TALL)
        for kind, values, limits in (
            ("disparity", result.disparity, scale_limits(result.disparity)),
            ("confidence", result.confidence, (0.0, 1.0)),
        )
    ]
    height, width = result.disparity.shape
    known = result.disparity[np.isfinite(result.disparity)]
    extent = f"{known.min():.3f} to {known.max():.3f} px per view step, larger is nearer" if known.size else "undefined"
    rows = [
        ("size", f"{width} × {height} px"),
        ("disparity", extent),
        ("computed by", f"{result.config.method}, {result.backend} on {result.device}"),
        ("time", f"{result.timings.get('total', float('nan')):.2f} s"),
        ("status", result.status),
        *(("cameras", sentence) for sentence in result.remarks),
    ]
    return _page(result.name, pictures, rows)


def _page(title: str, pictures: Iterable[frames.Picture], rows: Iterable[tuple[str, str]]) -> str:
    images = "".join(
        f'<img style="max-width:100%;margin:0 8px 8px 0;background:#fff" alt="" '
        f'src="data:image/png;base64,{base64.b64encode(frames.encoded(picture)).decode()}">'
        for picture in pictures
    )
    lines = "".join(
        f'<tr><td style="text-align:left;opacity:.7">{escape(label)}</td>'
        f'<td style="text-align:left">{escape(text)}</td></tr>'
        for label, text in rows
    )
    return f"<div><b>{escape(title)}</b><br>{images}<table>{lines}</table></div>"
