"""How far an operation is from the float64 reference on the same inputs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import Case
from benchmarks.inputs import LARGEST_DISPARITY
from benchmarks.operations import Operation
from benchmarks.prepare import Prepared, Region, prepare, whole
from lfgpu._backends import load
from lfgpu.types import KernelSet

_WINDOW = 64  # pixels along each side: what the reference can do at every size


def compare(
    operation: Operation, case: Case, done: Prepared, value: float | None, kernels: KernelSet
) -> tuple[float, str]:
    """The largest error of what `done` wrote relative to the largest magnitude, and what was compared.

    Tiny cases are compared in whole, others in a window at a random place that all views are splatted to and from. The
    reference sees a margin around it that is wider than anything can reach. A value that sums over the image (that of
    the data term) is compared where the image is compared in whole.
    """
    everything = case.tiny or not operation.local
    inner = whole(case) if everything else _window(case)
    outer = _grown(inner, _margin(case), case)
    reference = load("reference")
    truth = prepare(operation, reference, reference.devices()[0], case, outer)
    true_value = truth.call()
    kept = Region(_within(inner.rows, outer.rows), _within(inner.columns, outer.columns))

    errors = []
    true = {s.name: kept.cut(reference.numpy(truth.arrays[s.name]), s.axes) for s in operation.writes}
    for slot in operation.writes:
        found = inner.cut(kernels.numpy(done.arrays[slot.name]), slot.axes)
        errors.append(_relative(found, true[slot.name], _counted(operation, slot.name, true)))
    if everything and value is not None and true_value is not None:
        errors.append(abs(value - true_value) / abs(true_value))
    compared = "all" if everything else f"{_size(inner)} of {_size(whole(case))} pixels, over all views"
    return max(errors), compared


def _counted(operation: Operation, name: str, true: dict[str, NDArray[np.float64]]) -> NDArray[np.bool_] | None:
    if operation.trusted is None or operation.trusted[0] == name:
        return None
    trusted, least = operation.trusted
    return np.asarray(true[trusted] >= least)


def _relative(found: NDArray[np.floating], true: NDArray[np.float64], counted: NDArray[np.bool_] | None) -> float:
    if counted is not None:
        found, true = found[counted], true[counted]
    if not true.size:
        return 0.0
    return float(np.abs(found - true).max() / np.abs(true).max())


def _margin(case: Case) -> int:
    """Twice as far as a splat goes: a predicted view, and what in turn lands where it is looked at.

    At least 8 pixels, which windows, patches, gradients and the filters of the structure tensor do not reach.
    """
    return 2 * (math.ceil(LARGEST_DISPARITY * (max(case.grid) // 2)) + 2)


def _window(case: Case) -> Region:
    """The same for every backend."""
    rng = np.random.default_rng([0, *case.grid, *case.size])
    height, width = (min(_WINDOW, side) for side in case.size)
    row, column = int(rng.integers(case.size[0] - height + 1)), int(rng.integers(case.size[1] - width + 1))
    return Region(slice(row, row + height), slice(column, column + width))


def _grown(region: Region, margin: int, case: Case) -> Region:
    def grown(part: slice, length: int) -> slice:
        return slice(max(0, part.start - margin), min(length, part.stop + margin))

    return Region(grown(region.rows, case.size[0]), grown(region.columns, case.size[1]))


def _within(inner: slice, outer: slice) -> slice:
    return slice(inner.start - outer.start, inner.stop - outer.start)


def _size(region: Region) -> str:
    return f"{region.rows.stop - region.rows.start} x {region.columns.stop - region.columns.start}"
