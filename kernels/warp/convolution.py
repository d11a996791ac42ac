"""Convolutions of volumes; `kernels/reference/convolution.py` says what they are."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import Float32Array, Float64Array, Rows

from .memory import pixel_type, start
from .native_code import c_type, kernel
from .threads import check_size, launch, launch_slices, room_for, scalars

_LANES = 16  # channels of the output that a CPU computes side by side
_ROWS, _PIXELS = 4, 32  # of the output that it computes from the same copies
_WARPS = 4  # of a block of a GPU
_COLUMNS = 16  # of the output of a block
_SHARED = 46 * 2**10  # bytes of a volume that a block keeps at most
_SUMS = 96  # that a thread of a GPU keeps in registers
_GROUP = 4  # channels that a thread computes where there are no tensor cores
_AMPERE = 80  # compute capability from which on tensor cores multiply as they are asked to

_Strides = tuple[int, int, int]


def _gpu_kernel(
    shape: tuple[int, ...], strides: _Strides, rectified: bool, stored: Any, result: Any, tiles: int = 0
) -> Any:
    """Return the kernel of a GPU for weights of a shape [l, y, x, c_in, c_out], and `tiles` of rows on each warp."""
    *_, inputs, outputs = shape
    names = "KL", "KY", "KX", "CI", "CO", "SL", "SY", "SX"
    numbers: dict[str, Any] = dict(zip(names, (*shape, *strides), strict=True))
    numbers |= {"PADDED": _padded(outputs), "RECTIFIED": int(rectified)}
    numbers |= {"TILES": tiles, "APART": _apart(inputs), "SHARED": _SHARED}
    numbers |= {"STORED": c_type(stored), "RESULT": c_type(result)}
    types = {"In": pixel_type(inputs, stored), "Added": pixel_type(outputs, stored), "Out": pixel_type(outputs, result)}
    return kernel("convolution.cuh", "convolve_tiles" if tiles else "convolve_voxels", **types, **numbers)


def _cpu_kernel(taps: int, stride: int, stored: Any, result: Any) -> Any:
    """Return the kernel of a CPU for so many taps along a row; it serves all channels, and windows along l and y."""
    before, weighed, after = _products(taps, stride)
    numbers: dict[str, Any] = {"KX": taps, "SX": stride, "ROWS": _ROWS, "PIXELS": _PIXELS}
    numbers |= {"TERMS": len(before), "TAPS": weighed.shape[1], "MANY": len(after)}
    numbers |= {"BEFORE": tuple(before.ravel().tolist()), "AFTER": tuple(after.ravel().tolist())}
    numbers |= {"STORED": c_type(stored, for_vectors=True), "RESULT": c_type(result, for_vectors=True)}
    return kernel("convolution.h", "convolve_rows", Stored=stored, Result=result, **numbers)


def _products(taps: int, stride: int) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the sums of products by which a CPU multiplies windows of so many taps along a row.

    These are sums of the volume [term, pixel], and of the weights [term, tap, tap of the window], whose products are
    computed, and sums of these [pixel of the output, term]. For three taps they are Winograd's F(4, 3): the products
    are values of polynomials at six points. Elsewhere each tap is multiplied by itself.
    """
    if (taps, stride) != (3, 1):
        return np.ones((1, taps)), np.eye(taps)[np.newaxis], np.ones((1, 1))

    def powers(count: int) -> Float64Array:
        """Return the powers of each point; of infinity, which is the last one, the highest alone counts."""
        return np.vstack([np.vander([0, 1, -1, 2, -2], count, increasing=True), np.eye(count)[-1]])

    before = np.linalg.inv(powers(6)).T.round(12).astype(np.float64)
    return before, powers(taps)[:, np.newaxis], powers(4).T


def _padded(channels: int) -> int:
    return -(-channels // _LANES) * _LANES


def _apart(channels: int) -> int:
    """Return how far apart pixels of a volume lie in a block, so that eight of them are in different banks."""
    return channels if channels // 8 % 2 else channels + 8


def _tiles(shape: tuple[int, ...], strides: _Strides) -> int:
    """Return the rows of each warp, as many as memory and registers have room for; 0 if there is none for any.

    Memory has room for the next slice, too, unless that leaves each warp one row. Where windows are pixels, none of it
    is shared, and registers are left to more warps, which wait for the volume at the same time.
    """
    slices, high, wide, inputs, outputs = shape
    choices = ((0, 2), (0, 1)) if slices * high * wide == 1 else ((2, 4), (2, 3), (2, 2), (1, 2), (1, 1))
    for buffers, tiles in choices:
        rows = (_WARPS * tiles - 1) * strides[1] + high
        columns = strides[2] * (_COLUMNS - 1 + -(-wide // strides[2]))
        kept = min(buffers, slices) * rows * columns * 2 * _apart(inputs)
        if kept <= _SHARED and 4 * tiles * -(-outputs // 8) <= _SUMS:
            return tiles
    return 0


def _dealt(channels: int) -> NDArray[np.intp]:
    """Return the order of channels in which each two blocks of 8 give a lane four channels next to each other."""
    pairs = np.arange(channels // 16 * 16).reshape(-1, 4, 2, 2).swapaxes(1, 2).ravel()
    return np.append(pairs, np.arange(len(pairs), channels))


def _fragments(weights: Float32Array) -> Any:
    """Return the weights as lanes of a GPU read them: [tap, block of inputs, block of outputs, lane], pairs in a word.

    Lane 4 i + j of a block has output i and the inputs 2 j and 2 j + 1, in the order in which channels are `_dealt`;
    inputs are in that order where windows are pixels.
    """
    *window, inputs, outputs = weights.shape
    halves = np.pad(weights, [(0, 0)] * 4 + [(0, -outputs % 8)]).astype(np.float16)[..., _dealt(outputs + -outputs % 8)]
    if np.prod(window) == 1:
        halves = halves[..., _dealt(inputs), :]
    blocks = halves.reshape(-1, inputs // 8, 4, 2, -(-outputs // 8), 8)
    return np.ascontiguousarray(blocks.transpose(0, 1, 4, 5, 2, 3)).reshape(-1).view(np.uint32)


class convolution:
    """The weights in the order in which a device reads them."""

    def __init__(
        self,
        weights: Float32Array,
        bias: Float32Array,
        device: str,
        *,
        strides: _Strides = (1, 1, 1),
        rectified: bool = False,
    ) -> None:
        start()
        self._shape, self._strides, self._rectified = weights.shape, strides, rectified
        self._device = wp.get_device(device)
        more = 0, _padded(len(bias)) - len(bias)
        padded = np.pad(weights, [(0, 0)] * 4 + [more])
        if self._device.is_cpu:
            deep, tall, taps, inputs, _ = weights.shape
            before, weighed, after = _products(taps, strides[2])
            padded = np.einsum("tsk, lykio -> tlysio", weighed, padded, optimize=True)
            plan = [deep, tall, *strides[:2], padded.shape[-1], rectified]
            self._plan = wp.array(plan, dtype=int, device=self._device)
            pixels = (_PIXELS - 1) * strides[2] + taps
            copy = pixels if len(before) == 1 else _PIXELS // len(after)
            copies = len(before) * deep * ((_ROWS - 1) * strides[1] + tall)
            self._room = room_for(self._device, (pixels + copies * copy) * inputs)
        self._weights = wp.array(padded.reshape(-1), dtype=float, device=self._device)
        self._bias = wp.array(np.pad(bias, more), dtype=float, device=self._device)
        # What is no GPU at all stands for one in tests.
        has_tensor_cores = not self._device.is_cpu and self._device.arch not in range(1, _AMPERE)
        self._tiles = _tiles(weights.shape, strides) if has_tensor_cores else 0
        if self._tiles:
            self._fragments = wp.array(_fragments(weights), dtype=wp.uint32, device=self._device)

    def __call__(self, volume: Any, added: Any, volume_out: Any, *, rows: Rows | None = None) -> None:
        labels, held, columns = volume_out.shape
        types = tuple(array.dtype._wp_scalar_type_ for array in (volume, volume_out))
        kind = self._shape, self._strides, self._rectified, *types
        if rows is None:
            first, some, height = 0, held, volume.shape[1]
            high = 1 if added is None else held // added.shape[1]
        else:
            first, some, height = rows.first, rows.last - rows.first, rows.all * self._strides[1]
            high = 1 if added is None else columns // added.shape[2]
        inputs = [volume, self._weights, self._bias, added, first, some, height, high]
        if not self._device.is_cpu:
            self._on_gpu(kind, inputs, some, volume_out)
            return
        given = [scalars(volume), self._weights, self._bias, None if added is None else scalars(added), self._plan]
        work = _cpu_kernel(self._shape[2], self._strides[2], *types)
        launch_slices(work, labels * some, [*given, *inputs[4:]], scalars(volume_out), room=self._room)

    def _on_gpu(self, kind: tuple[Any, ...], inputs: list[Any], rows: int, out: Any) -> None:
        labels, _, columns = out.shape
        if not self._tiles or inputs[0].dtype._wp_scalar_type_ is not wp.float16:
            threads = labels * rows * columns * self._shape[-1] // _GROUP
            check_size(threads)
            launch(_gpu_kernel(*kind), threads, inputs, [out], device=self._device)
            return
        blocks = labels * -(-rows // (_WARPS * self._tiles)) * -(-columns // _COLUMNS)
        threads = _WARPS * 32
        check_size(blocks * threads)
        inputs[1] = self._fragments
        convolve = _gpu_kernel(*kind, tiles=self._tiles)
        launch(convolve, blocks * threads, inputs, [out], device=self._device, block_dim=threads)
