"""A disparity map for every view of a light field, all of one scene: what one says, the others confirm.

A few key views are estimated, spread as far apart as can be. Their maps are carried into each other view, where what is
nearest lands on top; where they tell different things, they vote; and what agrees is averaged at sub-pixel precision.
Estimating every view on its own would cost more, and its maps would differ by as much as each is wrong.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Integral
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, load, pick_device
from lfgpu.config import Config
from lfgpu.depth import DepthPipeline, Progress
from lfgpu.errors import LightFieldError
from lfgpu.geometry import Geometry
from lfgpu.lightfield import LightField
from lfgpu.matching import farthest, measured_noise
from lfgpu.result import DepthResult, DisparityMap
from lfgpu.types import Float32Array, Float64Array, KernelSet

_KEYS = 9
_LEAST_VALID = 0.5  # share of a view's pixels, for it to become a key
_LANDED = -1e5  # px per view step: `nearest_surface` writes less where nothing lands
_UNKNOWN = 1e6  # px per view step: so near that it hides everything, farther away than all that lands if negative
_SAME_PLACE = 1e-6  # view steps
_SEEN_THROUGH = 0.5  # of a vote: beside an edge a key that sees through is wrong more often than one that agrees


@dataclass(frozen=True, eq=False)
class ViewsResult:
    """Disparity maps of all views of a light field.

    Parameters
    ----------
    disparities
        float32 [n, y, x] in the order of `LightField.views`, pixels per view step, larger is nearer: the point at
        (x, y) of view a is at (x - d*du, y - d*dv) in the view du steps to the right of and dv steps below view a.
    confidences
        float32 [n, y, x], 0 to 1: the mean confidence of the key views that agree, times their share among those that
        agree or see through. 0 means that no key view shows the pixel and it was filled from the farther side.
    positions
        float64 [n, 2], (u, v) of each view, as `LightField.positions`.
    keys
        Indices of the views that were estimated themselves; the first is the reference.
    reference
        The estimate of the reference view by itself, as from `estimate_depth`: with its stages, status and parameters.
        Its map is what went into `disparities`, before the other key views had their say.
    timings
        Seconds: `keys` for estimating them, `join` for all views' maps from theirs, `total`.
    """

    disparities: Float32Array
    confidences: Float32Array
    positions: NDArray[np.float64]
    keys: tuple[int, ...]
    reference: DepthResult
    timings: dict[str, float]

    def index_of(self, row: float, column: float) -> int:
        """Index of the view at position v = `row`, u = `column`; LightFieldError if there is none."""
        distance = np.abs(self.positions - (column, row)).max(1)
        if not distance.min() < _SAME_PLACE:
            raise LightFieldError(f"there is no map of a view at row {row:g}, column {column:g}.")
        return int(np.argmin(distance))

    def map(self, index: int) -> DisparityMap:
        """The map of view `index` by itself, with what it takes to read it right."""
        u, v = (float(value) for value in self.positions[index])
        about = self.reference
        return DisparityMap(
            self.disparities[index],
            self.confidences[index],
            position=(u, v),
            geometry=about.geometry,
            name=about.name,
            versions=about.versions,
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all maps as .npz; see `lfgpu.save`."""
        from lfgpu.io import save

        save(self, path)

    @property
    def geometry(self) -> Geometry | None:
        """What turns disparity into metres, the same for all views; None if unknown."""
        return self.reference.geometry

    @property
    def depths(self) -> NDArray[np.float32] | None:
        """Metric depth in metres, float32 [n, y, x], infinity beyond the horizon; None without a geometry."""
        return None if self.geometry is None else self.geometry.depth(self.disparities).astype(np.float32)


def estimate_all_views(
    lf: LightField,
    *,
    keys: int = _KEYS,
    config: Config | str = "accurate",
    disparity_range: tuple[float, float] | None = None,
    backend: str = DEFAULT,
    device: str | None = None,
    deterministic: bool = False,
    on_progress: Progress | None = None,
) -> ViewsResult:
    """Estimate the disparity of every view of a light field, consistent with each other.

    Parameters
    ----------
    lf
        The light field.
    keys
        How many views are estimated, >= 1, 9 by default: the reference, and then each time the view that is farthest
        from those before, if at least half of its pixels are valid. Time is nearly in proportion to them; from as many
        as there are views on, all are.
    config, disparity_range, backend, device, deterministic
        As for `estimate_depth`. The range and the noise are found once, from the reference view. Disparities that
        differ by up to `alignment.support`, in the farthest view, count as the same surface.
    on_progress
        Called as on_progress(stage, iteration, value): with iteration 0 and value 0 when a stage begins, and after each
        view: `keys` estimates key views, `join` makes the maps of all views, and value is the share that is done.

    Raises
    ------
    LightFieldError
        As `estimate_depth`; if `keys` is no whole number >= 1; or if a view shows nothing that a key view shows.
    BackendError
        As `estimate_depth`.
    """
    if isinstance(keys, bool) or not isinstance(keys, Integral) or keys < 1:
        raise LightFieldError(f"keys must be a whole number >= 1, found {keys!r}.")
    report = on_progress or (lambda stage, iteration, value: None)
    usable = None if lf.valid is None else lf.valid.mean((1, 2)) >= _LEAST_VALID
    chosen = spread_out(lf.positions, lf.reference_index, int(keys), usable)
    start = perf_counter()

    report("keys", 0, 0.0)
    estimates: list[DepthResult] = []
    for pipeline in _pipelines(lf, chosen, config, disparity_range, backend, device, deterministic):
        estimates.append(pipeline.estimate())
        report("keys", len(estimates), len(estimates) / len(chosen))
    estimated = perf_counter()

    report("join", 0, 0.0)
    kernels = load(backend)
    join = Join(
        estimates,
        None if lf.valid is None else lf.valid[chosen],
        kernels,
        pick_device(kernels, device),
        tolerance=estimates[0].config.alignment.support / farthest(lf.offsets),
    )
    disparities, confidences = (np.empty(lf.views.shape[:3], np.float32) for _ in range(2))
    for index, position in enumerate(lf.positions):
        disparity, confidence = join(position)
        if np.isnan(disparity).all():
            u, v = position
            raise LightFieldError(
                f"{lf.name}: view {index} (row {v:g}, column {u:g}) shows nothing that one of the {len(chosen)} key "
                "views shows; take more keys."
            )
        disparities[index], confidences[index] = filled_from_behind(disparity), confidence
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
    """Indices of up to `count` of the positions [n, 2]: `first`, then each time the one farthest from all before.

    Only those that are `usable` [n] (None: all) come after the first.
    """
    chosen = [first]
    distance = np.full(len(positions), np.inf) if usable is None else np.where(usable, np.inf, 0.0)
    while len(chosen) < count:
        distance = np.minimum(distance, np.hypot(*(positions - positions[chosen[-1]]).T))
        if distance.max() == 0:
            break
        chosen.append(int(np.argmax(distance)))
    return chosen


def filled_from_behind(disparity: Float32Array) -> Float32Array:
    """[y, x] with each NaN replaced: of the next values to the left, right, above and below by the farthest.

    What is behind is hidden by what is before, not the other way round. NaN that have no value in their row and column
    take it from such neighbours.
    """
    values = np.where(np.isnan(disparity), np.inf, disparity)
    while np.isinf(values).any():
        sides = [_next_value(np.rot90(values, turns)) for turns in range(4)]
        farthest = np.min([np.rot90(side, -turns) for turns, side in enumerate(sides)], axis=0)
        values = np.where(np.isinf(values), farthest, values)
    return values.astype(np.float32)


def _next_value(values: Float32Array) -> Float32Array:
    """Each infinity replaced by the next value to the left, where there is one."""
    columns = np.where(np.isinf(values), 0, np.arange(values.shape[1]))
    return np.take_along_axis(values, np.maximum.accumulate(columns, axis=1), axis=1)


def _pipelines(
    lf: LightField,
    chosen: Sequence[int],
    config: Config | str,
    disparity_range: tuple[float, float] | None,
    backend: str,
    device: str | None,
    deterministic: bool,
) -> Iterator[DepthPipeline]:
    """One for each view, made when it is its turn; range and noise are those of the first."""
    for index in chosen:
        pipeline = DepthPipeline(
            lf.with_reference(index),
            config=config,
            disparity_range=disparity_range,
            backend=backend,
            device=device,
            deterministic=deterministic,
        )
        yield pipeline
        if index == chosen[0]:
            disparity_range, config = pipeline.bounds, pipeline.config
            if config.method.name == "matching" and config.sweep.noise == 0:
                noise = measured_noise(lf, disparity_range, config.sweep, pipeline.kernels, pipeline.device)
                config = config.with_values({"sweep.noise": noise})


class Join:
    """What the maps of the key views say together about any view.

    Parameters
    ----------
    estimates
        Those of the key views.
    valid
        bool [k, y, x]: where these say something; None is everywhere.
    kernels, device
        Where maps are carried into other views; the rest is done on the host.
    tolerance
        Disparities that differ by more belong to different surfaces, pixels per view step.
    """

    def __init__(
        self,
        estimates: Sequence[DepthResult | DisparityMap],
        valid: NDArray[np.bool_] | None,
        kernels: KernelSet,
        device: str,
        *,
        tolerance: float,
    ) -> None:
        self._kernels, self._device = kernels, device
        self._tolerance, self._size = tolerance, estimates[0].disparity.shape
        self._positions = [np.asarray(estimate.position) for estimate in estimates]
        self._confidences = [
            np.ones(self._size, np.float32) if estimate.confidence is None else estimate.confidence
            for estimate in estimates
        ]
        maps = np.stack([estimate.disparity for estimate in estimates])
        known = np.ones(maps.shape, np.bool_) if valid is None else valid
        # What is not known lands nowhere, and has no voice where it is looked at.
        self._landing = [kernels.field(values, device) for values in np.where(known, maps, np.float32(-_UNKNOWN))]
        self._maps = np.where(known, maps, np.float32(_UNKNOWN))
        self._landed = kernels.zeros((1, *self._size), device)

    def __call__(self, position: Float64Array) -> tuple[Float32Array, Float32Array]:
        """Disparity, NaN where no key view shows what is there, and confidence of the view at `position`; [y, x]."""
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
        """Of what lands on each pixel from the key views, that for which most of them are; 0 where nothing lands, so
        that the keys say whether that is true.

        A key is for a disparity if it has the same one where that points to, and against it if it sees through: only
        there, as what is nearer in the key may hide the pixel. The farther one wins a tie.
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
        """The map of a key view in the view from which it is `step` away, [y, x]; below _LANDED where nothing lands."""
        offset = self._kernels.field(-step[None], self._device)
        carry = self._kernels.nearest_surface((1, *self._size, 1), offset, reach=0)
        carry(self._landing[key], self._landed)
        return self._kernels.numpy(self._landed)[0].astype(np.float32)


class _Place:
    """Places (x, y) in a map of that size; those outside are moved to its border."""

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
