"""The HTML of light fields and results in notebooks. Its text has the colours of the notebook, light or dark."""

import secrets
from collections.abc import Sequence

import numpy as np
from PIL import Image

from lfgpu.cameras import Explanation
from lfgpu.data import DepthResult, DisparityMap, LightField, ViewsResult
from lfgpu.reports import facts
from lfgpu.reports.report import judged
from lfgpu.viz.cards import Card, drawn_card, map_card, trust_cards, view_card
from lfgpu.viz.pages import rendered
from lfgpu.viz.panels import rgb

_WIDE, _HIGH = 640, 120  # pixels: the width of an EPI, and about its height

Rows = list[tuple[str, str]]


def html(shown: object) -> str:
    """Make the HTML of a light field, a result, a map, maps of all views, or what `lfgpu.explain` says."""
    match shown:
        case LightField():
            return _page(shown.name, *_light_field(shown))
        case DepthResult():
            return _page(shown.name, _cards(shown.map), _result(shown))
        case DisparityMap():
            return _page(shown.name, _cards(shown), _facts(shown))
        case ViewsResult():
            map_ = shown.map(shown.keys[0])
            which = ("maps", f"of {len(shown.disparities)} views; shown is that of the reference")
            return _page(map_.name, _cards(map_), [which, *_facts(map_)])
        case Explanation():
            found = judged(shown)
            findings = found["findings"] or ["the views fit together."]
            rows = [*(("finding", finding) for finding in findings), ("numbers", found["numbers"])]
            return _page(f"{shown.name}: how well the map predicts the other views", found["cards"], rows)
    raise TypeError(f"{type(shown).__name__} has no HTML.")


def _light_field(lf: LightField) -> tuple[list[Card], Rows]:
    """Return the reference view, the EPIs through its middle, and a table of facts."""
    height, width = lf.size
    x, y = width // 2, height // 2
    cards = [view_card("Reference view", rgb(lf.views[lf.reference_index], lf.scale))]
    for title, lines in ((f"EPI of row {y}", lf.epi_horizontal(y)), (f"EPI of column {x}", lf.epi_vertical(x))):
        if len(lines) > 1:
            size = _WIDE, len(lines) * max(3, round(_HIGH / len(lines)))
            epi = Image.fromarray(np.ascontiguousarray(rgb(lines, lf.scale))).resize(size, Image.Resampling.NEAREST)
            cards.append(drawn_card(title, np.asarray(epi)))
    return cards, facts.typeset_rows(lf)


def _result(result: DepthResult) -> Rows:
    return [
        *_facts(result.map),
        ("computed by", f"{result.config.method}, {result.backend} on {result.device}"),
        *([] if result.seconds is None else [("time", f"{result.seconds:.2f} s")]),
        ("status", result.status),
        *(("note", note) for note in result.notes),
        *(("cameras", sentence) for sentence in result.remarks),
    ]


def _cards(map_: DisparityMap) -> list[Card]:
    return [map_card("Disparity", map_.disparity, "disparity"), *trust_cards(map_)]


def _facts(map_: DisparityMap) -> Rows:
    height, width = map_.disparity.shape
    found = map_.disparity[np.isfinite(map_.disparity)]
    extent = f"{found.min():.3f} to {found.max():.3f} px per view step, larger is nearer" if found.size else "undefined"
    return [("size", f"{width} × {height} px"), ("disparity", extent)]


def _page(title: str, cards: Sequence[Card], rows: Rows) -> str:
    """Put cards and a table of facts into HTML for a notebook."""
    # Gradients have names, which all outputs of a notebook share.
    return rendered("notebook.html", title=title, cards=cards, facts=rows, id=f"lfgpu-{secrets.token_hex(4)}-")
