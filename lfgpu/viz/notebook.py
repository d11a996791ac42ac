"""The HTML of light fields and results in notebooks. Its text has the colours of the notebook, light or dark."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lfgpu.viz.cards import Card, drawn_card, map_card, view_card
from lfgpu.viz.pages import rendered
from lfgpu.viz.panels import epi_of_column, epi_of_row, rgb

if TYPE_CHECKING:
    from lfgpu.data.lightfield import LightField
    from lfgpu.data.result import DepthResult

_WIDE = 640  # pixels: the width of an EPI


def light_field_html(lf: LightField) -> str:
    """The reference view, the EPIs through its middle, and a table of facts."""
    height, width = lf.size
    x, y = width // 2, height // 2
    cards = [view_card("Reference view", rgb(lf.views[lf.reference_index], lf.scale))]
    if len(lf.row()) > 1:
        cards.append(drawn_card(f"EPI of row {y}", epi_of_row(lf, x, y, None, wide=_WIDE)))
    if len(lf.column()) > 1:
        cards.append(drawn_card(f"EPI of column {x}", epi_of_column(lf, x, y, None, wide=_WIDE)))
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
    return _page(lf.name, cards, rows)


def result_html(result: DepthResult) -> str:
    """Disparity, confidence and uncertainty with their scales, and a table of facts."""
    known = np.isfinite(result.disparity)
    cards = [
        map_card("Disparity", result.disparity, "disparity"),
        map_card("Confidence", np.where(known, result.confidence, np.float32(np.nan)), "confidence"),
    ]
    if result.uncertainty is not None:
        cards.append(map_card("Uncertainty", result.uncertainty, "uncertainty"))
    height, width = result.disparity.shape
    found = result.disparity[known]
    extent = f"{found.min():.3f} to {found.max():.3f} px per view step, larger is nearer" if found.size else "undefined"
    rows = [
        ("size", f"{width} × {height} px"),
        ("disparity", extent),
        ("computed by", f"{result.config.method}, {result.backend} on {result.device}"),
        ("time", f"{result.timings.get('total', float('nan')):.2f} s"),
        ("status", result.status),
    ]
    return _page(result.name, cards, rows)


def _page(title: str, cards: Sequence[Card], rows: Sequence[tuple[str, str]]) -> str:
    # Gradients have names, which all outputs of a notebook share.
    return rendered("notebook.html", title=title, cards=cards, facts=rows, id=f"lfgpu-{secrets.token_hex(4)}-")
