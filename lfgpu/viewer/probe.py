"""Measurements at pixels and along lines that pages ask for: costs of disparities, differences of maps, statistics."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.viewer.contents import Contents, Entry
from lfgpu.viewer.pictures import in_reference
from lfgpu.viz.scales import ERRORS, scale_limits

_THRESHOLDS = (0.07, 0.03, 0.01)  # of bad pixels
_STEPS = 129  # disparities that are tried
_BEYOND = 0.15  # of the range of the map: how far beyond it they go
_AROUND = 1  # pixels around the pixel that are compared as well


def costs(contents: Contents, name: str, stage: str, x: int, y: int) -> dict[str, Any]:
    """Measure how well views agree with a pixel of the reference at each disparity, and find the views that hide it.

    Returns `disparities` and, for each, the mean absolute difference of intensities in 3 x 3 pixels, in 255ths: `mean`
    over all views, and `best` over the better half of them, which counts where others are hidden. `found` and
    `uncertainty` are the map's, `hidden` the views in which the map has something else in front.
    """
    lf, entry = contents.lf, contents.all_entries().get(name)
    if lf is None or entry is None:
        raise LightFieldError("costs need a light field and a map of it.")
    low, high = contents.limits("disparity")
    margin = _BEYOND * (high - low)
    tried = np.linspace(low - margin, high + margin, _STEPS)
    differences = _differences(lf, tried, x, y)
    known = np.isfinite(differences)
    half = np.sort(differences, axis=0)[: max(1, len(differences) // 2)]  # NaN comes last
    with np.errstate(invalid="ignore"):
        mean = np.nansum(differences, axis=0) / known.sum(axis=0)
        best = np.nansum(half, axis=0) / np.isfinite(half).sum(axis=0)
    found = float(entry.stage(stage)[y, x])
    sure = entry.map.uncertainty
    return {
        "disparities": tried.tolist(),
        "mean": _finite(mean),
        "best": _finite(best),
        "found": found if math.isfinite(found) else None,
        "uncertainty": None if sure is None or not math.isfinite(sure[y, x]) else float(sure[y, x]),
        "hidden": [] if not math.isfinite(found) else _hidden(contents, name, stage, lf, (x, y), found),
    }


def _differences(lf: LightField, tried: NDArray[np.float64], x: int, y: int) -> NDArray[np.float64]:
    """Compare a patch of the reference with those of the other views [view, disparity]; NaN beyond their borders."""
    height, width = lf.size
    others = np.flatnonzero(np.arange(len(lf.views)) != lf.reference_index)
    down, right = np.mgrid[-_AROUND : _AROUND + 1, -_AROUND : _AROUND + 1]
    rows, columns = np.clip(y + down, 0, height - 1), np.clip(x + right, 0, width - 1)
    patch = lf.views[lf.reference_index][rows, columns].astype(np.float64)
    offsets = lf.offsets[others]
    at_x = columns - (offsets[:, :1] * tried)[:, :, None, None]
    at_y = rows - (offsets[:, 1:] * tried)[:, :, None, None]
    inside = (at_x >= 0) & (at_x <= width - 1) & (at_y >= 0) & (at_y <= height - 1)
    left, top = np.clip(at_x.astype(int), 0, max(width - 2, 0)), np.clip(at_y.astype(int), 0, max(height - 2, 0))
    beside, below = (at_x - left)[..., None], (at_y - top)[..., None]
    view = others[:, None, None, None]
    near, far = np.minimum(top + 1, height - 1), np.minimum(left + 1, width - 1)
    upper = lf.views[view, top, left] * (1 - beside) + lf.views[view, top, far] * beside
    lower = lf.views[view, near, left] * (1 - beside) + lf.views[view, near, far] * beside
    apart = np.abs(upper * (1 - below) + lower * below - patch).mean(axis=-1) * (255 * lf.scale)
    counted = inside.sum(axis=(2, 3))
    return np.where(counted > 0, np.where(inside, apart, 0).sum(axis=(2, 3)) / np.maximum(counted, 1), np.nan)


def _hidden(
    contents: Contents, name: str, stage: str, lf: LightField, pixel: tuple[int, int], disparity: float
) -> list[int]:
    """Find the views in which a map has a nearer surface in front of a pixel."""
    values, found = contents.all_entries()[name].stage(stage), []
    for index, (du, dv) in enumerate(lf.offsets.tolist()):
        there = in_reference(contents, name, stage, (du, dv), pixel[0] - disparity * du, pixel[1] - disparity * dv)
        if there is not None and values[there[1], there[0]] > disparity + 1 / max(abs(du), abs(dv), 1e-6):
            found.append(index)
    return found


def difference(values: NDArray[np.float32], kind: str) -> dict[str, Any]:
    """Describe a difference of two maps: a scale around zero, its ends, and the shares beyond the usual thresholds."""
    known = np.abs(values[np.isfinite(values)])
    if not known.size:
        raise LightFieldError("no pixel is known in both maps.")
    reach = float(np.quantile(known, 0.95)) or 1.0
    return {
        "limits": ERRORS if kind in ("disparity", "error") else (-reach, reach),
        "extent": (float(np.nanmin(values)), float(np.nanmax(values))),
        "shares": [[threshold, 100 * float((known > threshold).mean())] for threshold in _THRESHOLDS],
    }


def span(
    contents: Contents,
    values: NDArray[np.float32],
    entry: Entry,
    stage: str,
    ends: list[tuple[int, int]],
    unit: str,
) -> dict[str, Any]:
    """Measure along the line between two pixels of a map, and in the box that they span.

    Returns `along`, pixels from the start, the `values` of the nearest pixels there, and what is `said` of all.
    """
    (left, right), (top, bottom) = (sorted(pair) for pair in zip(*ends, strict=True))
    x, y = np.rint(np.linspace(ends[0], ends[1], max(right - left, bottom - top) + 1)).astype(int).T
    length = math.dist(*ends)
    box = values[top : bottom + 1, left : right + 1].astype(np.float64)
    known = box[np.isfinite(box)]
    said = [f"line {length:.1f} px"]
    metres = math.dist(*(_point(contents, entry, stage, *one) for one in ends))
    if math.isfinite(metres):
        said.append(f"{metres:.4g} m in space")
    if known.size:
        numbers = known.mean(), known.std(), np.median(known), known.min(), known.max()
        mean, spread, middle, low, high = (f"{float(value):.3g}".replace("-", "\N{MINUS SIGN}") for value in numbers)
        here = f"mean {mean} \N{PLUS-MINUS SIGN} {spread}, median {middle}, {low} to {high} {unit}".rstrip()
        said.append(f"box {box.shape[1]} \N{MULTIPLICATION SIGN} {box.shape[0]}: {here}")
    if known.size < box.size:
        said.append(f"{100 * known.size / box.size:.3g} % of the box known")
    return {"along": np.linspace(0, length, len(x)).tolist(), "values": _finite(values[y, x]), "said": "; ".join(said)}


def _point(contents: Contents, entry: Entry, stage: str, x: int, y: int) -> NDArray[np.float64]:
    """Return the point of a pixel in metres, [3]; NaN where it is unknown, and without known cameras."""
    geometry, (height, width) = contents.geometry, contents.size or (1, 1)
    if geometry is None:
        return np.full(3, np.nan)
    right, down = geometry.principal_point or ((width - 1) / 2, (height - 1) / 2)
    one = replace(geometry, principal_point=(right - x, down - y))
    return one.points(entry.stage(stage)[y : y + 1, x : x + 1], position=contents.position)[0, 0]


def seen(values: NDArray[np.float32], left: int, top: int, right: int, bottom: int) -> dict[str, Any]:
    """Choose a scale (low, high) for a part of a map; LightFieldError if nothing is known there."""
    part = values[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]
    if not np.isfinite(part).any():
        raise LightFieldError("nothing is known in the part of the map that is seen.")
    return {"limits": scale_limits(part)}


def _finite(values: NDArray[Any]) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
