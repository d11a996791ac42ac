"""How far an operation is from the float64 reference on the same inputs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import Case
from benchmarks.inputs import CONFIG, LARGEST_DISPARITY
from benchmarks.operation import Operation, Slot
from benchmarks.prepare import Prepared, Region, prepare, whole
from lfgpu._backends import load
from lfgpu.contract import REDUCTION, Array, KernelSet

_WINDOW = 64  # pixels along each side: what the reference can do at every size
_CUT_OFF = 2.5  # standard deviations after which the normalisation's Gaussians end, of one and of two detail scales


def compare(operation: Operation, case: Case, done: Prepared, kernels: KernelSet, device: str) -> tuple[float, str]:
    """The largest error of what `done.once` wrote relative to the largest magnitude, and what was compared.

    Of masks it is the share of pixels that differ. Tiny cases are compared in whole, others in a window at a random
    place that all views are splatted to and from. The reference sees a margin around it that is wider than anything can
    reach. A number that sums over the image (the value of the data term) is compared where the image is compared in
    whole.
    """
    everything = case.tiny or not operation.local
    inner = whole(case) if everything else _window(case)
    outer = _grown(inner, _margin(case), case)
    reference = load("reference")
    truth = prepare(operation, reference, reference.devices()[0], case, outer, as_on=device)
    truth.once()
    kept = Region(_within(inner.rows, outer.rows), _within(inner.columns, outer.columns))

    compared_slots = [slot for slot in operation.writes if not slot.inside and (everything or slot.axes)]
    true = {s.name: kept.cut(_values(reference, truth.arrays[s.name], s), s.axes) for s in compared_slots}
    errors = []
    for slot in compared_slots:
        found = inner.cut(_values(kernels, done.arrays[slot.name], slot), slot.axes)
        if operation.mask:
            errors.append(float((found != true[slot.name]).mean()))
        else:
            errors.append(_relative(found, true[slot.name], _counted(operation, slot.name, true)))
    compared = "all" if everything else f"{_size(inner)} of {_size(whole(case))} pixels, over all views"
    return max(errors), compared


def _values(kernels: KernelSet, array: Array, slot: Slot) -> NDArray[Any]:
    return kernels.numpy(array) if slot.axes else np.array(kernels.number(array))


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

    At least as far as the two Gaussians of the normalisation go together; other windows and filters reach less far. It
    is of whole pixels of a reduced view.
    """
    splats = 2 * (math.ceil(LARGEST_DISPARITY * (max(case.grid) // 2)) + 2)
    farthest = max(splats, math.ceil(3 * _CUT_OFF * CONFIG.refinement.detail_scale) + 1)
    return REDUCTION * math.ceil(farthest / REDUCTION)


def _window(case: Case) -> Region:
    """The same for every backend; it begins where a pixel of a reduced view does."""
    rng = np.random.default_rng([0, *case.grid, *case.size])
    height, width = (min(_WINDOW, side) for side in case.size)
    row, column = (
        REDUCTION * int(rng.integers((side - part) // REDUCTION + 1))
        for side, part in zip(case.size, (height, width), strict=True)
    )
    return Region(slice(row, row + height), slice(column, column + width))


def _grown(region: Region, margin: int, case: Case) -> Region:
    def grown(part: slice, length: int) -> slice:
        return slice(max(0, part.start - margin), min(length, part.stop + margin))

    return Region(grown(region.rows, case.size[0]), grown(region.columns, case.size[1]))


def _within(inner: slice, outer: slice) -> slice:
    return slice(inner.start - outer.start, inner.stop - outer.start)


def _size(region: Region) -> str:
    return f"{region.rows.stop - region.rows.start} x {region.columns.stop - region.columns.start}"
