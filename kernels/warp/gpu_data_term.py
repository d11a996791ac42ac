"""The data term on a GPU: a tile of one view is predicted, compared and followed back within one block of threads."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import warp as wp

from .memory import pixel_type
from .native_code import function, kernel, names_of
from .pixels import Field, pixelwise
from .threads import check_size, launch, once


@once
def _square(channels: int) -> Any:
    @pixelwise(f"lfgpu_curvature_{channels}", light=True)
    def square(y: int, x: int, image: wp.array2d(dtype=pixel_type(channels)), factor: float, curvature_out: Field):
        curvature_out[y, x] = factor * wp.dot(image[y, x], image[y, x])

    return square


def curvature_factor(offsets: Any) -> float:
    """2 Σ |offset|² of offsets [n, 2]; waits for the device."""
    return 2.0 * float((offsets.numpy().astype("float64") ** 2).sum())


def curvature(image: Any, factor: float, curvature_out: Any) -> None:
    """factor * Σ_c image² of an image [y, x, c]."""
    _square(image.dtype._length_)(image, factor, curvature_out)


wp.set_module_options({"enable_backward": False})

_WARP = 32
_ROWS = 4  # of a strip; what they add to a pixel one after the other they add once
_COLUMNS = _WARP - 1  # of a strip; lane 0 has the last column of the strip before, which it hands on
_STRIP = _WARP * _ROWS
_PITCH = 128  # of a tile in shared memory: its columns and taps beyond them on either side
_TILE_ROWS = 28  # as many as fit, with three channels and what Warp takes, into 48 KiB
_BLOCK = 256
_BLOCKS_AT_ONCE = 4  # on a multiprocessor; more would leave a thread too few registers
_LIST = 128  # strips that a block looks at in one go
_PARTS = 128  # blocks that look for the range of the disparities


@once
def _kernels(channels: int, stored: Any, compact: Any) -> SimpleNamespace:
    """Views come as `stored` and are kept as `compact` scalars."""
    pad = 4 if channels == 3 else 2
    pixel, stored_pixel = pixel_type(channels), pixel_type(channels, stored)
    padded, kept_pixel = pixel_type(pad), pixel_type(pad, compact)
    module = f"lfgpu_gpu_data_term_{channels}_{stored.__name__}"

    numbers = {
        "CHANNELS": channels,
        **names_of(kept_pixel),
        "TILE_ROWS": _TILE_ROWS,
        "ROWS": _ROWS,
        "COLUMNS": _COLUMNS,
        "STRIP": _STRIP,
        "PITCH": _PITCH,
        "BLOCK": _BLOCK,
        "LIST": _LIST,
        "PARTS": _PARTS,
    }

    def native(name: str, **options: Any) -> Any:
        return kernel("data_term.cuh", name, module=module, Padded=padded, Kept=kept_pixel, **numbers, **options)

    raise_to = function("data_term.cuh", "raise_to")

    @wp.kernel(module=module, enable_backward=False)
    def image_kernel(
        image: wp.array2d(dtype=pixel),
        columns: int,
        strips_out: wp.array(dtype=padded),
        most_out: wp.array(dtype=float),
    ):
        """Cut the image into strips, 0 out of the frame, and find its largest absolute value."""
        i = wp.tid()
        strip = i / wp.static(_STRIP)
        row = strip / columns
        r = (i - strip * wp.static(_STRIP)) / wp.static(_WARP)
        y = row * wp.static(_ROWS) + r
        x = (strip - row * columns) * wp.static(_COLUMNS) + i % wp.static(_WARP) - 1
        value = padded()
        most = float(0.0)
        if x >= 0 and x < image.shape[1] and y < image.shape[0]:
            for c in range(wp.static(channels)):
                value[c] = image[y, x][c]
                most = wp.max(most, wp.abs(value[c]))
        strips_out[i] = value
        raise_to(most, i % wp.static(_WARP), most_out)

    @wp.kernel(module=module, enable_backward=False)
    def pack_kernel(
        recorded: wp.array(dtype=stored_pixel), valid: wp.array(dtype=float), packed_out: wp.array(dtype=kept_pixel)
    ):
        i = wp.tid()
        packed = kept_pixel()
        if not valid or valid[i] != 0.0:
            value = recorded[i]
            for c in range(wp.static(channels)):
                packed[c] = compact(value[c])
            packed[wp.static(pad - 1)] = compact(1.0)
        packed_out[i] = packed

    return SimpleNamespace(
        image=image_kernel,
        pack=pack_kernel,
        ranges=native("find_ranges"),
        tile=native("evaluate_tile", launch_bounds=(_BLOCK, _BLOCKS_AT_ONCE)),
        total=native("add_up"),
    )


def _tiling(size: int, most: int) -> tuple[int, int]:
    """Return number and size of tiles of at most `most` pixels that cover `size` pixels and the place before."""
    count = -(-(size + 1) // most)
    return count, -(-(size + 1) // count)


class GpuDataTerm:
    """The plan of the data term on a GPU."""

    def __init__(self, shape: Sequence[int], offsets: Any, scale: float, softness: float) -> None:
        n, height, width, channels = shape
        device = offsets.device
        self._shape, self._offsets, self._scale, self._softness = tuple(shape), offsets.view(wp.vec2f), scale, softness
        self._curvature = curvature_factor(offsets)
        self._columns, rows = -(-(width + 1) // _COLUMNS), -(-height // _ROWS)
        strips = self._columns * rows
        (down, tile_height), (across, tile_width) = _tiling(height, _TILE_ROWS), _tiling(width, _PITCH - 2)
        self._tiling = (height, width, down, across, tile_height, tile_width)
        check_size(n * down * across * _BLOCK, n * height * width, strips * _STRIP)
        self._image = wp.empty(strips * _STRIP, dtype=pixel_type(4 if channels == 3 else 2), device=device)
        self._most = wp.zeros(1, dtype=float, device=device)
        self._disparity = wp.zeros(strips * _STRIP, dtype=float, device=device)
        self._ranges = wp.zeros(strips, dtype=wp.vec2f, device=device)
        self._parts = wp.zeros(_PARTS, dtype=wp.vec2f, device=device)
        self._gradients = wp.zeros((n, strips * _STRIP), dtype=float, device=device)
        self._squares = wp.zeros(n * down * across, dtype=wp.float64, device=device)
        self._stored: Any = None

    def _prepare(self, stored: Any) -> None:
        """Allocate for views of scalar type `stored`."""
        n, height, width, channels = self._shape
        # Views that come in half precision are kept so: it is half of what has to be read.
        compact = wp.float16 if stored is wp.float16 else wp.float32
        self._stored, self._kernels = stored, _kernels(channels, stored, compact)
        kept = pixel_type(self._image.dtype._length_, compact)
        self._packed = wp.empty((n, height, width), dtype=kept, device=self._image.device)

    def load(self, image: Any, recorded: Any, valid: Any) -> None:
        stored, device = recorded.dtype._wp_scalar_type_, image.device
        if stored is not self._stored:
            self._prepare(stored)
        self._given = image
        self._most.zero_()
        outputs = [self._image, self._most]
        launch(self._kernels.image, self._image.size, [image, self._columns], outputs, device=device)
        inputs = [recorded.flatten(), None if valid is None else valid.flatten()]
        launch(self._kernels.pack, recorded.size, inputs, [self._packed.flatten()], device=device)

    def __call__(self, disparity: Any, gradient_out: Any, value_out: Any) -> None:
        kernels, device, offsets, ours = self._kernels, disparity.device, self._offsets, self._disparity
        outputs = [ours, self._ranges, self._parts]
        launch(kernels.ranges, _PARTS * _BLOCK, [disparity], outputs, device=device, block_dim=_BLOCK)
        inputs = [self._image, self._most, ours, self._ranges, self._parts, offsets, self._packed]
        inputs += [self._softness, self._scale, *self._tiling]
        outputs = [self._gradients, self._squares]
        dim = self._squares.size * _BLOCK
        launch(kernels.tile, dim, inputs, outputs, device=device, block_dim=_BLOCK)
        inputs, dim = [self._gradients, ours, offsets, self._squares], -(-ours.size // _BLOCK) * _BLOCK
        launch(kernels.total, dim, inputs, [gradient_out, value_out], device=device, block_dim=_BLOCK)

    def curvature(self, curvature_out: Any) -> None:
        curvature(self._given, self._curvature, curvature_out)
