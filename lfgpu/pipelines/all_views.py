"""`estimate_all_views`: consistent disparity maps of all views of a light field.

A few key views, far apart from each other, are estimated. Their maps are warped into every other view with a z-buffer.
Where the warped maps disagree, the key views vote. Where they agree, they are averaged at sub-pixel precision. This
takes less time than to estimate every view, and the maps are consistent.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from numbers import Integral
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.config import Config
from lfgpu.contract import Device, Float32Array, Float64Array
from lfgpu.data import DepthResult, DisparityMap, LightField, ViewsResult, check_light_field
from lfgpu.errors import LightFieldError
from lfgpu.methods import PresetName, configured, method_of
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.pipeline import DepthPipeline, Progress
from lfgpu.pipelines.verdict import verdict_of

_KEYS = 9
_LEAST_VALID = 0.5  # smallest share of valid pixels of a key view
_LANDED = -1e5  # px per view step: `z_buffer` writes a smaller value where nothing lands
_UNKNOWN = 1e6  # px per view step: nearer than everything; if negative, farther than everything that lands
_SEEN_THROUGH = 0.5  # weight of a vote against: beside a depth edge it is wrong more often than a vote for


def estimate_all_views(
    lf: LightField,
    *,
    keys: int = _KEYS,
    config: Config | PresetName | None = None,
    weights: str | os.PathLike[str] | None = None,
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = None,
    deterministic: bool = False,
    check_cameras: bool = True,
    on_progress: Progress | None = None,
) -> ViewsResult:
    """Estimate consistent disparity maps of all views of a light field.

    Parameters
    ----------
    lf
        The light field.
    keys
        Number of key views, >= 1; default 9. The first is the reference view. Each further one is the view that is
        farthest from those before, among the views with at least half of their pixels valid. The time is nearly
        proportional to this number. If it is the number of views or more, all views are key views.
    config, weights, disparity_range, backend, device, deterministic, check_cameras
        As for `estimate_depth`. Range and noise are measured once, on the reference view, and the cameras are looked at
        with its map. Disparities that differ by up to `Method.same_surface` belong to the same surface.
    on_progress
        Called as on_progress(stage, iteration, value): with iteration 0 and value 0 when a stage begins, and after each
        view. The stage "keys" estimates the key views, "join" makes the maps of all views. The value is the share that
        is done. Default None.

    Raises
    ------
    LightFieldError
        As `estimate_depth`; if `keys` is not an integer >= 1; or if a view shows nothing that a key view shows.
    BackendError
        As `estimate_depth`.

    Examples
    --------
    >>> lfgpu.estimate_all_views(lf, config="fast", keys=2).disparities.shape
    (25, 64, 80)
    """
    check_light_field(lf)
    if isinstance(keys, bool) or not isinstance(keys, Integral) or keys < 1:
        raise LightFieldError(f"keys must be an integer >= 1; found {keys!r}.")
    report, config = on_progress or (lambda stage, iteration, value: None), configured(config, weights)
    usable = None if lf.valid is None else lf.valid.mean((1, 2)) >= _LEAST_VALID
    chosen = spread_out(lf.positions, lf.reference_index, int(keys), usable)
    start = perf_counter()

    report("keys", 0, 0.0)
    estimates: list[DepthResult] = []
    measured: Measured | None = None  # range and noise are those of the first key view
    for index in chosen:
        pipeline = DepthPipeline(
            lf.with_reference(index),
            config=config,
            disparity_range=disparity_range,
            backend=backend,
            device=device,
            deterministic=deterministic,
            measured=measured,
        )
        estimates.append(pipeline.estimate())
        measured = pipeline.measured  # the first estimate may have widened the range
        report("keys", len(estimates), len(estimates) / len(chosen))
    place = open_device(backend, device)
    verdict = verdict_of(lf, estimates[0], place, disparity_range=disparity_range, check_cameras=check_cameras)
    estimates = [verdict.on(lf.with_reference(n), one) for n, one in zip(chosen, estimates, strict=True)]
    estimated = perf_counter()

    report("join", 0, 0.0)
    join = Join(
        estimates,
        None if lf.valid is None else lf.valid[chosen],
        place,
        tolerance=method_of(config).same_surface(lf.layout),
    )
    disparities, confidences = (np.empty(lf.views.shape[:3], np.float32) for _ in range(2))
    for index, position in enumerate(lf.positions):
        disparity, confidence = join(position)
        if np.isnan(disparity).all():
            u, v = position
            raise LightFieldError(
                f"{lf.name}: view {index} (row {v:g}, column {u:g}) shows nothing that one of the {len(chosen)} key "
                "views shows; use more key views."
            )
        disparities[index], confidences[index] = disparity, confidence
        report("join", index + 1, (index + 1) / len(lf.positions))
    end = perf_counter()
    return ViewsResult(
        disparities,
        confidences,
        lf.positions,
        tuple(chosen),
        estimates[0],
        {"keys": estimated - start, "join": end - estimated, "total": end - start},
    )


def spread_out(positions: Float64Array, first: int, count: int, usable: NDArray[np.bool_] | None = None) -> list[int]:
    """Indices of up to `count` positions that are far apart.

    The first is `first`. Each further one is the position [n, 2] that is farthest from all before, among those that are
    `usable` [n] (None: all).
    """
    chosen = [first]
    distance = np.full(len(positions), np.inf) if usable is None else np.where(usable, np.inf, 0.0)
    while len(chosen) < count:
        distance = np.minimum(distance, np.hypot(*(positions - positions[chosen[-1]]).T))
        if distance.max() == 0:
            break
        chosen.append(int(np.argmax(distance)))
    return chosen


class Join:
    """Join of the maps of the key views, masked by `valid` [k, y, x], to the map of any view.

    Disparities of one surface differ by at most the `tolerance`. The device warps maps into other views; the rest runs
    on the host.
    """

    def __init__(
        self,
        estimates: Sequence[DepthResult | DisparityMap],
        valid: NDArray[np.bool_] | None,
        device: Device,
        *,
        tolerance: float,
    ) -> None:
        self._device = device
        self._tolerance, self._size = tolerance, estimates[0].disparity.shape
        self._positions = [np.asarray(estimate.position) for estimate in estimates]
        self._confidences = [
            np.ones(self._size, np.float32) if estimate.confidence is None else estimate.confidence
            for estimate in estimates
        ]
        maps = np.stack([estimate.disparity for estimate in estimates])
        known = np.isfinite(maps) if valid is None else np.isfinite(maps) & valid
        # Masked pixels land nowhere and do not vote.
        self._landing = [device.field(values) for values in np.where(known, maps, np.float32(-_UNKNOWN))]
        self._maps = np.where(known, maps, np.float32(_UNKNOWN))
        self._landed = device.zeros((1, *self._size))
        self._carry = device.kernels.z_buffer(self._size, device.name, reach=0)

    def __call__(self, position: Float64Array) -> tuple[Float32Array, Float32Array]:
        """Disparity and confidence [y, x] of the view at `position` (u, v); NaN where no key view shows the point."""
        steps = [key - position for key in self._positions]
        disparity = self._most_agreed(steps)
        total, agreeing, opposed, trust = (np.zeros(self._size, np.float32) for _ in range(4))
        y, x = np.mgrid[: self._size[0], : self._size[1]].astype(np.float32)
        for values, confidence, (du, dv) in zip(self._maps, self._confidences, steps, strict=True):
            place = _Place(x - disparity * np.float32(du), y - disparity * np.float32(dv), self._size)
            seen = place.bilinear(values)
            agrees = place.inside & (np.abs(seen - disparity) <= self._tolerance)
            total += np.where(agrees, seen, 0)
            agreeing += agrees
            opposed += place.inside & (seen < disparity - self._tolerance)
            trust += np.where(agrees, place.nearest(confidence), 0)
        mean = np.where(agreeing > 0, total / np.maximum(agreeing, 1), np.nan)
        return mean.astype(np.float32), trust / np.maximum(agreeing + opposed, 1)

    def _most_agreed(self, steps: Sequence[Float64Array]) -> Float32Array:
        """Find the disparity at each pixel that wins the vote among those that land there; 0 if nothing lands.

        A key view votes for a disparity if its own map agrees at the corresponding point. It votes against if its map
        is farther there, because then it sees through the assumed surface. It abstains if its map is nearer, because
        then the point may be hidden. In a tie the farther disparity wins.
        """
        landed = np.sort(np.stack([self._carried(n, step) for n, step in enumerate(steps)]), axis=0)
        nothing = landed < _LANDED
        highest, lowest = landed[-1], np.where(nothing, np.inf, landed).min(0)
        best = np.where(nothing.all(0), 0, lowest).astype(np.float32)
        y, x = np.nonzero(highest - lowest > self._tolerance)
        candidates = landed[:, y, x]
        votes = np.full(candidates.shape, -np.inf, np.float32)
        for candidate, vote in zip(candidates, votes, strict=True):
            there = np.flatnonzero(candidate >= _LANDED)
            vote[there] = self._vote(steps, x[there], y[there], candidate[there])
        best[y, x] = np.take_along_axis(candidates, votes.argmax(0)[None], 0)[0]
        return best

    def _vote(
        self, steps: Sequence[Float64Array], x: NDArray[np.intp], y: NDArray[np.intp], disparity: Float32Array
    ) -> Float32Array:
        votes = np.zeros(disparity.shape, np.float32)
        for values, (du, dv) in zip(self._maps, steps, strict=True):
            place = _Place(x - disparity * np.float32(du), y - disparity * np.float32(dv), self._size)
            nearer = place.nearest(values) - disparity
            agrees, sees_through = np.abs(nearer) <= self._tolerance, nearer < -self._tolerance
            votes += place.inside * (agrees - np.float32(_SEEN_THROUGH) * sees_through)
        return votes

    def _carried(self, key: int, step: Float64Array) -> Float32Array:
        """Warp the map [y, x] of a key view into a view `-step` away from it; < _LANDED where nothing lands."""
        offset = self._device.field(-step[None])
        self._carry(self._landing[key], offset, self._landed, reach=0)
        return self._device.kernels.numpy(self._landed)[0].astype(np.float32)


class _Place:
    """Sample positions (x, y) in a map of one size; positions outside are moved to its border."""

    def __init__(self, x: Float32Array, y: Float32Array, size: tuple[int, ...]) -> None:
        bottom, right = size[0] - 1, size[1] - 1
        self.inside = (x >= 0) & (x <= right) & (y >= 0) & (y <= bottom)
        self._x, self._y, self._right, self._bottom = np.clip(x, 0, right), np.clip(y, 0, bottom), right, bottom

    def nearest(self, values: Float32Array) -> Float32Array:
        return values[(self._y + 0.5).astype(np.intp), (self._x + 0.5).astype(np.intp)]

    def bilinear(self, values: Float32Array) -> Float32Array:
        left, top = self._x.astype(np.intp), self._y.astype(np.intp)
        across, down = self._x - left, self._y - top
        right, below = np.minimum(left + 1, self._right), np.minimum(top + 1, self._bottom)
        upper = (1 - across) * values[top, left] + across * values[top, right]
        lower = (1 - across) * values[below, left] + across * values[below, right]
        return np.asarray((1 - down) * upper + down * lower, np.float32)
