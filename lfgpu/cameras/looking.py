"""Looks at the cameras of a light field: one entry, with a budget from some hundred points to all that views tell.

Points with texture are looked up in all views; photometric bundle adjustment (`lfgpu/cameras/bundle.py`) says how each
view is moved, turned, scaled and brightened. Without a map the disparities of the points come from a plane sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras import consensus, signs
from lfgpu.cameras.bundle import Bundle, most_points
from lfgpu.cameras.findings import Cameras, axes, brightness, placement, strangers
from lfgpu.cameras.points import Points, Windows, choose_points, textured
from lfgpu.cameras.screening import worth_a_look
from lfgpu.cameras.surface import LABELS, grey, patches, sweep
from lfgpu.cameras.tones import match_tones
from lfgpu.contract import Device, Float64Array
from lfgpu.data.light_field_checks import array_of_numbers
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import eroded, smoothed
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range

Budget = Literal["screen", "quick", "full"]
"""Effort of a look.

- "screen": for every light field. A screening at some hundred points ends it where nothing can be wrong.
- "quick": for streams, whose axes are known: 2000 points, gains of each colour, no signs.
- "full": 5000 points, gains of each colour and signs.
"""

FEWEST = 50
"""Points with texture: from fewer nothing is said of cameras."""


@dataclass(frozen=True)
class _Effort:
    """Work that a budget pays for: points, Gauss-Newton steps of the cameras, gains by colour, and signs of axes."""

    points: int
    steps: int
    colours: bool
    signs: bool


_EFFORTS: dict[Budget, _Effort] = {
    "screen": _Effort(2000, 3, colours=False, signs=True),
    "quick": _Effort(2000, 3, colours=True, signs=False),
    "full": _Effort(5000, 5, colours=True, signs=True),
}

_SEEN = 25  # views, the least with a map, and the most without one
_VIEWS, _PIXELS = 33, 4_000_000  # of the part that a look with a map may be limited to

# Without a map:
_SEEN_PIXELS = 2_000_000  # of all views
_POINTS = 400
_SWEPT = 12  # views that disparities are found from
_LEAST = 100  # points at which views agree
_AGREE = 0.6  # of the contrast: where patches differ by more, the point is hidden or has no disparity in the range


@dataclass(frozen=True, eq=False)
class Look(Cameras):
    """Result of a look at the cameras; `Explanation` describes the fields."""

    points: int
    findings: tuple[str, ...]
    moved: tuple[str, ...]
    signs: signs.Signs | None
    positions: Float64Array
    reference: int

    @property
    def offsets(self) -> Float64Array:
        """[n, 2], positions less that of the reference."""
        return self.positions - self.positions[self.reference]


def look(
    lf: LightField,
    disparity: NDArray[np.float32] | None,
    device: Device,
    *,
    budget: Budget,
    seen: Sequence[int] | NDArray[np.intp] | None = None,
    in_part: bool = False,
    windows: Windows | None = None,
) -> Look | None:
    """Look at the cameras of a light field; None if nothing can be wrong by the screening, or the views do not tell.

    Without a map [y, x] of the reference view the budget is "screen", and the look finds faults of all cameras
    together: out of line, of different brightness, one axis with the wrong sign. With one, it looks at the views
    `seen`, by default all. `in_part` looks at 33 of these and at their middle, 4 million pixels in all: faults of other
    single views stay hidden. Others wait for the device meanwhile. The screening of a whole light field uses its
    `windows` if they have been ranked before.
    """
    if disparity is None:
        return _look_without_map(lf, device)
    if in_part:
        lf, window = part_of(lf, views=_VIEWS, pixels=_PIXELS, among=seen)
        disparity, seen, windows = disparity[window], None, None
    if budget == "screen" and not worth_a_look(lf, disparity, seen, windows):
        return None
    if seen is not None:
        lf = lf.subset(seen)
    effort = _EFFORTS[budget]
    with device.asking():
        most = min(effort.points, most_points(len(lf.views), 6))
        points = choose_points(lf, disparity, device, most=most)
    return _made(lf, points, effort, signs.wrong_signs(lf, disparity, points) if effort.signs else None)


def seen_views(offsets: Float64Array, used: Sequence[int]) -> NDArray[np.intp]:
    """Choose the views that a look sees: those that a map is made from, and if these are few the farthest, 25 or more.

    Of views as far from the reference it chooses all: at the rim of a lens they depart from the others, but not from
    each other. Among the chosen views it chooses all. `offsets` [n, 2] are those of all views.
    """
    others, more = np.setdiff1d(np.arange(len(offsets)), used), _SEEN - len(used)
    if more <= 0 or not len(others):
        return np.sort(np.asarray(used))
    far = np.round(np.hypot(*offsets[others].T), 6)
    return np.union1d(used, others[far >= np.sort(far)[-min(more, len(far))]])  # type: ignore[arg-type]


def _look_without_map(lf: LightField, device: Device) -> Look | None:
    """Look at all cameras together, with disparities from a plane sweep; about a second, whatever the size."""
    part, _ = part_of(lf, views=_SEEN, pixels=_SEEN_PIXELS)
    known = np.ones(part.size, np.bool_) if part.valid is None else part.valid[part.reference_index]
    image = smoothed(grey(part, part.reference_index), 0.7)
    y, x, tile = textured(image, eroded(known, 3), _POINTS)
    if not len(x):
        return None
    try:
        low, high = find_disparity_range(part, device)
    except LightFieldError:
        return None
    others = np.flatnonzero(np.arange(len(part.views)) != part.reference_index)
    swept = np.random.default_rng(0).permutation(others)[:_SWEPT]
    pictures = [grey(part, int(n)) for n in swept]
    shown = patches(grey(part, part.reference_index), x, y)
    cost, disparity = sweep(shown, pictures, part.offsets[swept], x, y, np.linspace(low, high, LABELS))
    points = Points(x.astype(float), y.astype(float), disparity, np.ones((len(part.views), len(x)), np.float32), tile)
    wrong, agree = signs.wrong_axis(part, points, max(abs(low), abs(high))), cost < _AGREE
    if wrong is None and agree.sum() < _LEAST:
        return None
    return _made(part, points.some(agree), _EFFORTS["screen"], wrong, single=False)


def _made(lf: LightField, points: Points, effort: _Effort, wrong: signs.Signs | None, *, single: bool = True) -> Look:
    """Measure the cameras at some points, and say what stands out; of `single` ones only if that is asked for."""
    cameras = measured(lf, points, steps=effort.steps, colours=effort.colours)
    tells = wrong in (None, "uv") and len(points.x) >= FEWEST
    strange = strangers(lf, cameras) if tells and single else ()
    bright = brightness(lf, cameras, single=single) if tells else ()
    wrong = None if strange or bright else wrong  # what hides what means nothing in a map of pictures that do not fit
    moved = (*strange, *placement(lf, cameras, single=single)) if tells and wrong is None else ()
    findings = (*moved, *bright) if wrong is None else (axes(lf, wrong),)
    return Look(
        **vars(cameras),
        points=len(points.x),
        findings=findings,
        moved=moved,
        signs=wrong,
        positions=lf.positions.copy(),
        reference=lf.reference_index,
    )


def part_of(
    lf: LightField, *, views: int, pixels: int, among: Sequence[int] | NDArray[np.intp] | None = None
) -> tuple[LightField, tuple[slice, slice]]:
    """Take some of the views `among` all, and a window in their middle; returns that light field, and rows and columns.

    The reference is among the at most `views` views; the others are drawn, the same in every run, so that a fault that
    many views have is found in them. The window is such that all of them have at most `pixels` pixels.
    """
    others = np.setdiff1d(np.arange(len(lf.views)) if among is None else among, lf.reference_index)
    drawn = np.random.default_rng(0).permutation(others)[: views - 1]
    chosen = [int(n) for n in np.sort(np.append(drawn, lf.reference_index))]
    height, width = lf.size
    share = min(1.0, float(np.sqrt(pixels / (len(chosen) * height * width))))
    rows, columns = (max(1, round(side * share)) for side in lf.size)
    top, left = (height - rows) // 2, (width - columns) // 2
    window = slice(top, top + rows), slice(left, left + columns)
    part = lf if share == 1 else lf.crop(*window)  # first, so that of mapped views little is read
    return (part if len(chosen) == len(lf.views) else part.subset(chosen)), window


def checked_map(lf: LightField, result: Any) -> NDArray[np.float32]:
    """Check a result or map; returns its disparity. LightFieldError if it is of another view, or says nothing."""
    disparity = array_of_numbers("result", getattr(result, "disparity", result), np.float32)
    position = getattr(result, "position", None)
    if disparity.shape != lf.size:
        raise LightFieldError(
            f"the map must be {lf.size[0]} x {lf.size[1]} as the views of {lf.name} are, found shape {disparity.shape}."
        )
    here = lf.positions[lf.reference_index]
    if position is not None and np.abs(here - position).max() > 1e-6:
        raise LightFieldError(
            f"the map belongs to the view at row {position[1]:g}, column {position[0]:g}, the reference of {lf.name} "
            f"is at row {here[1]:g}, column {here[0]:g}; give the light field with that reference."
        )
    if not np.isfinite(disparity).any():
        raise LightFieldError("the map is undefined everywhere; there is nothing to judge.")
    return disparity


def measured(lf: LightField, points: Points, *, steps: int, colours: bool) -> Cameras:
    """Measure all cameras at some points; without `colours` all colours of a view have the tones of grey."""
    count, channels = len(lf.views), lf.channels
    if len(points.x) < FEWEST:
        nothing, pairs, tones = (np.full(shape, np.nan) for shape in (count, (count, 2), (count, channels)))
        own = np.arange(count)
        return Cameras(pairs, pairs, nothing, nothing, nothing, nothing, tones, tones, nothing, nothing, own)
    bundle = Bundle(lf, points)
    bundle.run(steps)
    offsets, radius, influence = lf.offsets, bundle.radius, bundle.influence
    shift = consensus.without_gauge(bundle.warps[:, :2] * radius, offsets)
    moved = consensus.without_gauge(influence[:, :2] * radius, offsets)
    turned, scaled = (consensus.without_slope(bundle.warps[:, k], offsets) for k in (2, 3))
    turned_error, scaled_error = (
        np.sqrt((consensus.without_slope(influence[:, k], offsets) ** 2).sum(1)) for k in (2, 3)
    )
    gain, offset = bundle.tones[:, :1], bundle.tones[:, 1:]
    if colours:
        gain, offset, _ = measured_tones(lf, bundle, vignetting=False)
    level = float(np.clip(np.median(bundle.brightness), 0.02, 1.0))
    bright = (gain + offset / level).mean(axis=1)
    for known in (shift, moved, turned, turned_error, scaled, scaled_error, bright):
        known[consensus.unlike(bundle.misfit, offsets)] = np.nan  # they show something else
    return Cameras(
        shift=shift,
        shift_error=np.sqrt((moved**2).sum(2)),
        rotation=np.rad2deg(turned),
        rotation_error=np.rad2deg(turned_error),
        scale=scaled,
        scale_error=scaled_error,
        gain=gain,
        offset=offset,
        brightness=bright,
        misfit=bundle.misfit,
        place=bundle.places(),
    )


def measured_tones(
    lf: LightField, bundle: Bundle, *, vignetting: bool
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Measure gain, offset and vignetting [n, c] of each view and colour, at the places of the points in a bundle."""
    found = []
    radius2 = bundle.squared_radii()
    for channel in range(lf.channels):
        looks = [bundle.look_up(n, channel) for n in range(len(lf.views))]
        shown, weight = (np.stack(parts) for parts in zip(*looks, strict=True))
        found.append(match_tones(shown, weight, radius2, lf.reference_index, vignetting=vignetting))
    gain, offset, falloff = (np.stack(parts, axis=1) for parts in zip(*found, strict=True))
    return gain, offset, falloff
