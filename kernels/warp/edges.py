"""Weights that are small beside steps in brightness; `kernels/reference/edges.py` says which."""

from typing import Any

import warp as wp

from .cost_volume import code
from .memory import pixel_type
from .threads import launch_rows, once

wp.set_module_options({"enable_backward": False})

_ROW = """
    constexpr int ROOM = 256, MOST = ROOM - 2 * REACH;
    const int height = image.shape[0], width = image.shape[1];
    const int top = wp::max(y - REACH, 0), bottom = wp::min(y + REACH, height - 1);
    auto step_between = [](const auto& one, const auto& other) {
        float size = 0.f;
        for (int c = 0; c < CHANNELS; ++c) size += wp::abs(one.c[c] - other.c[c]);
        return size / CHANNELS;
    };
    // Down the columns first, and then along the row.
    float beside[ROOM], below[ROOM];
    for (int begin = 0; begin < width; begin += MOST) {
        const int from = wp::max(begin - REACH, 0), many = wp::min(begin + MOST + REACH, width) - from;
        for (int k = 0; k < many; ++k) beside[k] = below[k] = 0.f;
        for (int v = top; v <= bottom; ++v) {
            const auto* const row = image.data + (size_t)v * width + from;
            for (int k = 0; k < many - 1; ++k) beside[k] = wp::max(beside[k], step_between(row[k], row[k + 1]));
            if (v < bottom)
                for (int k = 0; k < many; ++k) below[k] = wp::max(below[k], step_between(row[k], row[k + width]));
        }
        for (int x = begin; x < wp::min(begin + MOST, width); ++x) {
            const int left = wp::max(x - REACH, 0) - from, right = wp::min(x + REACH, width - 1) - from;
            float largest = below[right];
            for (int k = left; k < right; ++k) largest = wp::max(largest, wp::max(beside[k], below[k]));
            const float share = largest / contrast;
            weights.data[(size_t)y * width + x] = weight / (1.f + share * share);
        }
    }
"""

_PIXEL = """
    const int height = image.shape[0], width = image.shape[1], x = lane;
    const int left = max(x - REACH, 0), right = min(x + REACH, width - 1);
    const int top = max(y - REACH, 0), bottom = min(y + REACH, height - 1);
    auto step_between = [&](int p, int q) {
        float size = 0.f;
        for (int c = 0; c < CHANNELS; ++c) size += fabsf(image.data[p].c[c] - image.data[q].c[c]);
        return size / CHANNELS;
    };
    float largest = 0.f;
    for (int v = top; v <= bottom; ++v)
        for (int u = left; u <= right; ++u) {
            const int p = v * width + u;
            if (u < right) largest = fmaxf(largest, step_between(p, p + 1));
            if (v < bottom) largest = fmaxf(largest, step_between(p, p + width));
        }
    const float share = largest / contrast;
    weights.data[y * width + x] = weight / (1.f + share * share);
"""


@once
def _kernel(channels: int, reach: int, on_cpu: bool) -> Any:
    pixel = pixel_type(channels)

    @wp.func_native(code(_ROW if on_cpu else _PIXEL, CHANNELS=channels, REACH=reach))
    def weigh_row(
        image: wp.array2d(dtype=pixel),
        weight: float,
        contrast: float,
        y: int,
        lane: int,
        weights: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_{'cpu' if on_cpu else 'gpu'}_edges_{reach}_{channels}", enable_backward=False)
    def weigh_kernel(
        image: wp.array2d(dtype=pixel),
        weight: float,
        contrast: float,
        row: int,
        lanes: int,
        weights_out: wp.array2d(dtype=float),
    ):
        i = wp.tid()
        line = i / lanes
        weigh_row(image, weight, contrast, row + line, i - line * lanes, weights_out)

    return weigh_kernel


def weigh_edges(image: Any, weight: float, contrast: float, reach: int, weights_out: Any) -> None:
    """`weight` times `edge_weights`."""
    kernel = _kernel(image.dtype._length_, reach, image.device.is_cpu)
    launch_rows(kernel, [image, weight, contrast], weights_out)


def edge_weights(image: Any, *, contrast: float, reach: int, weights_out: Any) -> None:
    weigh_edges(image, 1.0, contrast, reach, weights_out)
