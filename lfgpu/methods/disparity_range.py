"""The range of disparities in a scene, found from the views alone by matching them at low resolution.

A pixel is evidence for a disparity if three things hold: the views to one side of the reference look alike there
(horizontally and vertically, where there are views of both), they look alike at no other disparity, and most
neighbours have the same disparity. The evidence is the mean disparity over these neighbours. Evidence of a coarser
comparison counts where a finer comparison has none. The range goes from the lowest to the highest evidence, with a
margin: pixels without texture do not count.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Array, Device, Float32Array, Float64Array
from lfgpu.data.layout import ViewLayout, farthest
from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import forget
from lfgpu.errors import LightFieldError
from lfgpu.methods.measured import Typical, exposure_of

_SIDE = 170  # about as many pixels has the shorter side of the shrunk views
_WINDOW = 250  # pixels along each side, of views that show nothing reduced: so many are not reduced
_COARSEST = 24  # pixels, the least that it has
_COARSER = 2  # times that they may be shrunk to half of that
_FARTHEST = 64.0  # pixels between neighbouring views, what is searched,
_SHIFT = 0.4  # but no more than this share of the shorter side
_STEP = 0.5  # distance of the disparities that are compared, shrunk pixels in the farthest view
_MOST = 200  # disparities that are compared
_VIEWS = 3  # that are compared on each side of the reference
_DETAIL = 31  # shrunk pixels, window of the mean that is taken off: cameras may differ in brightness
_SAME = 4.0  # times the noise: views that differ by less look alike
_OTHER = 1.6  # times the noise: what other disparities must be worse by
_APART = 2.0  # shrunk pixels in the farthest view: what differs by more is another disparity
_AGREEING = 5  # of the eight neighbours
_LEAST_NOISE = 0.002  # intensity beside the exposure: half a step of 8 bits
_OUTLIERS = 5  # pixels left out at either end,
_UNCHECKED = 500  # or one in so many, where no other view confirms what a pair of views says
_MARGIN, _MORE = 0.25, 0.05  # at either end: pixels in the farthest view, and a share of the range that was found
_TRIES = 3  # to widen a range at whose end there is evidence
_AT_ONCE = 2**26  # bytes of views that a device holds at a time


@dataclass(frozen=True, eq=False)
class _Compared:
    """The reference and some views to each side of it."""

    views: list[int]  # in order
    reference: int  # its place among them
    offsets: Float64Array  # [n, 2], view steps
    lines: tuple[tuple[tuple[int, ...], ...], ...]
    """The places of the views to each side, of each line."""

    @property
    def farthest(self) -> float:
        """The largest distance of a view from the reference view, along u or v, in view steps."""
        return farthest(self.offsets)

    @property
    def is_unchecked(self) -> bool:
        """True if each side is a single view, and none stands opposite."""
        return all(len(line) == 1 and len(line[0]) == 1 for line in self.lines)


class _Lines:
    """The views in a horizontal and in a vertical line through the reference, by side."""

    def __init__(self, layout: ViewLayout) -> None:
        self._layout, self._kept = layout, dict[tuple[int, ...], _Compared]()
        line = layout.pattern("cross")
        if line.sum() < 2:
            line = layout.pattern("full")
        self._sides: list[tuple[bool, NDArray[np.intp], list[float]]] = []  # views and distances, the nearest first
        for horizontal in (False, True):
            along, across = layout.offsets.T if horizontal else layout.offsets.T[::-1]
            beside = np.flatnonzero(line & (np.abs(along) >= np.abs(across)) & (np.abs(along) > 0))
            beside = beside[np.argsort(np.abs(along[beside]), kind="stable")]
            for some in (beside[along[beside] < 0], beside[along[beside] > 0]):
                if len(some):
                    self._sides.append((horizontal, some, np.abs(along[some]).tolist()))
        of_lines = [[distances[0] for is_, _, distances in self._sides if is_ == line] for line in (False, True)]
        self.nearest = max(min(distances) for distances in of_lines if distances)
        """The distance of the nearest views, horizontally or vertically, whichever is larger; view steps."""

    def within(self, reach: float) -> _Compared:
        """Choose `_VIEWS` views within reach from each side, evenly, or its nearest one."""
        counts = tuple(max(1, bisect_right(distances, 1.001 * reach)) for _, _, distances in self._sides)
        if counts not in self._kept:
            self._kept[counts] = self._chosen(counts)
        return self._kept[counts]

    def _chosen(self, counts: tuple[int, ...]) -> _Compared:
        sides: dict[bool, list[list[int]]] = {}
        for (horizontal, beside, _), count in zip(self._sides, counts, strict=True):
            chosen = np.unique(np.ceil(np.linspace(0, count, _VIEWS + 1)[1:]).astype(int) - 1)
            sides.setdefault(horizontal, []).append(beside[chosen].tolist())
        reference = self._layout.reference
        views = sorted({reference, *(view for line in sides.values() for side in line for view in side)})
        lines = tuple(tuple(tuple(map(views.index, side)) for side in line) for line in sides.values())
        return _Compared(views, views.index(reference), self._layout.offsets[views], lines)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Evidence that one comparison found."""

    disparity: Any  # [y, x], NaN where a pixel is no evidence; on the device first
    step: float  # distance of the disparities that were compared
    is_unchecked: bool  # `_Compared.is_unchecked`


def find_disparity_range(
    lf: LightField, device: Device, *, views: Array | None = None, held: Sequence[int] | None = None
) -> tuple[float, float]:
    """Find the range (low, high) of disparities in the scene, pixels per view step, a small margin included.

    The nearest views are compared first, at up to 64 px between them (at most 0.4 of the views' shorter side), then
    farther ones in the range that this left. Views in the reference's row and column are compared; all, where it is
    alone in both. All comparisons are made on views whose shorter side is shrunk to about 170 px. The host waits for
    the device once for each of two to ten comparisons. `views` are those of `lf`, of the indices `held`, that are on
    the device already. LightFieldError if no pixel is evidence for any disparity.
    """
    shown = None if views is None else (views, range(len(lf.views)) if held is None else held)
    try:
        return _found(lf, device, shown)
    except LightFieldError:
        if max(lf.size) <= _WINDOW:
            raise
        # Reduced views show nothing of textures that are finer than their pixels: the middle as it is.
        (height, width), half = lf.size, _WINDOW // 2
        rows, columns = (slice(max(0, side // 2 - half), side // 2 + half) for side in (height, width))
        return _found(lf.crop(rows, columns), device, None)


def _found(lf: LightField, device: Device, shown: tuple[Array, Sequence[int]] | None) -> tuple[float, float]:
    """Find the range, see `find_disparity_range`; views may be reduced to a `_SIDE`-th of their shorter side."""
    shorter, far = min(lf.size), lf.layout.farthest
    lines = device.kept("lines", lf.offsets.tobytes(), lambda: _Lines(lf.layout))
    nearest, most = lines.nearest, _largest(lines, lf.size)
    fine = max(1, round(shorter / _SIDE))
    sizes = [1, *(2**k for k in range(1, _COARSER + 1) if shorter // (2**k * fine) >= _COARSEST)]
    search = _Search(lf, device, shown, fine)
    with device.asking():
        found = search.compare(lines.within(nearest), (-most, most), sizes[:2][-1:])
        if len(sizes) > 1 and not np.isfinite(found[0].disparity).any():  # finer than the pixels of reduced views
            found = search.compare(lines.within(nearest), (-most, most), sizes[:1])
        low, high = _ends(lf, found)
        low, high = low - 2 * found[0].step, high + 2 * found[0].step
        for _ in range(_TRIES):
            reach = max(nearest, min(far, _SHIFT * shorter / max(abs(low), abs(high))))
            # The finest one sees thin things, coarser ones textures that are weaker than the noise.
            found = search.compare(lines.within(reach), (low, high), sizes)
            first, last = _ends(lf, found)
            further, close = (high - low) / 2, 2.5 * max(evidence.step for evidence in found)
            if first >= low + close and last <= high - close:
                break
            low = low - further if first < low + close else low
            high = high + further if last > high - close else high
    margin = _MARGIN / far + _MORE * (last - first)
    return first - margin, last + margin


def largest_disparity(layout: ViewLayout) -> float:
    """Return the largest disparity that is searched, pixels per view step."""
    return _largest(_Lines(layout), layout.size)


def _largest(lines: _Lines, size: tuple[int, int]) -> float:
    return min(_FARTHEST, _SHIFT * min(size)) / lines.nearest


def _ends(lf: LightField, found: list[_Evidence]) -> tuple[float, float]:
    """Find the disparities of the outermost evidence, without a few pixels of each comparison at either end.

    Each comparison but the first is half as fine as the one before; it counts where no finer one found anything.
    """
    kept: list[Float32Array] = []
    finer: Any = None  # bool [y, x], where a finer one found something
    for evidence in found:
        disparity = evidence.disparity
        is_known = np.isfinite(disparity)
        is_evidence = is_known
        if finer is not None:
            height, width = disparity.shape
            finer = finer[: 2 * height : 2, : 2 * width] | finer[1 : 2 * height : 2, : 2 * width]
            finer = finer[:, ::2] | finer[:, 1::2]
            is_evidence = is_known & ~finer
        finer = is_known if finer is None else is_known | finer
        count = int(is_known.sum())
        outer = max(min(count // 100, _OUTLIERS), count // _UNCHECKED if evidence.is_unchecked else 0)
        disparities = disparity[is_evidence]
        ends = [outer, len(disparities) - 1 - outer]
        kept.append(np.partition(disparities, ends)[ends] if ends[0] <= ends[1] else disparities[:0])
    together = np.concatenate(kept)
    if not any(len(one) for one in kept[:_COARSER]):  # the coarsest alone is not believed
        raise LightFieldError(
            f"{lf.name}: the disparity range cannot be found: nowhere do views look alike at one disparity only "
            "(no texture, all masked, unequal brightness, or cameras too far apart); give "
            "disparity_range (--disparity-range on the command line)."
        )
    return float(together.min()), float(together.max())


class _Search:
    """The views of a light field, compared on a device at `factor` times lower resolution, or still lower."""

    def __init__(self, lf: LightField, device: Device, shown: tuple[Array, Sequence[int]] | None, factor: int) -> None:
        self._lf, self._device, self._factor = lf, device, factor
        self._size = tuple(side // factor for side in lf.size)
        self._views: Array | None = None if shown is None else shown[0]
        self._held = [] if shown is None else list(shown[1])

    @cached_property
    def _least_noise(self) -> float:
        """The least noise that views may have, intensity."""
        return _LEAST_NOISE * exposure_of(self._lf)

    def compare(self, compared: _Compared, bounds: tuple[float, float], times: Sequence[int]) -> list[_Evidence]:
        """Compare views with the reference at disparities within bounds.

        Each of `times` is how many times smaller than by `factor` they are then.
        """
        images = self._shrunk(compared.views)
        started = [self._started(images, compared, bounds, more) for more in times]
        read = self._device.kernels.numpy
        return [replace(one, disparity=read(one.disparity).astype(np.float32, copy=False)) for one in started]

    def _started(self, images: Array, compared: _Compared, bounds: tuple[float, float], times: int) -> _Evidence:
        """Start one comparison, which the device may not have finished."""
        factor, views = times * self._factor, len(compared.views)
        far = compared.farthest
        step = max(_STEP * factor / far, (bounds[1] - bounds[0]) / (_MOST - 1))
        count = max(3, math.ceil((bounds[1] - bounds[0]) / step) + 1)
        size = (views, *self._size)
        compare = self._device.kept(
            ("comparison", views, times), (size,), lambda: _Comparison(self._device, size, times=times)
        )
        costs = self._device.kept(
            ("costs", views, times),
            (size, compared, factor, count),
            lambda: _Costs(self._device, compare.shape, compared, factor, count=count),
        )
        least_noise = self._least_noise
        apart = max(1, round(_APART * factor / far / step))
        disparity = compare(images, costs, bounds[0], step, apart=apart, least_noise=least_noise)
        return _Evidence(disparity, step, compared.is_unchecked)

    def _shrunk(self, chosen: list[int]) -> Array:
        """Some views in grey, shrunk by the least factor; those that take much memory one after the other."""
        lf, device, kernels = self._lf, self._device, self._device.kernels
        are_there = set(chosen) <= set(self._held)
        at_once = len(chosen) if are_there else max(1, _AT_ONCE // lf.views[0].nbytes)
        parts = []
        for begin in range(0, len(chosen), at_once):
            some = chosen[begin : begin + at_once]
            if are_there:
                views, places = self._views, [self._held.index(view) for view in some]
            else:
                views, places = device.image(lf.views[some]), list(range(len(some)))
                forget(lf.views)
            valid = None if lf.valid is None else device.field(lf.valid[some])
            shape = len(some), *self._size
            images = device.kept(("shrunk", begin, shape), None, partial(device.zeros, shape))
            kernels.shrink(views, places, valid, scale=lf.scale, factor=self._factor, images_out=images)
            parts.append(images)
        if len(parts) == 1:
            return parts[0]
        return device.field(np.concatenate([kernels.numpy(part) for part in parts]))


class _Costs:
    """Costs of images [n, y, x] at a number of disparities, with their plan and their memory."""

    def __init__(
        self,
        device: Device,
        shape: tuple[int, ...],
        compared: _Compared,
        factor: int,
        *,
        count: int,
    ) -> None:
        offsets, lines, reference = compared.offsets / factor, compared.lines, compared.reference
        self._find = device.kernels.side_costs(shape, offsets, lines, device.name, reference=reference, count=count)
        self._volume = device.zeros((len(lines), count, *shape[1:]))

    def __call__(self, details: Array, first: float, step: float) -> Array:
        self._find(details, first, step, self._volume)
        return self._volume


class _Comparison:
    """A comparison of images [n, y, x], with all that does not depend on the number of disparities.

    Views differ at pixels that are evidence by the noise at most, along each line, and by clearly more at all other
    disparities. The noise is the median difference at the better textured half of the pixels.
    """

    def __init__(self, device: Device, shape: tuple[int, ...], *, times: int) -> None:
        self.shape = shape[0], shape[1] // times, shape[2] // times
        self._kernels = device.kernels
        self._reduce = self._kernels.details(shape, device.name, factor=times, window=_DETAIL)
        self._details = device.zeros(self.shape)
        *self._found, self._disparity = (device.zeros(self.shape[1:]) for _ in range(6))
        self._noise = Typical(device)

    def __call__(
        self, images: Array, costs: _Costs, first: float, step: float, *, apart: int, least_noise: float
    ) -> Array:
        """Compare at the disparities from `first` on; return those of the pixels that are evidence, NaN elsewhere."""
        self._reduce(images, self._details)
        self._kernels.distinct_minimum(costs(self._details, first, step), apart=apart, found_out=self._found)
        self._kernels.agreeing_disparity(
            self._found,
            self._noise(self._found[1], self._found[2]),
            least_noise=least_noise,
            same=_SAME,
            other=_OTHER,
            neighbors=_AGREEING,
            first=first,
            step=step,
            disparity_out=self._disparity,
        )
        return self._disparity
