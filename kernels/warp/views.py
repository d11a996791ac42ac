"""What becomes of views before they are compared: intensities, lines of views, and local contrast normalisation."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import Normalization

from .memory import pixel_type
from .threads import check_size, in_slices, lanes, launch, launch_rows, load, once, slices

wp.set_module_options({"enable_backward": False})

_TRUNCATE = 2.5  # Gaussians end after as many standard deviations
_LEAST_SHARE = 1e-6  # of a Gaussian that must lie on valid pixels
_AT_ONCE = 4  # pixels
_BATCH = 16  # views at a time on a GPU: what lies between two passes stays in its cache


# Native code because Warp's own indices have 64 bits, and take a GPU longer than the memory.
_COPY_ROW = """
    const int rows = views.shape[1], columns = views.shape[2], height = epis.shape[1], width = epis.shape[2];
    for (int x = lane; x < width; x += lanes) {
        const size_t from = vertical ? (size_t)x * columns + y : (size_t)y * columns + x;
        const auto* const in = views.data + from;
        auto* const out = epis.data + (size_t)y * width + x;
    #pragma unroll 4
        for (int u = 0; u < line.shape[0]; ++u)
            out[(size_t)u * height * width] = in[(size_t)line.data[u] * rows * columns];
    }
"""


@once
def _copy_kernels(channels: int, stored: Any) -> SimpleNamespace:
    pixel, stored_pixel = pixel_type(channels), pixel_type(channels, stored)
    module = f"lfgpu_views_{channels}_{stored.__name__}"

    @wp.kernel(module=module, enable_backward=False)
    def intensities_kernel(
        views: wp.array3d(dtype=stored_pixel),
        index: int,
        valid: wp.array3d(dtype=float),
        scale: float,
        fill: float,
        row: int,
        lanes: int,
        image_out: wp.array2d(dtype=pixel),
    ):
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
        for x in range(lane, image_out.shape[1], lanes):
            value = pixel()
            stored_value = views[index, y, x]
            for c in range(wp.static(channels)):
                value[c] = scale * float(stored_value[c])
            if valid and valid[index, y, x] == 0.0:
                for c in range(wp.static(channels)):
                    value[c] = fill
            image_out[y, x] = value

    @wp.func_native(_COPY_ROW)
    def copy_row(
        views: wp.array3d(dtype=stored_pixel),
        line: wp.array(dtype=int),
        vertical: int,
        y: int,
        lane: int,
        lanes: int,
        epis: wp.array3d(dtype=stored_pixel),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def line_kernel(
        views: wp.array3d(dtype=stored_pixel),
        line: wp.array(dtype=int),
        vertical: int,
        row: int,
        lanes: int,
        epis_out: wp.array3d(dtype=stored_pixel),
    ):
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
        copy_row(views, line, vertical, y, lane, lanes, epis_out)

    return SimpleNamespace(intensities=intensities_kernel, line=line_kernel)


@once
def indices(line: tuple[int, ...], device: str) -> Any:
    """Indices of views on a device."""
    return wp.array(np.array(line, np.int32), dtype=int, device=device)


def intensities(views: Any, index: int, valid: Any, *, scale: float, fill: float, image_out: Any) -> None:
    kernels = _copy_kernels(views.dtype._length_, views.dtype._wp_scalar_type_)
    launch_rows(kernels.intensities, [views, index, valid, scale, fill], image_out)


def line_of_views(views: Any, line: Sequence[int], *, vertical: bool, epis_out: Any) -> None:
    if views.dtype is wp.float32:  # a field is an image of one channel
        views, epis_out = (array.view(pixel_type(1)) for array in (views, epis_out))
    kernels = _copy_kernels(views.dtype._length_, views.dtype._wp_scalar_type_)
    chosen = indices(tuple(int(index) for index in line), views.device.alias)
    launch_rows(kernels.line, [views, chosen, int(vertical)], epis_out)


# The four passes of the normalisation are native code, and the Gaussian is a part of it: Warp's own loops over
# neighbours take several times as long. A thread has some pixels in line with the Gaussian at once, so that it reads
# what lies under it once for all of them; of a row it has every lanes-th, from `lane` on.

_MIRROR = """
    auto mirrored = [](int i, int size) {
        if ((unsigned)i < (unsigned)size) return i;
        i %= 2 * size;
        if (i < 0) i += 2 * size;
        return i < size ? i : 2 * size - 1 - i;
    };
    constexpr float w[] = {GAUSSIAN};
    constexpr int taps = sizeof(w) / sizeof(float), radius = taps / 2;
"""

_ROWS = (
    _MIRROR
    + """
    const int height = views.shape[1], width = views.shape[2];
    const size_t row = ((size_t)n * height + y) * width;
    const auto* __restrict__ const in = views.data + row;
    const float* __restrict__ const mask = valid.data ? valid.data + row : nullptr;
    for (int x = AT_ONCE * lane; x < width; x += AT_ONCE * lanes) {
        const bool inner = x >= radius && x + AT_ONCE <= width - radius;
        float total[AT_ONCE][CHANNELS] = {}, share[AT_ONCE] = {};
    #pragma unroll
        for (int k = 0; k < taps + AT_ONCE - 1; ++k) {
            const int i = inner ? x + k - radius : mirrored(x + k - radius, width);
            if (mask && mask[i] == 0.f) continue;
            for (int j = 0; j < AT_ONCE; ++j) {
                if (k < j || k - j >= taps) continue;
                for (int c = 0; c < CHANNELS; ++c) total[j][c] += w[k - j] * (float)in[i].c[c];
                share[j] += w[k - j];
            }
        }
        for (int j = 0; j < AT_ONCE && x + j < width; ++j) {
            for (int c = 0; c < CHANNELS; ++c) sums.data[row + x + j].c[c] = scale * total[j][c];
            if (mask) shares.data[row + x + j] = share[j];
        }
    }
"""
)

_DETAIL = (
    _MIRROR
    + """
    const int height = views.shape[1], width = views.shape[2];
    const size_t first = (size_t)n * height * width;
    const bool inner = y >= radius && y + AT_ONCE <= height - radius;
    for (int x = lane; x < width; x += lanes) {
        float total[AT_ONCE][CHANNELS] = {}, share[AT_ONCE] = {};
    #pragma unroll
        for (int k = 0; k < taps + AT_ONCE - 1; ++k) {
            const int i = inner ? y + k - radius : mirrored(y + k - radius, height);
            const size_t q = first + (size_t)i * width + x;
            const float counts = valid.data ? shares.data[q] : 1.f;
            for (int j = 0; j < AT_ONCE; ++j) {
                if (k < j || k - j >= taps) continue;
                for (int c = 0; c < CHANNELS; ++c) total[j][c] += w[k - j] * sums.data[q].c[c];
                share[j] += w[k - j] * counts;
            }
        }
        for (int j = 0; j < AT_ONCE && y + j < height; ++j) {
            const size_t q = first + (size_t)(y + j) * width + x;
            float energy = 0.f;
            for (int c = 0; c < CHANNELS; ++c) {
                float value = scale * (float)views.data[q].c[c];
                if (share[j] > LEAST) value -= total[j][c] / share[j];
                details.data[q].c[c] = value;
                energy += value * value;
            }
            energies.data[q] = energy / CHANNELS;
        }
    }
"""
)

_ENERGY_ROWS = (
    _MIRROR
    + """
    const int height = energies.shape[1], width = energies.shape[2];
    const size_t row = ((size_t)n * height + y) * width;
    const float* __restrict__ const in = energies.data + row;
    const float* __restrict__ const mask = valid.data ? valid.data + row : nullptr;
    for (int x = AT_ONCE * lane; x < width; x += AT_ONCE * lanes) {
        const bool inner = x >= radius && x + AT_ONCE <= width - radius;
        float total[AT_ONCE] = {}, share[AT_ONCE] = {};
    #pragma unroll
        for (int k = 0; k < taps + AT_ONCE - 1; ++k) {
            const int i = inner ? x + k - radius : mirrored(x + k - radius, width);
            if (mask && mask[i] == 0.f) continue;
            for (int j = 0; j < AT_ONCE; ++j) {
                if (k < j || k - j >= taps) continue;
                total[j] += w[k - j] * in[i];
                share[j] += w[k - j];
            }
        }
        for (int j = 0; j < AT_ONCE && x + j < width; ++j) {
            sums.data[row + x + j] = total[j];
            if (mask) shares.data[row + x + j] = share[j];
        }
    }
"""
)

_CONTRAST = (
    _MIRROR
    + """
    const int height = details.shape[1], width = details.shape[2];
    const size_t first = (size_t)n * height * width;
    const bool inner = y >= radius && y + AT_ONCE <= height - radius;
    for (int x = lane; x < width; x += lanes) {
        float total[AT_ONCE] = {}, share[AT_ONCE] = {};
    #pragma unroll
        for (int k = 0; k < taps + AT_ONCE - 1; ++k) {
            const int i = inner ? y + k - radius : mirrored(y + k - radius, height);
            const size_t q = first + (size_t)i * width + x;
            const float counts = valid.data ? shares.data[q] : 1.f;
            for (int j = 0; j < AT_ONCE; ++j) {
                if (k < j || k - j >= taps) continue;
                total[j] += w[k - j] * sums.data[q];
                share[j] += w[k - j] * counts;
            }
        }
        for (int j = 0; j < AT_ONCE && y + j < height; ++j) {
            const size_t q = first + (size_t)(y + j) * width + x;
            const float energy = share[j] > LEAST ? total[j] / share[j] : 0.f;
            const float contrast = sqrtf(energy + floor * floor);
            for (int c = 0; c < CHANNELS; ++c) out.data[q].c[c] = (DETAIL)(details.data[q].c[c] / contrast);
        }
    }
"""
)


@once
def _normalization_kernels(channels: int, stored: Any, detail: Any, sigma: float) -> SimpleNamespace:
    pixel, stored_pixel, detail_pixel = pixel_type(channels), pixel_type(channels, stored), pixel_type(channels, detail)
    module = f"lfgpu_normalization_{channels}_{stored.__name__}_{detail.__name__}_{sigma!r}".replace(".", "_")

    def code(text: str, sigma: float) -> str:
        for name, value in (
            ("CHANNELS", str(channels)),
            ("AT_ONCE", str(_AT_ONCE)),
            ("LEAST", f"{_LEAST_SHARE}f"),
            ("DETAIL", "wp::half" if detail is wp.float16 else "float"),
            ("GAUSSIAN", ", ".join(f"{weight:.9e}f" for weight in _gaussian(sigma))),
        ):
            text = text.replace(name, value)
        return text

    @wp.kernel(module=module, enable_backward=False)
    def scale_kernel(
        views: wp.array3d(dtype=stored_pixel), scale: float, lanes: int, detail_out: wp.array3d(dtype=detail_pixel)
    ):
        i = wp.tid()
        lane = i % lanes
        n = i / lanes / views.shape[1]
        y = i / lanes - n * views.shape[1]
        for x in range(lane, views.shape[2], lanes):
            stored_value = views[n, y, x]
            out = detail_pixel()
            for c in range(wp.static(channels)):
                out[c] = detail(scale * float(stored_value[c]))
            detail_out[n, y, x] = out

    @wp.func_native(code(_ROWS, sigma))
    def add_row(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        n: int,
        y: int,
        lane: int,
        lanes: int,
        sums: wp.array3d(dtype=pixel),
        shares: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def rows_kernel(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        lanes: int,
        sums_out: wp.array3d(dtype=pixel),
        shares_out: wp.array3d(dtype=float),
    ):
        """Gaussian sums along the rows, and how much of the Gaussian lay on valid pixels."""
        i = wp.tid()
        lane = i % lanes
        n = i / lanes / views.shape[1]
        y = i / lanes - n * views.shape[1]
        add_row(views, valid, scale, n, y, lane, lanes, sums_out, shares_out)

    @wp.func_native(code(_DETAIL, sigma))
    def subtract_mean(
        views: wp.array3d(dtype=stored_pixel),
        sums: wp.array3d(dtype=pixel),
        shares: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        scale: float,
        n: int,
        y: int,
        lane: int,
        lanes: int,
        details: wp.array3d(dtype=pixel),
        energies: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def detail_kernel(
        views: wp.array3d(dtype=stored_pixel),
        sums: wp.array3d(dtype=pixel),
        shares: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        scale: float,
        lanes: int,
        details_out: wp.array3d(dtype=pixel),
        energies_out: wp.array3d(dtype=float),
    ):
        """Gaussian sums down the columns; what the mean leaves, and its mean square over the channels."""
        i = wp.tid()
        lane = i % lanes
        down = (views.shape[1] + wp.static(_AT_ONCE - 1)) / wp.static(_AT_ONCE)
        n = i / lanes / down
        y = (i / lanes - n * down) * wp.static(_AT_ONCE)
        subtract_mean(views, sums, shares, valid, scale, n, y, lane, lanes, details_out, energies_out)

    @wp.func_native(code(_ENERGY_ROWS, 2 * sigma))
    def add_energy_row(
        energies: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        n: int,
        y: int,
        lane: int,
        lanes: int,
        sums: wp.array3d(dtype=float),
        shares: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def energy_rows_kernel(
        energies: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        lanes: int,
        sums_out: wp.array3d(dtype=float),
        shares_out: wp.array3d(dtype=float),
    ):
        i = wp.tid()
        lane = i % lanes
        n = i / lanes / energies.shape[1]
        y = i / lanes - n * energies.shape[1]
        add_energy_row(energies, valid, n, y, lane, lanes, sums_out, shares_out)

    @wp.func_native(code(_CONTRAST, 2 * sigma))
    def divide_by_contrast(
        details: wp.array3d(dtype=pixel),
        sums: wp.array3d(dtype=float),
        shares: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        floor: float,
        n: int,
        y: int,
        lane: int,
        lanes: int,
        out: wp.array3d(dtype=detail_pixel),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def contrast_kernel(
        details: wp.array3d(dtype=pixel),
        sums: wp.array3d(dtype=float),
        shares: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        floor: float,
        lanes: int,
        detail_out: wp.array3d(dtype=detail_pixel),
    ):
        """Detail in units of its contrast."""
        i = wp.tid()
        lane = i % lanes
        down = (details.shape[1] + wp.static(_AT_ONCE - 1)) / wp.static(_AT_ONCE)
        n = i / lanes / down
        y = (i / lanes - n * down) * wp.static(_AT_ONCE)
        divide_by_contrast(details, sums, shares, valid, floor, n, y, lane, lanes, detail_out)

    return SimpleNamespace(
        scale=scale_kernel,
        rows=rows_kernel,
        detail=detail_kernel,
        energy_rows=energy_rows_kernel,
        contrast=contrast_kernel,
    )


def _gaussian(sigma: float) -> NDArray[np.float64]:
    radius = int(_TRUNCATE * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / max(sigma, 1e-9)) ** 2)
    return np.asarray(weights / weights.sum())


def normalization(shape: Sequence[int], device: str, *, scale: float, sigma: float, floor: float) -> Normalization:
    (n, height, width, channels), place = shape, wp.get_device(device)
    batch = 1 if place.is_cpu else _BATCH
    size = (batch, height, width)
    if sigma > 0:
        pixel = pixel_type(channels)
        room = [
            (
                *(wp.empty(size, dtype=pixel, device=place) for _ in range(2)),
                *(wp.empty(size, dtype=float, device=place) for _ in range(3)),
            )
            for _ in slices(place, n)
        ]

    def normalize(views: Any, valid: Any, detail_out: Any) -> None:
        kernels = _normalization_kernels(
            channels, views.dtype._wp_scalar_type_, detail_out.dtype._wp_scalar_type_, sigma
        )
        threads = lanes(views)
        load(place, kernels.scale)

        across, down = -(-threads // _AT_ONCE), -(-height // _AT_ONCE)

        def launch_each(kernel: Any, rows: int, columns: int, inputs: list[Any], outputs: list[Any]) -> None:
            check_size(rows * columns)
            launch(kernel, rows * columns, [*inputs, columns], outputs, device=place)

        def some_views(k: int, first: int, last: int) -> None:
            if sigma == 0:
                launch_each(
                    kernels.scale,
                    (last - first) * height,
                    threads,
                    [views[first:last], scale],
                    [detail_out[first:last]],
                )
                return
            sums, details, shares, energy, energy_sums = room[k]
            for start in range(first, last, batch):
                end = min(start + batch, last)
                some, mask = views[start:end], None if valid is None else valid[start:end]
                launch_each(kernels.rows, (end - start) * height, across, [some, mask, scale], [sums, shares])
                launch_each(
                    kernels.detail, (end - start) * down, threads, [some, sums, shares, mask, scale], [details, energy]
                )
                launch_each(kernels.energy_rows, (end - start) * height, across, [energy, mask], [energy_sums, shares])
                inputs = [details, energy_sums, shares, mask, floor]
                launch_each(kernels.contrast, (end - start) * down, threads, inputs, [detail_out[start:end]])

        in_slices(place, n, some_views)

    return normalize
