"""Non-local-means weights on a CPU, row by row; `kernels/reference/nlm.py` says which.

For one neighbour after the other, a thread goes down the image. It adds up the distances of a row over the patches'
columns once and keeps the last few rows of these sums.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from .cost_volume import code
from .exponential import EXP
from .memory import pixel_type
from .threads import in_slices, launch, launch_rows, load, once, slices

wp.set_module_options({"enable_backward": False})

_WEIGH = (
    EXP
    + """
    const int height = features.shape[1], width = features.shape[2], rows = 2 * radius + 1, wide = width + 2 * radius;
    const size_t plane = (size_t)height * width;
    float* const distances = room.data;                  // [wide]: a row, and 0 beside it
    float* const counts = distances + wide;              // [width]: columns that patches have there
    float* const sums = counts + width;                  // [rows, width]: row y in ring place y % rows
    for (int k = 0; k < half_window.shape[0]; ++k) {
        const int dy = half_window.data[k].c[0], dx = half_window.data[k].c[1];
        const int begin = dx < 0 ? -dx : 0, end = dx < 0 ? width : width - dx, high = height - dy;
        for (int x = begin; x < end; ++x) {
            const int left = x - radius > begin ? x - radius : begin;
            const int right = x + radius < end - 1 ? x + radius : end - 1;
            counts[x] = (float)(right - left + 1);
        }
        for (int x = 0; x < wide; ++x) distances[x] = 0.f;
        float* const out = weights.data + k * plane;
        int done = 0;
        for (int y = 0; y < height; ++y) {
            float* const row = out + (size_t)y * width;
            for (int x = 0; x < width; ++x) row[x] = 0.f;
            const int top = y - radius > 0 ? y - radius : 0, bottom = y + radius < high - 1 ? y + radius : high - 1;
            for (; done <= bottom; ++done) {
                const float* const here = features.data + (size_t)done * width;
                const float* const there = here + (long long)dy * width + dx;
                float* const distance = distances + radius;
                #pragma clang loop vectorize(assume_safety)
                for (int x = begin; x < end; ++x) {
                    float sum = 0.f;
                    #pragma unroll
                    for (int c = 0; c < FEATURES; ++c) {
                        const float difference = here[c * plane + x] - there[c * plane + x];
                        sum += difference * difference;
                    }
                    distance[x] = sum;
                }
                float* const sum = sums + (size_t)(done % rows) * width;
                for (int x = begin; x < end; ++x) sum[x] = distances[x];
                for (int i = 1; i < rows; ++i)
                    #pragma clang loop vectorize(assume_safety)
                    for (int x = begin; x < end; ++x) sum[x] += distances[x + i];
            }
            if (y >= high) continue;
            for (int r = top; r <= bottom; ++r) {
                const float* const sum = sums + (size_t)(r % rows) * width;
                #pragma clang loop vectorize(assume_safety)
                for (int x = begin; x < end; ++x) row[x] += sum[x];
            }
            const float tall = (float)(bottom - top + 1);
            #pragma clang loop vectorize(assume_safety)
            for (int x = begin; x < end; ++x) {
                const float weight = exp_of(is_mean ? -row[x] / (tall * counts[x]) : -row[x]);
                row[x] = weight > least ? weight : least;
            }
        }
    }
"""
)


@once
def _kernels(channels: int) -> SimpleNamespace:
    pixel, module = pixel_type(channels), f"lfgpu_cpu_nlm_{channels}"

    @wp.kernel(module=module, enable_backward=False)
    def features_kernel(
        image: wp.array2d(dtype=pixel),
        color: float,
        gradient: float,
        row: int,
        lanes: int,
        features_out: wp.array3d(dtype=float),
    ):
        """Colour and its central differences in x and y, times `color` and `gradient`, as planes."""
        y = row + wp.tid()
        height = image.shape[0]
        width = image.shape[1]
        for x in range(width):
            here = image[y, x] * color
            across = image[y, wp.min(x + 1, width - 1)] - image[y, wp.max(x - 1, 0)]
            down = image[wp.min(y + 1, height - 1), x] - image[wp.max(y - 1, 0), x]
            for c in range(wp.static(channels)):
                features_out[c, y, x] = here[c]
                features_out[c + wp.static(channels), y, x] = 0.5 * gradient * across[c]
                features_out[c + wp.static(2 * channels), y, x] = 0.5 * gradient * down[c]

    @wp.func_native(code(_WEIGH, FEATURES=3 * channels))
    def weigh(
        features: wp.array3d(dtype=float),
        half_window: wp.array(dtype=wp.vec2i),
        radius: int,
        least: float,
        is_mean: int,
        room: wp.array(dtype=float),
        weights: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def weights_kernel(
        features: wp.array3d(dtype=float),
        half_window: wp.array(dtype=wp.vec2i),
        radius: int,
        least: float,
        is_mean: int,
        room: wp.array(dtype=float),
        weights_out: wp.array3d(dtype=float),
    ):
        weigh(features, half_window, radius, least, is_mean, room, weights_out)

    return SimpleNamespace(features=features_kernel, weights=weights_kernel)


class CpuWeights:
    """Weights of images [y, x, c] of one size, at the places `steps` of a half window.

    Parameters
    ----------
    color, gradient
        What colours and their differences are multiplied by.
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        steps: Any,
        *,
        patch: int,
        color: float,
        gradient: float,
        floor: float,
        is_mean: bool,
    ) -> None:
        height, width, channels = shape
        self._kernels, self._steps = _kernels(channels), steps
        self._factors, self._numbers = [color, gradient], [patch // 2, floor, int(is_mean)]
        self._features = wp.empty((3 * channels, height, width), dtype=float, device="cpu")
        size = width + 2 * (patch // 2) + (1 + patch) * width
        self._room = wp.empty((len(slices(steps.device, len(steps))), size), dtype=float, device="cpu")

    def __call__(self, image: Any, weights_out: Any) -> None:
        kernels, features, device = self._kernels, self._features, image.device
        launch_rows(kernels.features, [image, *self._factors], features)
        load(device, kernels.weights)

        def some_neighbors(part: int, first: int, last: int) -> None:
            inputs = [features, self._steps[first:last], *self._numbers, self._room[part]]
            launch(kernels.weights, 1, inputs, [weights_out[first:last]], device=device)

        in_slices(device, len(self._steps), some_neighbors)
