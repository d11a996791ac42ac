"""The HTML of light fields and results in notebooks. Its text has the colours of the notebook, light or dark."""

import secrets
from collections.abc import Sequence

import numpy as np

from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.data.summary import view_at
from lfgpu.data.views_result import ViewsResult
from lfgpu.viz.cards import Card, drawn_card, map_card, view_card
from lfgpu.viz.pages import rendered
from lfgpu.viz.panels import epi_of_column, epi_of_row, rgb

_WIDE = 640  # pixels: the width of an EPI


def html(shown: object) -> str:
    """Make the HTML of a light field, a result, a map, or maps of all views."""
    match shown:
        case LightField():
            return light_field_html(shown)
        case DepthResult():
            return result_html(shown)
        case DisparityMap():
            return map_html(shown)
        case ViewsResult():
            return views_html(shown)
    raise TypeError(f"{type(shown).__name__} has no HTML.")


def light_field_html(lf: LightField) -> str:
    """Show the reference view, the EPIs through its middle, and a table of facts."""
    height, width = lf.size
    x, y = width // 2, height // 2
    cards = [view_card("Reference view", rgb(lf.views[lf.reference_index], lf.scale))]
    if len(lf.row()) > 1:
        cards.append(drawn_card(f"EPI of row {y}", epi_of_row(lf, y, wide=_WIDE)))
    if len(lf.column()) > 1:
        cards.append(drawn_card(f"EPI of column {x}", epi_of_column(lf, x, wide=_WIDE)))
    grid = "not in a grid" if lf.grid_shape is None else f"in a grid of {lf.grid_shape[0]} × {lf.grid_shape[1]}"
    truth = "none" if lf.truth is None else "known" if lf.reference_truth() is not None else "of another view"
    rows = [
        ("views", f"{len(lf.views)}, {grid}"),
        ("size", f"{width} × {height} px, {'grey' if lf.channels == 1 else 'colour'}, {lf.views.dtype}"),
        ("reference", view_at(lf.positions[lf.reference_index], lf.positions)),
        ("depth in metres", "yes" if lf.geometry is not None else "no, because the cameras are unknown"),
        ("ground truth", truth),
        *(("note", note) for note in lf.notes),
    ]
    return notebook_page(lf.name, cards, rows)


def result_html(result: DepthResult) -> str:
    """Show disparity, confidence and uncertainty with their scales, and a table of facts."""
    rows = [
        *_facts(result.map),
        ("computed by", f"{result.config.method}, {result.backend} on {result.device}"),
        *([] if result.seconds is None else [("time", f"{result.seconds:.2f} s")]),
        ("status", result.status),
        *(("note", note) for note in result.notes),
        *(("cameras", sentence) for sentence in result.remarks),
    ]
    return notebook_page(result.name, _cards(result.map), rows)


def map_html(map_: DisparityMap) -> str:
    """Show the map of a view, with what is known of it."""
    return notebook_page(map_.name, _cards(map_), _facts(map_))


def views_html(result: ViewsResult) -> str:
    """Show the map of the reference view, as one of all views."""
    map_ = result.map(result.keys[0])
    rows = [("maps", f"of {len(result.disparities)} views; shown is that of the reference"), *_facts(map_)]
    return notebook_page(map_.name, _cards(map_), rows)


def _cards(map_: DisparityMap) -> list[Card]:
    known = np.isfinite(map_.disparity)
    cards = [map_card("Disparity", map_.disparity, "disparity")]
    if map_.confidence is not None:
        cards.append(map_card("Confidence", np.where(known, map_.confidence, np.float32(np.nan)), "confidence"))
    if map_.uncertainty is not None:
        cards.append(map_card("Uncertainty", map_.uncertainty, "uncertainty"))
    return cards


def _facts(map_: DisparityMap) -> list[tuple[str, str]]:
    height, width = map_.disparity.shape
    found = map_.disparity[np.isfinite(map_.disparity)]
    extent = f"{found.min():.3f} to {found.max():.3f} px per view step, larger is nearer" if found.size else "undefined"
    return [("size", f"{width} × {height} px"), ("disparity", extent)]


def notebook_page(title: str, cards: Sequence[Card], rows: Sequence[tuple[str, str]]) -> str:
    """Put cards and a table of facts into HTML for a notebook."""
    # Gradients have names, which all outputs of a notebook share.
    return rendered("notebook.html", title=title, cards=cards, facts=rows, id=f"lfgpu-{secrets.token_hex(4)}-")
