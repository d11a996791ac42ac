"""Dry runs: a plan runs on a device that computes nothing and counts the bytes of all arrays.

`DRY_CPU` and `DRY_GPU` describe what the operations of a backend keep themselves, for the backend that keeps most.
`tests/test_tiles.py` compares the sum with measured memory.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lfgpu.contract import Device
from lfgpu.data.layout import ViewLayout
from lfgpu.threads import get_threads

_SIDE = 128  # pixels, width of the views of a dry run
_HEIGHTS = 512, 1024  # pixels: volumes that hold a few rows hold fewer
_FLOAT = 4  # bytes
_SLICES = 16  # at a time on a CPU, at most, each with its own nearest surfaces
_STEP_COSTS = 8 * 2 * _FLOAT  # bytes: of the steps to a pixel in all directions, which a GPU keeps
_SPARE_VOLUMES = 7  # of directions beside the first one, on a GPU that has room for them
_NORMALISED = 16  # views that are normalised at a time on a GPU
_TENSORS = 3  # positions along a line of views over which a structure tensor is summed
_TENSOR = 4  # numbers of a structure tensor


@dataclass(frozen=True, eq=False)
class DryArray:
    """An array without contents."""

    shape: tuple[int, ...]
    itemsize: int

    @property
    def nbytes(self) -> int:
        """The bytes that it would take."""
        return math.prod(self.shape) * self.itemsize


class DryOperation:
    """A planned operation, or any other that does nothing. Whatever is called on it does nothing, too."""

    def room(self, stored: Any) -> int:
        """Return 0: nothing is needed."""
        return 0

    def __call__(self, *arguments: Any, **options: Any) -> None:
        """Do nothing."""

    def __getattr__(self, name: str) -> DryOperation:
        return DryOperation()


class DryLoading(DryOperation):
    """A planned operation that keeps the views that it loads, with so many values for each pixel.

    Parameters
    ----------
    kernels
        What counts their bytes.
    shape
        The number of views, height and width.
    values
        Values of a pixel that are kept.
    has_room
        True if views are kept in memory that the caller gives.
    """

    def __init__(self, kernels: DryKernels, shape: Sequence[int], values: int, *, has_room: bool = False) -> None:
        self._kernels, self._shape, self._has_room = kernels, (*shape, values), has_room

    def room(self, stored: Any) -> int:
        """Count the floats that `load` needs."""
        return -(-math.prod(self._shape) * np.dtype(stored).itemsize // _FLOAT) if self._has_room else 0

    def load(self, image: Any, recorded: DryArray, valid: Any = None, room: Any = None) -> None:
        """Count views, whose type decides how many bytes are kept of them, unless there is room for them."""
        if room is None and self._shape:
            self._kernels.count(self._shape, recorded.itemsize)
        self._shape = ()  # the same memory is used again


class DryKernels:
    """Operations that count bytes and do nothing else."""

    name, dtype, compiles, streaming, recording = "dry", np.float32, False, None, None
    changing = DryOperation()  # volumes have the room that they have where numbers change

    def __init__(self, *, on_gpu: bool) -> None:
        self._on_gpu = on_gpu
        self.bytes, self.spare = 0, 0
        """Bytes that are needed, and that operations take besides where there is room."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *arguments, **options: DryOperation()

    # --- memory ---

    def zeros(self, shape: Sequence[int], device: str) -> DryArray:
        """Count a field."""
        return self._counted(shape, _FLOAT)

    def zeros_image(self, shape: Sequence[int], device: str, stored: Any = np.float32) -> DryArray:
        """Count an image."""
        return self._counted(shape, np.dtype(stored).itemsize)

    def within(self, home: DryArray, shape: Sequence[int], stored: Any = None) -> DryArray:
        """Count nothing."""
        return DryArray(tuple(shape), np.dtype(stored or np.float32).itemsize)

    def field(self, values: np.ndarray, device: str) -> DryArray:
        """Count a field."""
        return self._counted(values.shape, _FLOAT)

    def scalar(self, value: float, device: str) -> DryArray:
        """Count nothing."""
        return DryArray((), 8)

    def numpy(self, array: DryArray) -> np.ndarray:
        """Return zeros."""
        return np.zeros(array.shape, np.float32)

    def number(self, scalar: DryArray) -> float:
        """Return zero."""
        return 0.0

    @contextlib.contextmanager
    def asking(self, device: str) -> Iterator[None]:
        """Do nothing."""
        yield

    # --- operations that keep something ---

    def plane_sweep(
        self, shape: Sequence[int], views: Any, disparities: Any, *, scale: float, shared: Any = None
    ) -> DryOperation:
        """Count views that are not shared, and on a GPU the first disparity past the surface in each pixel."""
        if shared is not None:
            return DryOperation()
        if self._on_gpu:
            self.count(shape[:3], 2)
        return DryLoading(self, shape[:3], self._values(shape, has_mask=self._on_gpu), has_room=not self._on_gpu)

    def z_buffer(self, size: Sequence[int], device: str, *, reach: int) -> DryOperation:
        """Count the surfaces of each slice of the work."""
        return DryOperation() if self._on_gpu else self.count((min(_SLICES, get_threads()), *size), _FLOAT)

    def alignment(self, shape: Sequence[int], offsets: Any, *, shared: Any = None, **numbers: float) -> DryOperation:
        """Count views that are not shared, each pixel with its mask, and the weights of gradients."""
        if shared is not None:
            return DryOperation()
        self.count(shape[1:3], _FLOAT)
        return DryLoading(self, shape[:3], self._values(shape, has_mask=True), has_room=not self._on_gpu)

    def sector_costs(self, shape: Sequence[int], offsets: Any, *, scale: float) -> DryOperation:
        """Count views in an order of its own."""
        return DryLoading(self, shape[:3], self._values(shape, has_mask=self._on_gpu))

    def semi_global(self, volume: DryArray, image: Any, penalty_scale: Any, **numbers: Any) -> None:
        """Count what a GPU keeps: two volumes, and the steps to a pixel in all directions."""
        if self._on_gpu and not self.spare:
            self.count((2, *volume.shape), _FLOAT)
            self.count(volume.shape[1:], _STEP_COSTS)
            self.spare = _SPARE_VOLUMES * volume.nbytes

    def nlm_weights(self, shape: Sequence[int], device: str, **numbers: Any) -> DryOperation:
        """Count colours and gradients, and on a GPU the sums of patches."""
        return self.count((*shape[:2], 3 * shape[2]), _FLOAT)

    def structure_tensor(self, shape: Sequence[int], *arguments: Any, **numbers: Any) -> DryOperation:
        """Count the tensors of a few views, on a CPU the filtered views."""
        return self.count((_TENSORS, _TENSOR, *shape[1:]) if self._on_gpu else shape, _FLOAT)

    def normalization(self, shape: Sequence[int], device: str, **numbers: float) -> DryOperation:
        """Count the views that a GPU normalises at a time."""
        if self._on_gpu:
            count, *others = shape
            self.count((min(count, _NORMALISED), *others), 2 * _FLOAT)
            self.count((min(count, _NORMALISED), *others[:2]), 3 * _FLOAT)
        return DryOperation()

    def data_term(self, shape: Sequence[int], offsets: Any, **numbers: float) -> DryOperation:
        """Count recorded views as they are compared, and their coverage."""
        self.count(shape[:3], _FLOAT)
        if not self._on_gpu:
            return self.count((2, *shape), _FLOAT)
        return DryLoading(self, shape[:3], self._values(shape, has_mask=True))

    def lbfgs(self, shape: Sequence[int], device: str, *, memory: int, **numbers: Any) -> DryOperation:
        """Count the history."""
        return self.count((2 * memory + 2, *shape), _FLOAT)

    @staticmethod
    def _values(shape: Sequence[int], *, has_mask: bool) -> int:
        """Return how many values a pixel of views [n, y, x, c] has: 2 or 4 if its mask is among them."""
        return shape[3] if not has_mask else 4 if shape[3] == 3 else 2

    def _counted(self, shape: Sequence[int], itemsize: int) -> DryArray:
        self.count(shape, itemsize)
        return DryArray(tuple(shape), itemsize)

    def count(self, shape: Sequence[int], itemsize: int) -> DryOperation:
        """Count an array."""
        self.bytes += math.prod(shape) * itemsize
        return DryOperation()


@dataclass(frozen=True)
class Counted:
    """The bytes of a plan, which depend on the size of the views."""

    per_pixel: float
    per_column: float  # of volumes that hold a few rows
    spare_per_pixel: float  # that operations take besides where there is room


def dry_run(layout: ViewLayout, plan: Callable[[ViewLayout, Device], Any], *, on_gpu: bool) -> Counted:
    """Allocate a plan for a layout and run its stages, all dry, for views of two heights."""
    low, high = (_counting(layout, plan, (height, _SIDE), on_gpu=on_gpu) for height in _HEIGHTS)
    more = _HEIGHTS[1] - _HEIGHTS[0]
    per_pixel = (high.bytes - low.bytes) / (more * _SIDE)
    return Counted(per_pixel, low.bytes / _SIDE - per_pixel * _HEIGHTS[0], low.spare / (_HEIGHTS[0] * _SIDE))


def _counting(
    layout: ViewLayout, plan: Callable[[ViewLayout, Device], Any], size: tuple[int, int], *, on_gpu: bool
) -> DryKernels:
    """Run a plan for views of a size; return what has counted."""
    mask = np.ones(size, np.bool_)
    masks = None if layout.masks is None else (mask,) * layout.count
    small, kernels = replace(layout, size=size, masks=masks), DryKernels(on_gpu=on_gpu)
    device = Device(kernels, "cuda:0" if on_gpu else "cpu")  # type: ignore[arg-type]  # it does what is asked of it
    with np.errstate(all="ignore"):  # solvers on the host divide by what is 0 here
        for work in plan(small, device).stages(DryArray(small.shape, layout.dtype.itemsize)).values():
            work(None)
    return kernels
