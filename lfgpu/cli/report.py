"""`lfgpu depth --report`: one HTML page with the input, the results and the parameters; it needs no network."""

from __future__ import annotations

import base64
import math
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib import colormaps
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lfgpu.cli import facts
from lfgpu.config import parameters
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.errors import LightFieldError
from lfgpu.io import atomic_write
from lfgpu.methods import METHODS, method_of
from lfgpu.metrics import BORDER, evaluate
from lfgpu.viz import panels as frames
from lfgpu.viz.figures import error_reach, scale_limits

_LONG_SIDE = 720  # pixels: larger maps are scaled down to this
_HEADS = ("MSE ×100", "BadPix 0.07 %", "BadPix 0.03 %", "BadPix 0.01 %", "Q25 ×100", "RMSE", "undefined %")
_EPI_PLACES = (0.3, 0.5, 0.7)  # rows and columns of the EPIs, as shares of height and width
_WIDEST = 330  # width of the longest bar, in units of the drawing
_LEFT, _RIGHT, _TOP, _BOTTOM = 70.0, 505.0, 12.0, 190.0  # edges of the curve, in the same units


def write_report(path: Path, lf: LightField, result: DepthResult) -> None:
    """Write the page atomically; LightFieldError if the file cannot be written."""
    page = html(lf, result)
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def html(lf: LightField, result: DepthResult) -> str:
    """The page as one text, with its pictures and style inside and without scripts."""
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined)
    text = resources.files("lfgpu").joinpath("templates/report.html").read_text(encoding="utf-8")
    return environment.from_string(text).render(
        name=result.name,
        lead=f"Disparity of the view at {facts.place(*result.position)}, by lfgpu {result.versions.get('lfgpu', '')}",
        pictures=_pictures(lf, result),
        scores=_scores(lf, result),
        epis=_epis(lf, result),
        facts=_facts(lf),
        run=_run(result),
        times=_times(result),
        trace=_trace(result),
        preset=_preset(result),
        parameters=_parameters(result),
    )


def _facts(lf: LightField) -> list[tuple[str, str]]:
    return [
        ("views", facts.views(lf)),
        *((("missing", facts.missing(lf)),) if lf.missing else ()),
        ("size", facts.size(lf)),
        ("reference", facts.reference(lf)),
        ("offsets", facts.offsets(lf)),
        ("geometry", facts.geometry(lf.geometry)),
        ("ground truth", facts.truth(lf)),
        *(("note", note) for note in lf.notes),
    ]


def _run(result: DepthResult) -> list[tuple[str, str]]:
    low, high = result.disparity_range
    return [
        ("preset", _preset(result)),
        ("disparity range", f"{low:.3f} to {high:.3f} px per view step"),
        ("computed by", f"{result.backend} on {result.device}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in result.versions.items())),
        ("time", f"{result.timings['total']:.2f} s"),
        ("converged", "yes" if result.converged else "no; more iterations may improve the map"),
        ("status", result.status),
    ]


def _pictures(lf: LightField, result: DepthResult) -> list[dict[str, Any]]:
    limits = scale_limits(result.disparity)
    truth = lf.reference_truth()
    if truth is not None:
        limits = scale_limits(truth.disparity)
    view = frames.rgb(lf.views[lf.reference_index], lf.scale)
    found = [
        {"title": "Reference view", "remark": facts.reference(lf), "data": _data(_small(view), "JPEG"), "gradient": ""},
        _map("Disparity", result.disparity, "disparity", limits),
    ]
    if truth is not None:
        error = result.disparity - truth.disparity
        if truth.mask is not None:
            error = np.where(truth.mask, error, np.float32(np.nan))
        reach = error_reach(error)
        found += [
            _map("Ground truth", truth.disparity, "disparity", limits),
            _map("Error", error, "error", (-reach, reach)),
        ]
    found.append(_map("Confidence", result.confidence, "confidence", (0.0, 1.0)))
    if result.depth is not None:
        found.append(
            _map(
                "Depth", result.depth, "depth", scale_limits(np.where(np.isfinite(result.depth), result.depth, np.nan))
            )
        )
    return found


def _map(title: str, values: NDArray[np.float32], kind: str, limits: tuple[float, float]) -> dict[str, Any]:
    look, (low, high) = frames.LOOKS[kind], limits
    stops = colormaps[look.colours](np.linspace(0, 1, 17))[:, :3] * 255
    ticks = [float(t) for t in MaxNLocator(5).tick_values(low, high) if low <= t <= high]
    undefined = not np.isfinite(values).all()
    return {
        "title": title,
        "remark": "",
        "data": _data(_small(frames.colour(values, look.colours, limits)), "PNG"),
        "gradient": ", ".join(f"rgb({r:.0f} {g:.0f} {b:.0f})" for r, g, b in stops),
        "ticks": [{"place": 100 * (t - low) / max(high - low, 1e-12), "text": f"{round(t, 10):g}"} for t in ticks],
        "unit": look.unit + ("; grey: undefined" if undefined else ""),
    }


def _epis(lf: LightField, result: DepthResult) -> list[dict[str, str]]:
    """EPIs of some rows and columns, with a line of the estimated slope in the middle of each."""
    height, width = lf.size
    found = []
    lines: list[tuple[str, Any, list[tuple[int, int]]]] = []
    if len(lf.row()) > 1:
        lines.append(("Row", frames.epi_of_row, [(width // 2, int(share * height)) for share in _EPI_PLACES]))
    if len(lf.column()) > 1:
        lines.append(("Column", frames.epi_of_column, [(int(share * width), height // 2) for share in _EPI_PLACES]))
    for what, draw, places in lines:
        for x, y in places:
            slope = float(result.disparity[y, x])
            remark = f"line at {f'x {x}' if what == 'Row' else f'y {y}'}: {slope:.3f} px per view step"
            data = _data(draw(lf, x, y, slope, wide=_LONG_SIDE), "JPEG")
            found.append({"title": f"{what} {y if what == 'Row' else x}", "remark": remark, "data": data})
    return found


def _scores(lf: LightField, result: DepthResult) -> dict[str, Any] | None:
    truth = lf.reference_truth()
    if truth is None:
        return None
    rows = []
    try:
        for name, values in result.disparity_stages.items():
            m = evaluate(values, truth.disparity, mask=truth.mask)
            shares = (m.badpix_07, m.badpix_03, m.badpix_01)
            cells = [f"{m.mse_100:.3f}", *(f"{s:.2f}" for s in shares), f"{m.q25:.3f}", f"{m.rmse:.4f}"]
            rows.append({"name": name, "cells": [*cells, f"{m.undefined:.2f}"]})
            count = m.count
    except LightFieldError as error:
        return {"heads": (), "rows": [], "remark": f"The result cannot be scored: {error}"}
    remark = (
        f"Over {count} pixels, without a border of {BORDER} px; smaller is better. BadPix counts undefined pixels as "
        "bad; the other metrics leave them out. The estimate does not use the ground truth."
    )
    return {"heads": _HEADS, "rows": rows, "remark": remark}


def _times(result: DepthResult) -> list[dict[str, Any]]:
    stages = {name: seconds for name, seconds in result.timings.items() if name != "total"}
    longest = max(stages.values(), default=1.0) or 1.0
    return [
        {"name": name, "width": round(max(1.0, _WIDEST * seconds / longest), 1), "text": f"{seconds:.2f} s"}
        for name, seconds in stages.items()
    ]


def _trace(result: DepthResult) -> dict[str, Any] | None:
    """The curve of what the method traces, logarithmic where it spans much; None where there are no two iterations."""
    stage = method_of(result.config).traced
    values = np.asarray(result.trace, np.float64)
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return None
    logarithmic = bool((values > 0).all() and values.max() > 20 * values.min())
    drawn = np.log10(values) if logarithmic else values
    low, high = float(drawn.min()), float(drawn.max())
    span = high - low or 1.0
    xs = _LEFT + (_RIGHT - _LEFT) * np.arange(len(drawn)) / (len(drawn) - 1)
    ys = _BOTTOM - (_BOTTOM - _TOP) * (drawn - low) / span
    ticks = [t for t in MaxNLocator(5).tick_values(low, high) if low <= t <= high]
    first = 0 if stage.has_start else 1
    last = first + len(drawn) - 1
    steps = [round(t) for t in MaxNLocator(6, integer=True).tick_values(first, last) if first <= t <= last]
    return {
        "title": f"{(stage.value or '').capitalize()} of the {stage.label}",
        "remark": ", ".join(filter(None, (stage.unit, "logarithmic scale" if logarithmic else None))),
        "points": " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(xs, ys, strict=True)),
        "y": [
            {"place": _BOTTOM - (_BOTTOM - _TOP) * (t - low) / span, "text": f"{10**t if logarithmic else t:.3g}"}
            for t in ticks
        ],
        "x": [{"place": _LEFT + (_RIGHT - _LEFT) * (t - first) / (last - first), "text": str(t)} for t in steps],
    }


def _preset(result: DepthResult) -> str:
    """The preset of the method that has most values in common, and how many differ."""
    name, different = _nearest(result)
    return name if not different else f"{name} with {len(different)} parameter{'s' * (len(different) > 1)} changed"


def _nearest(result: DepthResult) -> tuple[str, set[str]]:
    found = {}
    for name, config in METHODS[result.config.method].presets.items():
        found[name] = {p for p, _ in parameters(config) if _value(config, p) != _value(result.config, p)}
    best = min(found, key=lambda name: len(found[name]))
    return best, found[best]


def _value(config: Any, name: str) -> Any:
    stage, parameter = name.split(".")
    return getattr(getattr(config, stage), parameter)


def _parameters(result: DepthResult) -> list[dict[str, Any]]:
    changed = _nearest(result)[1]
    return [
        {"name": name, "value": _value(result.config, name), "doc": field.metadata["doc"], "changed": name in changed}
        for name, field in parameters(result.config)
    ]


def _small(picture: frames.Picture) -> frames.Picture:
    if max(picture.shape[:2]) <= _LONG_SIDE and min(picture.shape[:2]) >= math.ceil(_LONG_SIDE / 3):
        return picture
    return np.asarray(frames.fitted(picture, wide=_LONG_SIDE, tall=_LONG_SIDE))


def _data(picture: frames.Picture, kind: str) -> str:
    return f"data:image/{kind.lower()};base64,{base64.b64encode(frames.encoded(picture, kind)).decode()}"
