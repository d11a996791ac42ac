"""Preparation of views: intensities, lines of views, local contrast normalisation.

`kernels/reference/views.py` says what the last is.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import taichi as ti

from .memory import DeviceArray, empty, field, flat, indices, operation, optional
from .runtime import on_cpu, once, run, start

_TRUNCATE = 2.5  # Gaussians end after as many standard deviations
_LEAST_SHARE = 1e-6  # of a Gaussian that must lie on valid pixels
_TOGETHER = 8  # views at a time on a GPU, one on a CPU
_BLOCK = 16  # values of a Gaussian sum at a time on a CPU, which its vector units add up together


@once
def _intensities_kernel(channels: int, stored: Any) -> Any:
    @ti.kernel
    def intensities_kernel(
        views: flat(stored, channels),
        index: int,
        valid: flat(),
        has_valid: ti.template(),
        scale: float,
        fill: float,
        height: int,
        width: int,
        image_out: flat(channels=channels),
    ):
        for p in range(image_out.shape[0]):
            place = index * image_out.shape[0] + p
            value = scale * ti.cast(views[place], ti.f32)
            if ti.static(has_valid):
                if valid[place] == 0.0:
                    total, sides, y, x = ti.Vector([0.0] * channels), 0.0, p // width, p % width
                    for across in ti.static((True, False)):
                        step = 1 if across else width
                        if 0 < x < width - 1 if across else 0 < y < height - 1:
                            if valid[place - step] != 0.0 and valid[place + step] != 0.0:
                                total += ti.cast(views[place - step], ti.f32) + ti.cast(views[place + step], ti.f32)
                                sides += 2.0
                    value = ti.Vector([fill] * channels)
                    if sides > 0.0:
                        value = scale * total / sides
            image_out[p] = value

    return intensities_kernel


intensities = operation(_intensities_kernel, "channels", "scalar")


@once
def _line_kernel(channels: int, stored: Any) -> Any:
    views_type = flat(stored, channels)

    @ti.kernel
    def line_kernel(
        views: views_type,
        line: flat(ti.i32),
        rows: int,
        columns: int,
        height: int,
        width: int,
        vertical: int,
        top: int,
        left: int,
        epis_out: views_type,
    ):
        """Copy views of `rows` and `columns` to their places in the line; EPIs have `height` and `width`."""
        for i in range(epis_out.shape[0]):
            y = i // width % height
            x = i % width
            if vertical == 1:
                y, x = x, y
            epis_out[i] = views[(line[i // (height * width)] * rows + y + top) * columns + x + left]

    return line_kernel


def line_of_views(
    views: DeviceArray,
    line: Sequence[int],
    *,
    vertical: bool,
    epis_out: DeviceArray,
    corner: tuple[int, int] = (0, 0),
) -> None:
    kernel = _line_kernel(views.channels, views.scalar)
    run(kernel, views, indices(tuple(line)), *views.shape[1:], *epis_out.shape[1:], int(vertical), *corner, epis_out)


@ti.func
def mirrored(i: int, size: int):
    """Compute the pixel that stands for pixel `i` of a row that is mirrored at its ends, again and again."""
    j = i
    if i < 0 or i >= size:
        j = (i % (2 * size) + 2 * size) % (2 * size)
        j = ti.min(j, 2 * size - 1 - j)
    return j


@once
def _gaussian_kernel(block: int) -> Any:
    """Return the kernel in which a thread computes `block` values that lie one after the other."""

    @ti.kernel
    def gaussian_kernel(values: flat(), weights: flat(), count: int, size: int, stride: int, sums_out: flat()):
        """Weighted sums along lines of `size` values that are `stride` apart."""
        radius = weights.shape[0] // 2
        for b in range((count + block - 1) // block):
            first = b * block
            last = first + block - 1
            one_line = last < count and first // (size * stride) == last // (size * stride)
            if one_line and first // stride % size >= radius and last // stride % size + radius < size:
                total = ti.Vector([0.0] * block)
                for k in range(2 * radius + 1):
                    other = first + (k - radius) * stride
                    for n in ti.static(range(block)):
                        total[n] += weights[k] * values[other + n]
                for n in ti.static(range(block)):
                    sums_out[first + n] = total[n]
            else:
                for p in range(first, ti.min(last + 1, count)):
                    i = p // stride % size
                    sum_here = 0.0
                    for k in range(2 * radius + 1):
                        sum_here += weights[k] * values[p + (mirrored(i + k - radius, size) - i) * stride]
                    sums_out[p] = sum_here

    return gaussian_kernel


@once
def _normalization_kernels(channels: int, stored: Any, detail: Any, masked: bool) -> SimpleNamespace:
    """Run the passes of the normalisation. A mask is one more channel: its sum is the valid share of the Gaussian."""
    views_type, detail_type, pixels = flat(stored, channels), flat(detail, channels), flat(channels=channels)
    pixel, colors, energies = ti.types.vector(channels, ti.f32), channels + masked, 1 + masked

    @ti.func
    def counts(valid: ti.template(), i: int):
        result = True
        if ti.static(masked):
            result = valid[i] != 0.0
        return result

    @ti.func
    def inverse_share(sums: ti.template(), i: int):
        """Return the factor that makes a sum a mean, from the share that lies at `i`."""
        result = 1.0
        if ti.static(masked):
            result = 0.0
            if sums[i] > _LEAST_SHARE:
                result = 1.0 / sums[i]
        return result

    @ti.kernel
    def scale_kernel(views: views_type, scale: float, detail_out: detail_type):
        for p in range(views.shape[0]):
            detail_out[p] = ti.cast(scale * ti.cast(views[p], ti.f32), detail)

    @ti.kernel
    def load_kernel(views: views_type, valid: flat(), scale: float, first: int, count: int, colors_out: flat()):
        for p in range(count):
            value = pixel(0.0)
            if counts(valid, first + p):
                value = scale * ti.cast(views[first + p], ti.f32)
            for c in ti.static(range(channels)):
                colors_out[p * colors + c] = value[c]
            if ti.static(masked):
                colors_out[p * colors + channels] = ti.cast(counts(valid, first + p), ti.f32)

    @ti.kernel
    def detail_kernel(
        views: views_type,
        valid: flat(),
        scale: float,
        first: int,
        count: int,
        color_sums: flat(),
        details_out: pixels,
        energies_out: flat(),
    ):
        """Compute the detail that the local mean leaves, and its mean square over the channels."""
        for p in range(count):
            value = scale * ti.cast(views[first + p], ti.f32)
            for c in ti.static(range(channels)):
                value[c] -= color_sums[p * colors + c] * inverse_share(color_sums, p * colors + channels)
            details_out[p] = value
            energy = 0.0
            if counts(valid, first + p):
                energy = value.norm_sqr() / channels
            energies_out[p * energies] = energy
            if ti.static(masked):
                energies_out[p * energies + 1] = ti.cast(counts(valid, first + p), ti.f32)

    @ti.kernel
    def contrast_kernel(
        details: pixels, energy_sums: flat(), floor: float, first: int, count: int, detail_out: detail_type
    ):
        """Detail in units of the local contrast."""
        for p in range(count):
            energy = energy_sums[p * energies] * inverse_share(energy_sums, p * energies + 1)
            detail_out[first + p] = ti.cast(details[p] / ti.sqrt(energy + floor * floor), detail)

    return SimpleNamespace(scale=scale_kernel, load=load_kernel, detail=detail_kernel, contrast=contrast_kernel)


def _gaussian(sigma: float, device: str) -> DeviceArray:
    radius = int(_TRUNCATE * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return field(weights / weights.sum(), device)


class normalization:
    """Some views at a time, so that what lies between two kernels stays in a cache."""

    def __init__(self, shape: Sequence[int], device: str, *, scale: float, sigma: float, floor: float) -> None:
        start(device)
        self._n, self._height, self._width, self._channels = shape
        self._scale, self._sigma, self._floor = scale, sigma, floor
        self._together = 1 if on_cpu() else min(_TOGETHER, self._n)
        self._gaussian = _gaussian_kernel(_BLOCK if on_cpu() else 1)
        if sigma > 0:
            self._narrow, self._wide = _gaussian(sigma, device), _gaussian(2 * sigma, device)
            some = self._together * self._height * self._width
            self._details = empty((some,), channels=self._channels)
            # A mask is one channel more.
            self._colors, self._sums = (empty((some * (self._channels + 1),)) for _ in range(2))
            self._energies = empty((some * 2,))

    def __call__(self, views: DeviceArray, valid: DeviceArray | None, detail_out: DeviceArray) -> None:
        kernels = _normalization_kernels(self._channels, views.scalar, detail_out.scalar, valid is not None)
        if self._sigma == 0:
            run(kernels.scale, views, self._scale, detail_out)
            return
        mask, masked = optional(valid)
        details, colors, energies = self._details, self._colors, self._energies
        for n in range(0, self._n, self._together):
            size = self._height * self._width
            these = n * size, min(self._together, self._n - n) * size
            image = views, mask, self._scale, *these
            run(kernels.load, *image, colors)
            self._blur(self._colors, self._narrow, these[1], self._channels + masked)
            run(kernels.detail, *image, colors, details, energies)
            self._blur(self._energies, self._wide, these[1], 1 + masked)
            run(kernels.contrast, details, energies, self._floor, *these, detail_out)

    def _blur(self, values: DeviceArray, weights: DeviceArray, pixels: int, channels: int) -> None:
        """Gaussian sums down the columns and along the rows, in place of the values."""
        count, sums = pixels * channels, self._sums
        run(self._gaussian, values, weights, count, self._height, self._width * channels, sums)
        run(self._gaussian, sums, weights, count, self._width, channels, values)
