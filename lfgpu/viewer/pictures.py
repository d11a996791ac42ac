"""Arrays that pages draw: tiles of views and maps, EPIs, thumbnails, refocused views, without anything of the web.

Views come as intensities in the whole range of uint8, or of uint16 where they are stored with more than 8 bits. Maps
come as float32, so that pages colour them.
"""

import math
from threading import Lock
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import DisparityMap, LightField
from lfgpu.errors import LightFieldError
from lfgpu.viewer.contents import FINAL, QUANTITIES, Contents, Entry
from lfgpu.viewer.late import import_all

TILE = 512
"""Pixels along each side of a tile; those at the right and the lower end are smaller. Computed ones may be smaller."""

_FOCUS_VIEWS, _QUICK_FOCUS_VIEWS = 49, 25  # of a refocused picture, and of a smaller one that follows its slider
_SHARP_VIEWS = 13  # of a picture that is in focus everywhere
_ROOM = 64 * 2**20  # bytes of small views that are kept
_MET = 0.75  # pixels: a point that is not farther from a place is seen there
_THUMBNAILS = 640  # pixels: the sides of all thumbnails together, about
_LARGEST_THUMBNAIL = 96
_MOST_BINS = 1024


_Window = tuple[slice, slice]
_SmallView = tuple[NDArray[Any], NDArray[np.bool_]]
_small = WeakKeyDictionary[LightField, dict[tuple[int, int], _SmallView]]()
_keeping = Lock()


def wire_type(lf: LightField) -> type[np.uint8] | type[np.uint16]:
    """Return the type in which intensities of views are sent."""
    return np.uint8 if lf.views.dtype == np.uint8 else np.uint16


def intensities(pixels: NDArray[Any], lf: LightField) -> NDArray[Any]:
    """Convert stored values of views to intensities in the whole range of `wire_type`."""
    kind = wire_type(lf)
    factor = lf.scale * np.iinfo(kind).max
    if pixels.dtype == kind and abs(factor - 1) < 1e-9:
        return np.ascontiguousarray(pixels)
    return np.clip(pixels * np.float32(factor) + 0.5, 0, np.iinfo(kind).max).astype(kind)


def view_tile(lf: LightField, index: int, level: int, column: int, row: int) -> NDArray[Any]:
    """Return a tile [y, x, c] of a view, in which each pixel is the mean over 2**level x 2**level pixels."""
    if not 0 <= index < len(lf.views):
        raise LightFieldError(f"there is no view {index}; there are {len(lf.views)}.")
    y, x = _window(lf.size, level, column, row)
    return intensities(_reduced(lf.views[index, y, x], 2**level), lf)


def map_tile(values: NDArray[np.float32], level: int, column: int, row: int) -> NDArray[np.float32]:
    """Return a tile [y, x] of every 2**level-th row and column of a map; LightFieldError if there is no such tile."""
    height, width = values.shape
    y, x = _window((height, width), level, column, row)
    return np.ascontiguousarray(values[y, x][:: 2**level, :: 2**level], np.float32)


def histogram(values: NDArray[np.float32], low: float, high: float, bins: int) -> NDArray[np.float32]:
    """Compute the percent of the defined pixels of a map in each of equal bins from `low` to `high`."""
    if not (low < high and 1 <= bins <= _MOST_BINS):
        raise LightFieldError(f"there are no {bins} bins from {low} to {high}.")
    known = values[np.isfinite(values)]
    counts = np.histogram(known, bins, (low, high))[0]
    return (counts * (100 / max(1, known.size))).astype(np.float32)


def epi(lf: LightField, along: str, at: int) -> NDArray[Any]:
    """Return the EPI [view, pixel, c] of an image "row" or "column"; LightFieldError if there is none."""
    height, width = lf.size
    if along == "row" and 0 <= at < height:
        return intensities(lf.epi_horizontal(at), lf)
    if along == "column" and 0 <= at < width:
        return intensities(lf.epi_vertical(at), lf)
    raise LightFieldError(f"there is no EPI of {along} {at}.")


def thumbnails(lf: LightField) -> NDArray[np.uint8]:
    """Shrink all views: uint8 [n, y, x, 3]."""
    u, v = np.ptp(lf.positions, axis=0) + 1
    side = min(_LARGEST_THUMBNAIL, max(12, math.floor(_THUMBNAILS / max(float(u), float(v)))))
    step = max(1, math.floor(max(lf.size) / side))
    few = lf.views[:, step // 2 :: step, step // 2 :: step]
    grey = np.clip(few * np.float32(255 * lf.scale) + 0.5, 0, 255).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(grey, (*grey.shape[:3], 3)))


def refocused(
    lf: LightField, disparity: float, aperture: float | None, level: int, column: int, row: int, side: int
) -> NDArray[Any]:
    """Render a tile [y, x, c] of `lfgpu.refocus`, 2**level times smaller; LightFieldError if there is no such tile."""
    import_all()
    from lfgpu.viz.refocusing import refocus, within
    from lfgpu.viz.splines import LINEAR

    window = _window(lf.size, level, column, row, side)
    chosen = _spread(lf, _QUICK_FOCUS_VIEWS if level else _FOCUS_VIEWS, within(lf, aperture))
    if len(chosen) == 1:
        return _small_view(lf, level, lf.reference_index, window)[0]
    part, inner = _around(lf.size, level, window, abs(disparity) * _farthest(lf, chosen))
    few = _smaller(lf, level, chosen, part)
    return _encoded(refocus(few, disparity / 2**level, order=LINEAR)[inner], lf)


def sharp(contents: Contents, name: str, stage: str, level: int, column: int, row: int, side: int) -> NDArray[Any]:
    """Render a tile [y, x, c] of the reference view from all views, in focus everywhere, 2**level times smaller."""
    import_all()
    from lfgpu.viz.refocusing import all_in_focus
    from lfgpu.viz.splines import LINEAR

    lf, entry = contents.lf, contents.all_entries().get(name)
    if lf is None or entry is None:
        raise LightFieldError("a picture that is in focus everywhere needs a map; press Estimate.")
    window = _window(lf.size, level, column, row, side)
    chosen = _spread(lf, _SHARP_VIEWS, np.arange(len(lf.views)))
    low, high = entry.ends(stage)
    reach = max(-low, high, high - low) * _farthest(lf, chosen)  # of colours, and of what hides a point
    part, inner = _around(lf.size, level, window, reach)
    step = 2**level
    values = DisparityMap(np.ascontiguousarray(entry.stage(stage)[part][::step, ::step]) / np.float32(step))
    few = _smaller(lf, level, chosen, part)
    known = np.isfinite(values.disparity).any()
    picture = all_in_focus(few, values, order=LINEAR) if known else few.image(few.reference_index)
    return _encoded(picture[inner], lf)


def prepare() -> None:
    """Load what the first computed picture would wait for: all that is imported late, and kernels."""
    lf = LightField.from_grid(np.zeros((1, 2, 8, 8, 1), np.uint8))
    tile = (0, 0, 0, TILE)
    refocused(lf, 0.0, None, *tile)
    sharp(Contents(lf).with_entry("map", Entry(DisparityMap(np.zeros(lf.size, np.float32)))), "map", FINAL, *tile)


def values_at(contents: Contents, name: str, stage: str, x: int, y: int) -> dict[str, float | None]:
    """Return the values of a map at a pixel of the reference view, by quantity; None where they are undefined."""
    if name not in contents.all_entries() or contents.size is None:
        return {}
    height, width = contents.size
    if not (0 <= x < width and 0 <= y < height):
        raise LightFieldError(f"there is no pixel ({x}, {y}) in {width} x {height} pixels.")
    found: dict[str, float | None] = {}
    for kind in QUANTITIES:
        values = contents.map(name, kind, stage, np.s_[y : y + 1, x : x + 1])
        if values is not None:
            found[kind] = float(values[0, 0]) if np.isfinite(values[0, 0]) else None
    return found


def colour_at(contents: Contents, offset: tuple[float, float], x: float, y: float) -> list[float] | None:
    """Return the stored values of a pixel of the view at an offset from the reference; None if there is none."""
    lf = contents.lf
    there = None if lf is None else np.flatnonzero((lf.offsets == offset).all(axis=1))
    if lf is None or there is None or not there.size:
        return None
    height, width = lf.size
    pixel = lf.views[there[0], int(np.clip(y, 0, height - 1)), int(np.clip(x, 0, width - 1))]
    return [float(value) for value in pixel]


def in_reference(
    contents: Contents, name: str, stage: str, offset: tuple[float, float], x: float, y: float
) -> tuple[int, int] | None:
    """Find the pixel of the reference view that shows what pixel (x, y) of a camera (du, dv) beside it shows, by a map.

    Of several surfaces that lie behind each other it is the nearest one. None if no pixel of the map is seen there.
    """
    if contents.size is None:
        return None
    (height, width), (du, dv) = contents.size, offset
    if not (du or dv):
        return int(np.clip(x, 0, width - 1)), int(np.clip(y, 0, height - 1))
    entry = contents.all_entries().get(name)
    if entry is None:
        return None
    disparity = entry.stage(stage)
    low, high = entry.ends(stage)
    rows, columns = _between(y, dv, low, high, height), _between(x, du, low, high, width)
    if not (len(rows) and len(columns)):
        return None
    near = disparity[rows.start : rows.stop, columns.start : columns.stop]
    away = np.maximum(np.abs(np.array(columns) - near * du - x), np.abs(np.array(rows)[:, None] - near * dv - y))
    met = away <= _MET  # NaN is not
    if not met.any():
        return None
    front = met & (near >= near[met].max() - 0.5 / max(abs(du), abs(dv)))
    down, right = np.unravel_index(np.argmin(np.where(front, away, np.inf)), away.shape)
    return columns[int(right)], rows[int(down)]


def _between(at: float, step: float, low: float, high: float, side: int) -> range:
    """Return where the points that a view shows at `at` can be in the reference view, along one axis."""
    ends = sorted((at + low * step, at + high * step))
    return range(max(0, math.floor(ends[0] - 1)), min(side, math.ceil(ends[1] + 2)))


def _spread(lf: LightField, most: int, among: NDArray[np.intp]) -> NDArray[np.intp]:
    """Choose at most so many of some views, evenly in their order, the reference among them."""
    if len(among) <= most:
        return among
    chosen = among[np.linspace(0, len(among) - 1, most - 1).round().astype(np.intp)]
    return np.unique(np.append(chosen, lf.reference_index))


def _farthest(lf: LightField, chosen: NDArray[np.intp]) -> float:
    """Return how far views are from the reference, view steps along one axis."""
    return float(np.abs(lf.offsets[chosen]).max())


def _around(size: tuple[int, int], level: int, window: _Window, reach: float) -> tuple[_Window, _Window]:
    """Return a window with what lies at most `reach` pixels around it, and where the window is in this at a level.

    What is computed from the larger window is right in the smaller one.
    """
    step = 2**level
    margin = step * (math.ceil(min(reach, max(size)) / step) + 2)  # two more for what lies between pixels
    rows, columns = (_along(one, side, step, margin) for one, side in zip(window, size, strict=True))
    return (rows[0], columns[0]), (rows[1], columns[1])


def _along(window: slice, side: int, step: int, margin: int) -> tuple[slice, slice]:
    """Return `_around` along one axis."""
    part = slice(max(0, window.start - margin), min(side, window.stop + margin))
    first = (window.start - part.start) // step
    return part, slice(first, first + -(-(min(window.stop, side) - window.start) // step))


def _smaller(lf: LightField, level: int, chosen: NDArray[np.intp], part: _Window) -> LightField:
    """Shrink a part of some views of a light field 2**level times."""
    found = [_kept_view(lf, level, int(n), part) for n in chosen]
    return LightField(
        np.stack([views for views, _ in found]),
        lf.positions[chosen],
        reference=int(np.flatnonzero(chosen == lf.reference_index)[0]),
        valid=None if lf.valid is None else np.stack([valid for _, valid in found]),
    )


def _kept_view(lf: LightField, level: int, index: int, part: _Window) -> _SmallView:
    """Return a part of a view, smaller. The last whole ones that were made are kept, as long as the light field is."""
    whole = all(one.stop - one.start == side for one, side in zip(part, lf.size, strict=True))
    if not (level and whole):
        return _small_view(lf, level, index, part)
    with _keeping:
        known = _small.setdefault(lf, {})
        found = known.pop((level, index), None)
    if found is None:
        found = _small_view(lf, level, index, part)
    with _keeping:
        known[level, index] = found  # the last one
        while sum(view.nbytes + valid.nbytes for view, valid in known.values()) > _ROOM:
            known.pop(next(iter(known)))
    return found


def _small_view(lf: LightField, level: int, index: int, part: _Window) -> _SmallView:
    """Return a part [y, x, c] of a view, 2**level times smaller, and which of its pixels are valid."""
    if lf.valid is None:
        valid = np.ones((1, 1), np.bool_)  # is not asked for
    else:
        valid = _middles(lf.valid[index][part][..., None].astype(np.float32), 2**level)[..., 0] > 1 - 1e-3
    return intensities(_middles(lf.views[index][part], 2**level), lf), valid


def _middles(pixels: NDArray[Any], factor: int) -> NDArray[Any]:
    """Average the four pixels in the middle of squares: enough where views are averaged, and sooner there."""
    if factor == 1:
        return pixels
    pixels = _filled(pixels, factor)
    total = pixels[factor // 2 - 1 :: factor, factor // 2 - 1 :: factor].astype(np.float32)
    for down, right in ((0, 1), (1, 0), (1, 1)):
        total += pixels[factor // 2 - 1 + down :: factor, factor // 2 - 1 + right :: factor]
    return total * np.float32(0.25)


def _window(size: tuple[int, int], level: int, column: int, row: int, side: int = TILE) -> _Window:
    """Return rows and columns of a tile of `side` pixels at a level, 1 to `TILE`; the ends may lie beyond the picture.

    At the highest level one pixel is the whole picture.
    """
    height, width = size
    side = side * 2**level if 0 <= level <= (max(size) - 1).bit_length() and 1 <= side <= TILE else 0
    if not (side and 0 <= row * side < height and 0 <= column * side < width):
        raise LightFieldError(f"there is no tile ({column}, {row}) at level {level}.")
    return slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side)


def _reduced(pixels: NDArray[Any], factor: int) -> NDArray[Any]:
    """Average squares of pixels; those at the right and the lower end are of fewer."""
    if factor == 1:
        return pixels
    pixels = _filled(pixels, factor)
    height, width = pixels.shape[:2]
    total = np.zeros((height // factor, width // factor, pixels.shape[2]), np.float32)
    for down in range(factor):
        for right in range(factor):
            total += pixels[down::factor, right::factor]
    return total * np.float32(1 / factor**2)


def _filled(pixels: NDArray[Any], factor: int) -> NDArray[Any]:
    """Repeat the last row and column of pixels [y, x, c], so that squares of `factor` pixels fill them."""
    down, right = (-side % factor for side in pixels.shape[:2])
    return np.pad(pixels, ((0, down), (0, right), (0, 0)), mode="edge") if down or right else pixels


def _encoded(picture: NDArray[np.float32], lf: LightField) -> NDArray[Any]:
    kind = wire_type(lf)
    return (picture * np.float32(np.iinfo(kind).max) + 0.5).astype(kind)
