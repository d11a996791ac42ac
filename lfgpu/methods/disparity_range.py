"""The range of disparities in a scene, found from the views alone by matching them at low resolution.

A pixel is evidence for a disparity if the views to one side of the reference look alike there (horizontally and
vertically, where there are views of both), if they look alike at no other disparity, and if its neighbours say the
same. The outermost evidence, with a margin, is the range: a pixel without texture has no say in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import each_view
from lfgpu.errors import LightFieldError
from lfgpu.threads import in_threads

_SIDE = 170  # about as many pixels has the shorter side of the shrunk views
_COARSEST = 24  # pixels, the least that it has
_FARTHEST = 64.0  # pixels between neighbouring views, what is searched,
_SHIFT = 0.4  # but no more than this share of the shorter side
_STEP = 0.5  # distance of the disparities that are compared, shrunk pixels in the farthest view
_MOST = 200  # disparities that are compared
_VIEWS = 3  # that are compared on each side of the reference
_DETAIL = 15  # shrunk pixels, window of the mean that is taken off: cameras may differ in brightness
_SAME = 4.0  # times the noise: views that differ by less look alike
_OTHER = 1.5  # times the noise: what other disparities must be worse by
_APART = 2.0  # shrunk pixels in the farthest view: what differs by more is another disparity
_AGREEING = 5  # of the eight neighbours
_LEAST_NOISE = 0.002  # intensity: half a step of 8 bits
_OUTLIERS = 5  # pixels left out at either end,
_UNCHECKED = 500  # or one in so many, where no other view confirms what a pair of views says
_MARGIN, _MORE = 0.25, 0.015  # at either end: pixels in the farthest view, and a share of the range that was found
_TRIES = 3  # to widen a range at whose end there is evidence


@dataclass(frozen=True)
class _Side:
    """Some views to one side of the reference."""

    views: list[int]
    horizontal: bool
    """Whether the side is the left or the right one, not the upper or the lower."""


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What one comparison found."""

    disparities: Float32Array
    """Of pixels that are evidence, [p], sorted."""
    step: float
    """Distance of the disparities that were compared."""
    unchecked: bool
    """Whether each side was a single view, and none stood opposite."""


def find_disparity_range(lf: LightField) -> tuple[float, float]:
    """Find the range of disparities in the scene.

    The nearest views are compared first, at up to 64 px between them (at most 0.4 of the views' shorter side), then
    farther ones in the range that this left. Views in the reference's row and column are compared; all, where it is
    alone in both. All comparisons are made on views whose shorter side is shrunk to about 170 px.

    Parameters
    ----------
    lf
        The light field; masked pixels are left out.

    Returns
    -------
    (low, high), pixels per view step, a small margin included.

    Raises
    ------
    LightFieldError
        If no pixel is evidence for any disparity.
    """
    shorter, farthest = min(lf.size), float(np.abs(lf.offsets).max())
    nearest = _nearest(lf)
    fine = max(1, round(shorter / _SIDE))
    coarse = max(1, min(2 * fine, shorter // _COARSEST))
    most = min(_FARTHEST, _SHIFT * shorter) / nearest
    found = [_compare(lf, _sides(lf, nearest), (-most, most), coarse)]
    low, high = _ends(lf, found)
    low, high = low - 2 * found[0].step, high + 2 * found[0].step
    for _ in range(_TRIES):
        reach = max(nearest, min(farthest, _SHIFT * shorter / max(abs(low), abs(high))))
        sides = _sides(lf, reach)
        # The finer one sees thin things, the coarser one textures that are weaker than the noise.
        found = [_compare(lf, sides, (low, high), factor) for factor in dict.fromkeys((fine, coarse))]
        first, last = _ends(lf, found)
        further, close = (high - low) / 2, 2.5 * max(evidence.step for evidence in found)
        if first >= low + close and last <= high - close:
            break
        low, high = (low - further if first < low + close else low), (high + further if last > high - close else high)
    margin = _MARGIN / farthest + _MORE * (last - first)
    return first - margin, last + margin


def _ends(lf: LightField, found: list[_Evidence]) -> tuple[float, float]:
    """The disparities of the outermost evidence, without a few pixels of each comparison at either end."""
    kept = []
    for evidence in found:
        count = len(evidence.disparities)
        outer = max(min(count // 100, _OUTLIERS), count // _UNCHECKED if evidence.unchecked else 0)
        kept.append(evidence.disparities[outer : count - outer])
    together = np.concatenate(kept)
    if not len(together):
        raise LightFieldError(
            f"{lf.name}: the disparity range cannot be found: nowhere do views look alike at one disparity only "
            "(no texture, all masked, or cameras too far apart); give disparity_range."
        )
    return float(together.min()), float(together.max())


def _along(lf: LightField, *, horizontal: bool) -> tuple[NDArray[np.bool_], Float64Array]:
    """Which views stand to the left or right (above or below), and how far, [n]."""
    line = lf.pattern("cross")
    if line.sum() < 2:
        line = lf.pattern("full")
    along, across = lf.offsets.T if horizontal else lf.offsets.T[::-1]
    beside = line & (np.abs(along) >= np.abs(across)) & (np.abs(along) > 0)
    return beside, along


def _nearest(lf: LightField) -> float:
    """How far away the nearest views are, horizontally or vertically, whichever is farther; view steps."""
    lines = [_along(lf, horizontal=horizontal) for horizontal in (True, False)]
    return float(max(np.abs(along[beside]).min() for beside, along in lines if beside.any()))


def _sides(lf: LightField, reach: float) -> list[_Side]:
    """The sides that have views, and `_VIEWS` evenly chosen of each within reach: the nearest one if none is."""
    sides = []
    for horizontal in (True, False):
        beside, along = _along(lf, horizontal=horizontal)
        for sign in (-1, 1):
            some = np.flatnonzero(beside & (sign * along > 0))
            if len(some):
                some = some[np.argsort(np.abs(along[some]), kind="stable")]
                inside = max(1, int((np.abs(along[some]) <= 1.001 * reach).sum()))
                chosen = np.unique(np.ceil(np.linspace(0, inside, _VIEWS + 1)[1:]).astype(int) - 1)
                sides.append(_Side([int(index) for index in some[chosen]], horizontal))
    return sides


def _compare(lf: LightField, sides: list[_Side], bounds: tuple[float, float], factor: int) -> _Evidence:
    """Compare the views of some sides with the reference, all shrunk `factor` times, at disparities within bounds."""
    far = max(float(np.abs(lf.offsets[side.views]).max()) for side in sides)
    step = max(_STEP * factor / far, (bounds[1] - bounds[0]) / (_MOST - 1))
    disparities = bounds[0] + step * np.arange(max(3, math.ceil((bounds[1] - bounds[0]) / step) + 1))
    lines = _costs(lf, sides, disparities / factor, factor)
    apart = max(1, round(_APART * factor / far / step))
    disparity, certain = _distinct(lines, apart)
    disparity = (disparities[0] + step * disparity).astype(np.float32)
    certain &= _agreeing(disparity, certain, 1.5 * step) >= _AGREEING
    unchecked = len(lines) == len(sides) and all(len(side.views) == 1 for side in sides)
    return _Evidence(np.sort(disparity[certain]), step, unchecked)


def _costs(lf: LightField, sides: list[_Side], disparities: Float64Array, factor: int) -> list[Float32Array]:
    """How much views differ from the reference, [l, y, x] for horizontal and vertical sides, as far as there are any.

    Mean absolute differences over 3 x 3 pixels and the views of a side, the lesser of both sides; infinite where less
    than half of the samples lie in views and are valid. `disparities` are those of shrunk views.
    """
    views = sorted({lf.reference_index, *(view for side in sides for view in side.views)})
    details, valid = _details(lf, views, factor)
    at = {view: place for place, view in enumerate(views)}
    image, known = details[at[lf.reference_index]], valid[at[lf.reference_index]]
    directions = sorted({side.horizontal for side in sides})
    costs = [np.full((len(disparities), *image.shape), np.inf, np.float32) for _ in directions]

    def compare(label: int) -> None:
        for side in sides:
            total, count = (np.zeros(image.shape, np.float32) for _ in range(2))
            for view in side.views:
                shift = -disparities[label] * lf.offsets[view]
                window, seen = _shifted(details[at[view]], shift)
                if seen.size == 0:
                    continue
                difference = np.abs(seen - image[window])
                if lf.valid is not None:
                    both = known[window] * (_shifted(valid[at[view]], shift)[1] > 1 - 1e-3)
                    difference *= both
                    count[window] += both
                else:
                    count[window] += 1
                total[window] += difference
            total, count = _boxed(total), _boxed(count)
            cost = np.where(count >= 4.5 * len(side.views), total / np.maximum(count, 1), np.inf)
            best = costs[directions.index(side.horizontal)][label]
            np.minimum(best, cost, out=best)

    in_threads(compare, range(len(disparities)))
    return costs


def _details(lf: LightField, views: list[int], factor: int) -> tuple[Float32Array, Float32Array]:
    """Views [n, y, x] in grey, shrunk, less the mean around each pixel; and 1 where all of a pixel is valid, else 0."""
    height, width, channels = lf.size[0] // factor, lf.size[1] // factor, lf.channels
    details = np.empty((len(views), height, width), np.float32)
    valid = np.ones(details.shape, np.float32)

    def shrink(place: int, view: NDArray[np.generic]) -> None:
        blocks = view[: height * factor].reshape(height, factor, -1, channels)
        rows = np.add.reduce(blocks, axis=1, dtype=np.float32)[:, : width * factor]
        grey = rows.reshape(height, width, factor * channels).sum(2) * np.float32(lf.scale / (factor**2 * channels))
        if lf.valid is not None:
            blocks = lf.valid[views[place], : height * factor, : width * factor]
            valid[place] = blocks.reshape(height, factor, width, factor).all((1, 3))
            grey *= valid[place]
        share = uniform_filter(valid[place], _DETAIL, mode="nearest") if lf.valid is not None else np.float32(1)
        details[place] = grey - uniform_filter(grey, _DETAIL, mode="nearest") / np.maximum(share, 1e-3)

    each_view(lf.views, views, shrink)
    return details, valid


def _shifted(view: Float32Array, shift: Float64Array) -> tuple[tuple[slice, slice], Float32Array]:
    """What a view shows at positions plus `shift` (x, y), linearly interpolated: where it is inside, and the values."""
    (ix, fx), (iy, fy) = ((math.floor(s), np.float32(s - math.floor(s))) for s in shift)
    height, width = view.shape
    rows = slice(min(height, max(0, -iy)), max(0, min(height, height - iy - bool(fy))))
    columns = slice(min(width, max(0, -ix)), max(0, min(width, width - ix - bool(fx))))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return (slice(0), slice(0)), view[:0, :0]

    top, bottom, left, right = rows.start + iy, rows.stop + iy, columns.start + ix, columns.stop + ix

    def at(row: int, column: int) -> Float32Array:
        return view[top + row : bottom + row, left + column : right + column]

    def along(row: int) -> Float32Array:
        return (1 - fx) * at(row, 0) + fx * at(row, 1) if fx else at(row, 0)

    return (rows, columns), (1 - fy) * along(0) + fy * along(1) if fy else along(0)


def _boxed(values: Float32Array) -> Float32Array:
    """Sums over 3 x 3 pixels, [y, x]."""
    columns = values.copy()
    columns[:, 1:] += values[:, :-1]
    columns[:, :-1] += values[:, 1:]
    sums = columns.copy()
    sums[1:] += columns[:-1]
    sums[:-1] += columns[1:]
    return sums


def _distinct(lines: list[Float32Array], apart: int) -> tuple[Float32Array, NDArray[np.bool_]]:
    """The disparity [y, x] at which views look most alike, in steps from the first, and whether it is the only one.

    It is if views differ by the noise at most, along each line, and by clearly more at all disparities that are more
    than `apart` steps away. The noise is the median difference at the better textured half of the pixels.
    """
    costs: Float32Array = np.minimum(lines[0], 1)
    for line in lines[1:]:
        costs = costs + np.minimum(line, 1)
    costs /= len(lines)
    count, best = len(costs), costs.argmin(0)

    def at(values: Float32Array, label: NDArray[np.intp]) -> Float32Array:
        return np.take_along_axis(values, np.clip(label, 0, count - 1)[None], axis=0)[0]

    least = at(costs, best)
    before, after = best - apart - 1, best + apart + 1
    nearer = np.where(after < count, at(np.minimum.accumulate(costs[::-1], axis=0)[::-1], after), np.inf)
    farther = np.where(before >= 0, at(np.minimum.accumulate(costs, axis=0), before), np.inf)
    spread = costs.max(0) - least
    noise = max(float(np.median(least[spread >= np.median(spread)])), _LEAST_NOISE)
    certain = (best > 0) & (best < count - 1) & (np.minimum(nearer, farther) - least >= _OTHER * noise)
    for line in lines:
        certain &= at(line, best) <= _SAME * noise
    left, right = at(costs, best - 1), at(costs, best + 1)
    bend = left - 2 * least + right
    offset = np.clip((left - right) / (2 * np.where(bend > 1e-9, bend, np.inf)), -1, 1)
    return (best + offset).astype(np.float32), certain


def _agreeing(disparity: Float32Array, certain: NDArray[np.bool_], tolerance: float) -> NDArray[np.intp]:
    """How many of the eight neighbours of each pixel are certain and have its disparity, [y, x]."""
    height, width = disparity.shape
    padded = np.pad(np.where(certain, disparity, np.inf), 1, constant_values=np.inf)
    places = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
    near = [np.abs(padded[dy : dy + height, dx : dx + width] - disparity) <= tolerance for dy, dx in places]
    return np.sum(near, axis=0)
