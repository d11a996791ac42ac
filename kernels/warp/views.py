"""Preparation of views: intensities, lines of views, and local contrast normalisation."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import Normalization

from .memory import pixel_type
from .native_code import kernel
from .pixels import Volume, pixelwise
from .threads import Rooms, check_size, in_slices, lanes, launch, launch_rows, load, once

wp.set_module_options({"enable_backward": False})

_TRUNCATE = 2.5  # Gaussians end after as many standard deviations
_LEAST_SHARE = 1e-6  # of a Gaussian that must lie on valid pixels
_AT_ONCE = 4  # pixels
_BATCH = 16  # views at a time on a GPU: what lies between two passes stays in its cache


@once
def _intensities(channels: int, stored: Any) -> Any:
    pixel = pixel_type(channels)

    @pixelwise(f"lfgpu_intensities_{channels}_{stored.__name__}")
    def intensities(
        y: int,
        x: int,
        views: wp.array3d(dtype=pixel_type(channels, stored)),
        index: int,
        valid: Volume,
        scale: float,
        fill: float,
        image_out: wp.array2d(dtype=pixel),
    ):
        value = pixel()
        stored_value = views[index, y, x]
        for c in range(wp.static(channels)):
            value[c] = scale * float(stored_value[c])
        if valid and valid[index, y, x] == 0.0:
            value = pixel()
            sides = float(0.0)
            for down in range(2):
                right = 1 - down
                inside = y >= down and x >= right and y + down < valid.shape[1] and x + right < valid.shape[2]
                if inside and valid[index, y - down, x - right] != 0.0 and valid[index, y + down, x + right] != 0.0:
                    before = views[index, y - down, x - right]
                    after = views[index, y + down, x + right]
                    sides += 2.0
                    for c in range(wp.static(channels)):
                        value[c] += scale * (float(before[c]) + float(after[c]))
            for c in range(wp.static(channels)):
                value[c] = wp.where(sides > 0.0, value[c] / wp.max(sides, 1.0), fill)
        image_out[y, x] = value

    return intensities


@once
def indices(line: tuple[int, ...], device: str) -> Any:
    """Indices of views on a device."""
    return wp.array(np.array(line, np.int32), dtype=int, device=device)


def intensities(views: Any, *arguments: Any, **named: Any) -> None:
    _intensities(views.dtype._length_, views.dtype._wp_scalar_type_)(views, *arguments, **named)


def line_of_views(
    views: Any, line: Sequence[int], *, vertical: bool, epis_out: Any, corner: tuple[int, int] = (0, 0)
) -> None:
    if views.dtype is wp.float32:  # a field is an image of one channel
        views, epis_out = (array.view(pixel_type(1)) for array in (views, epis_out))
    copy = kernel("views.h", "copy_line", Stored=views.dtype)
    chosen = indices(tuple(int(index) for index in line), views.device.alias)
    launch_rows(copy, [views, chosen, int(vertical), *corner], epis_out)


@once
def _scaling(channels: int, stored: Any, detail: Any) -> Any:
    detail_pixel = pixel_type(channels, detail)

    @pixelwise(f"lfgpu_scaling_{channels}_{stored.__name__}_{detail.__name__}")
    def scaling(
        n: int,
        y: int,
        x: int,
        views: wp.array3d(dtype=pixel_type(channels, stored)),
        scale: float,
        detail_out: wp.array3d(dtype=detail_pixel),
    ):
        stored_value = views[n, y, x]
        out = detail_pixel()
        for c in range(wp.static(channels)):
            out[c] = detail(scale * float(stored_value[c]))
        detail_out[n, y, x] = out

    return scaling


@once
def _normalization_kernels(channels: int, stored: Any, detail: Any, sigma: float) -> SimpleNamespace:
    """Return the kernels of the four passes; the energies are images of one channel."""
    energy = pixel_type(1)
    module = f"lfgpu_normalization_{channels}_{stored.__name__}_{detail.__name__}_{sigma!r}".replace(".", "_")
    types = {"Stored": pixel_type(channels, stored), "Pixel": pixel_type(channels), "Energy": energy}
    types["Detail"] = pixel_type(channels, detail)
    name = "wp::half" if detail is wp.float16 else "float"
    numbers = {"CHANNELS": channels, "AT_ONCE": _AT_ONCE, "LEAST": _LEAST_SHARE, "DETAIL": name}

    def of_gaussian(name: str, sigma: float, module: str | None = module, **others: Any) -> Any:
        gaussian = ", ".join(f"{weight:.9e}f" for weight in _gaussian(sigma))
        return kernel("views.h", name, module=module, **types | numbers | others, GAUSSIAN=gaussian)

    return SimpleNamespace(
        rows=of_gaussian("add_rows", sigma),
        detail=of_gaussian("subtract_mean", sigma),
        energy_rows=of_gaussian("add_rows", 2 * sigma, None, Stored=energy, Pixel=energy, CHANNELS=1),
        contrast=of_gaussian("divide_by_contrast", 2 * sigma),
    )


def _gaussian(sigma: float) -> NDArray[np.float64]:
    radius = int(_TRUNCATE * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return np.asarray(weights / weights.sum())


def normalization(shape: Sequence[int], device: str, *, scale: float, sigma: float, floor: float) -> Normalization:
    if sigma == 0:
        return lambda views, valid, detail_out: _scaling(
            shape[3], views.dtype._wp_scalar_type_, detail_out.dtype._wp_scalar_type_
        )(views, scale, detail_out)
    (n, height, width, channels), place = shape, wp.get_device(device)
    batch = 1 if place.is_cpu else _BATCH
    kinds = *(pixel_type(channels),) * 2, *(pixel_type(1),) * 2, float
    rooms = Rooms(place, lambda: [wp.empty((batch, height, width), dtype=kind, device=place) for kind in kinds])

    def normalize(views: Any, valid: Any, detail_out: Any) -> None:
        kernels = _normalization_kernels(
            channels, views.dtype._wp_scalar_type_, detail_out.dtype._wp_scalar_type_, sigma
        )
        threads = lanes(views)
        load(place, kernels.rows, kernels.energy_rows)
        across, down = -(-threads // _AT_ONCE), -(-height // _AT_ONCE)

        def launch_each(kernel: Any, rows: int, columns: int, inputs: list[Any], outputs: list[Any]) -> None:
            check_size(rows * columns)
            launch(kernel, rows * columns, [*inputs, columns], outputs, device=place)

        def some_views(k: int, first: int, last: int) -> None:
            sums, details, energy, energy_sums, shares = rooms[k]
            for start in range(first, last, batch):
                end = min(start + batch, last)
                some, mask = views[start:end], None if valid is None else valid[start:end]
                rows, blocks = (end - start) * height, (end - start) * down
                launch_each(kernels.rows, rows, across, [some, mask, scale], [sums, shares])
                launch_each(kernels.detail, blocks, threads, [some, sums, shares, mask, scale], [details, energy])
                launch_each(kernels.energy_rows, rows, across, [energy, mask, 1.0], [energy_sums, shares])
                inputs = [details, energy_sums, shares, mask, floor]
                launch_each(kernels.contrast, blocks, threads, inputs, [detail_out[start:end]])

        in_slices(place, n, some_views)

    return normalize
