"""Estimates in tiles, for light fields that do not fit into memory: overlapping tiles are estimated and joined.

A tile is the same window of every view. Around the part that is kept it has a halo, which covers the pixels that the
estimate reads in other views, the surfaces that may hide them, and the windows of the prior. Noise and disparity range
are those of the whole light field. Small differences from an estimate in one piece remain: paths of the semi-global
matching begin at the edge of the tile, and the solvers of the synthesis end there.
"""

import itertools
import math
import queue
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import alike, open_device
from lfgpu.config import Config
from lfgpu.contract import REDUCTION, Float32Array
from lfgpu.data import DepthResult, LightField
from lfgpu.data.mapping import each_view, forget, is_mapped
from lfgpu.errors import LightFieldError
from lfgpu.methods import method_of
from lfgpu.methods.base import Method
from lfgpu.methods.footprint import Footprint, TooLittleMemoryError
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.pipeline import Progress
from lfgpu.pipelines.range_confirmation import confirm
from lfgpu.pipelines.resident import Resident
from lfgpu.pipelines.verdict import map_notes

_RAMP = 16  # pixels: width of the blend between two tiles
_LEAST_STRIDE = 16  # pixels: smallest distance from a tile to the next


@dataclass(frozen=True)
class Plan:
    """Layout of tiles of one size (height, width): `starts` holds their (top, left), row by row."""

    size: tuple[int, int]
    starts: tuple[tuple[int, int], ...]
    halo: tuple[int, int]
    """Width (y, x) of the border inside a tile that is discarded, pixels; not at edges of the image."""


def plan_tiles(
    size: tuple[int, int], halo: tuple[int, int], needed: Footprint, limit: int, *, taken: int = 0, devices: int = 1
) -> Plan:
    """Find the layout of tiles with a halo (y, x) that takes the least time within a memory limit.

    The time is taken to be proportional to the pixels of the device with the most tiles. LightFieldError if none fits.
    """
    along = [_cuts(length, edge) for length, edge in zip(size, halo, strict=True)]
    plans = [
        (math.ceil(rows * columns / devices) * height * width, rows * columns, (height, width), (rows, columns))
        for (rows, height), (columns, width) in itertools.product(*along)
        if needed.bytes(height, width) + taken <= limit
    ]
    if not plans:
        least = needed.bytes(*(min(length for _, length in cuts) for cuts in along))
        raise LightFieldError(
            f"no tile fits into {_mebibytes(limit)} of memory: {_mebibytes(least + taken)} are needed, of which "
            f"{_mebibytes(needed.besides)} are for the process itself, {_mebibytes(taken)} for views in memory and the "
            "map, and the rest for the smallest tile with its halo; allow more (max_memory), or give fewer views or a "
            "narrower disparity range."
        )
    *_, tile, counts = min(plans)
    rows, columns = (_places(length, side, count) for length, side, count in zip(size, tile, counts, strict=True))
    return Plan(tile, tuple(itertools.product(rows, columns)), halo)


def _mebibytes(size: int) -> str:
    return f"{math.ceil(size / 2**20)} MiB"


def estimate_in_tiles(
    lf: LightField,
    *,
    config: Config,
    disparity_range: tuple[float, float] | None,
    backend: str,
    device: str | None,
    deterministic: bool,
    on_progress: Progress | None,
    max_memory: int,
) -> DepthResult:
    """Estimate as `estimate_depth` within `max_memory` bytes, of the process on a CPU, or of each GPU.

    If `device` is None, tiles are spread over all GPUs. On a CPU, views in memory count against the limit; views on
    disk (`lfgpu.read(..., lazy=True)`) do not.
    """
    start = perf_counter()
    first = open_device(backend, device)
    on_gpu = first.is_gpu
    devices = alike(first.kernels, first.name) if device is None else (first.name,)
    method = method_of(config)
    done: list[DepthResult] = []

    def estimate(measured: Measured) -> None:
        done.clear()
        forget(lf.views)
        in_memory = 0 if on_gpu or is_mapped(lf.views) else lf.views.nbytes
        kept = 4 * 8 * lf.size[0] * lf.size[1]  # maps of all tiles, and the joined maps
        needed = method.footprint(lf.layout, measured, on_gpu=on_gpu)
        taken = 0 if on_gpu else in_memory + kept
        plan = plan_tiles(
            lf.size, method.halo(lf.layout, measured), needed, max_memory, taken=taken, devices=len(devices)
        )
        options = {"config": config, "measured": measured, "backend": backend, "deterministic": deterministic}
        results = _estimate_all(lf, method, plan, devices, options, on_progress)
        joined = _joined(lf, plan, results, method.same_surface(lf.layout))
        there = [result.timings for result in results if result is not None]
        timings = {name: sum(timings.get(name, 0.0) for timings in there) for name in joined.timings}
        done.append(replace(joined, timings=timings))

    def match(bounds: tuple[float, float]) -> Float32Array:
        estimate(method.measured(lf, bounds, first))
        return done[0].stages[str(method.MATCHED)]

    estimate(method.measure(lf, first, disparity_range=disparity_range))
    doubt = None
    if disparity_range is None and method.MATCHED is not None:
        doubt = confirm(lf.layout, done[0].disparity_range, done[0].stages[method.MATCHED], match)
    notes = done[0].notes if doubt is None else (doubt, *done[0].notes)
    return replace(done[0], notes=notes, timings={**done[0].timings, "total": perf_counter() - start})


def _estimate_all(
    lf: LightField,
    method: Method[Any],
    plan: Plan,
    devices: Sequence[str],
    options: dict[str, Any],
    on_progress: Progress | None,
) -> list[DepthResult | None]:
    """Estimate each tile; None if a tile has no estimate. Each device takes the next tile when it is free."""
    used, count = method.used_views(lf.offsets), len(plan.starts)
    busy = devices[:count]
    free: queue.SimpleQueue[tuple[str, Resident]] = queue.SimpleQueue()
    for device in busy:
        free.put((device, Resident(most=1)))
    failed: list[LightFieldError] = []
    ended, reporting = itertools.count(1), threading.Lock()

    def estimated(start: tuple[int, int]) -> DepthResult | None:
        (device, resident), found = free.get(), None
        try:
            found = resident.estimate(_tile(lf, used, start, plan.size), device=device, **options)
        except TooLittleMemoryError as error:
            raise LightFieldError(f"a tile takes about {error.sizes}: set max_memory, or a smaller one.") from error
        except LightFieldError as error:  # the tile may lack texture; an error only if all tiles fail
            failed.append(error)
        finally:
            free.put((device, resident))
        if on_progress is not None:
            with reporting:
                done = next(ended)
                on_progress("tiles", done, done / count)
        return found

    if on_progress is not None:
        on_progress("tiles", 0, 0.0)
    if len(busy) == 1:
        results = list(map(estimated, plan.starts))
    else:
        with ThreadPoolExecutor(len(busy)) as pool:  # after an error no further tile is begun
            results = list(pool.map(estimated, plan.starts))
    if len(failed) == count:
        raise failed[0]
    return results


def _tile(lf: LightField, used: Sequence[int], start: tuple[int, int], size: tuple[int, int]) -> LightField:
    y, x = (slice(first, first + side) for first, side in zip(start, size, strict=True))
    window, chosen = lf.crop(y, x), list(used)
    views = np.empty((len(chosen), *window.views.shape[1:]), window.views.dtype)

    def copy(place: int, view: NDArray[Any]) -> None:
        views[place] = view

    each_view(window.views, chosen, copy)
    return replace(
        window,
        views=views,
        positions=lf.positions[chosen],
        reference=chosen.index(lf.reference_index),
        valid=None if window.valid is None else window.valid[chosen],
        grid_shape=None,
    )


def _joined(lf: LightField, plan: Plan, results: Sequence[DepthResult | None], same: float) -> DepthResult:
    """Join the results of all tiles to one."""
    there = [result for result in results if result is not None]
    first = there[0]
    names = list(first.stages)
    join = {name: _Join(lf.size, same) for name in names}
    disparity, confidence, uncertainty = _Join(lf.size, same), _Join(lf.size, math.inf), _Join(lf.size, math.inf)
    for start, result in zip(plan.starts, results, strict=True):
        if result is None:
            continue
        weight = _weights(lf.size, plan, start)
        taken = disparity.add(result.disparity, weight, start)
        confidence.add(result.confidence, weight, start, taken)
        if result.uncertainty is not None:
            uncertainty.add(result.uncertainty, weight, start, taken)
        for name in names:
            join[name].add(result.stages[name], weight, start)
    height, width = plan.size
    what = (
        "In one piece"
        if len(plan.starts) == 1
        else f"{len(plan.starts)} tiles of {width} x {height} pixels, of the first"
    )
    status = f"{what}: {first.status}"
    if len(there) < len(results):
        status += f" {len(results) - len(there)} tiles have no estimate, because their views have no texture."
    known, sure = np.isfinite(disparity.values), np.nan_to_num(confidence.values, nan=0.0)
    return replace(
        first,
        disparity=disparity.values,
        confidence=sure,
        uncertainty=None if first.uncertainty is None else np.where(known, uncertainty.values, np.float32(np.nan)),
        stages={name: values.values for name, values in join.items()},
        status=status,
        converged=all(result.converged for result in there),
        trace=_mean_trace([result.trace for result in there]),
        geometry=lf.geometry,
        name=lf.name,
        notes=map_notes(disparity.values, sure, first.disparity_range),
    )


def _weights(size: tuple[int, int], plan: Plan, start: tuple[int, int]) -> NDArray[np.float32]:
    """Make the weights [y, x] of the tile that begins at `start`.

    They are 0 in the halo, 1 inside, with a ramp between; 1 up to the edges of the image.
    """
    rows, columns = (
        _ramps(first, side, length, edge)
        for first, side, length, edge in zip(start, plan.size, size, plan.halo, strict=True)
    )
    return np.outer(rows, columns).astype(np.float32)


class _Join:
    """Join of maps of tiles: the weighted mean where they agree, else the map with the larger weight."""

    def __init__(self, size: tuple[int, int], same: float) -> None:
        self.values = np.full(size, np.nan, np.float32)
        self._weight, self._same = np.zeros(size, np.float32), same

    def add(
        self,
        values: NDArray[np.float32],
        weight: NDArray[np.float32],
        start: tuple[int, int],
        taken: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Add a tile. Returns the share of the tile in the map at each pixel, 0 to 1; `taken` prescribes this share."""
        window = tuple(slice(first, first + side) for first, side in zip(start, values.shape, strict=True))
        before, sums = self.values[window], self._weight[window]
        if taken is None:
            weight = np.where(np.isfinite(values), weight, np.float32(0))
            alike = np.abs(values - before) <= self._same  # False where there is no value yet
            share = np.where(alike, weight / np.maximum(weight + sums, np.float32(1e-12)), weight > sums)
            taken = np.where(sums > 0, share, weight > 0).astype(np.float32)
        mixed = (1 - taken) * np.nan_to_num(before) + taken * np.nan_to_num(values)
        touched = (taken > 0) | (sums > 0)
        self.values[window] = np.where(touched, mixed, before)
        self._weight[window] = np.where(taken >= 1, weight, np.where(taken > 0, sums + weight, sums))
        return np.asarray(taken, np.float32)


def _cuts(length: int, edge: int) -> list[tuple[int, int]]:
    """List all useful (number, length) of tiles along one axis, beginning with one tile."""
    overlap, found = 2 * edge + _RAMP + REDUCTION, [(1, length)]
    for count in itertools.count(2):
        side = math.ceil((length + (count - 1) * overlap) / count)
        side += (length - side) % REDUCTION
        if side >= length or side - overlap < _LEAST_STRIDE:
            return found
        found.append((count, side))
    raise AssertionError("the stride of tiles falls below any bound")


def _places(length: int, side: int, count: int) -> list[int]:
    """Place tiles at multiples of REDUCTION, so that reduced views are those of the whole; returns their starts."""
    steps = (length - side) // REDUCTION
    return [REDUCTION * round(k * steps / max(count - 1, 1)) for k in range(count)]


def _ramps(first: int, side: int, length: int, edge: int) -> NDArray[np.float64]:
    """Make the weights along one axis of a tile."""
    places = np.arange(side) + 0.5
    rising = np.ones(side) if first == 0 else (places - edge) / _RAMP
    falling = np.ones(side) if first + side == length else (side - edge - places) / _RAMP
    return np.clip(np.minimum(rising, falling), 0, 1)


def _mean_trace(traces: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """Average the traces of all tiles; a shorter trace is continued with its last value."""
    longest = max(map(len, traces))
    padded = [trace + trace[-1:] * (longest - len(trace)) for trace in traces]
    return tuple(float(np.mean(values)) for values in zip(*padded, strict=True))
