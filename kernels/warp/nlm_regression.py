"""Sums with non-local-means weights that also depend on a map: a ratio, a plane; `kernels/reference` says which."""

from typing import Any

import warp as wp

from .nlm import launch_pixels, place_in_block, window_on
from .threads import launch_rows, once

wp.set_module_options({"enable_backward": False})

# The sums are native code like those of the operators in `nlm.py`. On a CPU a row goes in chunks, whose sums lie on the
# stack. On a GPU each warp of a block has one row of the half window.

_BY_ROW = """
    constexpr int CHUNK = 128;
    const int height = weights.shape[1], width = weights.shape[2], size = height * width, row = y * width;
    const float weaken = 1.f / (support * support);
FIELDS
    for (int begin = 0; begin < width; begin += CHUNK) {
        const int end = wp::min(begin + CHUNK, width);
START
        for (int k = 0; k < steps.shape[0]; ++k)
            for (int sign = 1; sign >= -1; sign -= 2) {
                const int dy = sign * steps.data[k].c[0], dx = sign * steps.data[k].c[1];
                if ((unsigned)(y + dy) >= (unsigned)height) continue;
                const int first = wp::max(begin, -dx), last = wp::min(end, width - dx), other = row + dy * width + dx;
                // Of a pair the second pixel finds the weight at the first.
                const float* __restrict__ const w = weights.data + (size_t)k * size + (sign > 0 ? row : other);
ADD
            }
FINISH
    }
"""

_OF_PIXEL = """
        const float* w = weights.data + ((long long)dy * (2 * RADIUS + 1) - RADIUS - 1) * (long long)size + p;
    #pragma unroll
        for (int dx = -RADIUS; dx <= RADIUS; ++dx, w += size) {
            if (dy == 0 && dx <= 0) continue;
            const int step = dy * width + dx;
            if (y + dy < height && (unsigned)(x + dx) < (unsigned)width) add(w[0], p + step, dx, dy);
            if (y >= dy && (unsigned)(x - dx) < (unsigned)width) add(w[-step], p - step, -dx, -dy);
        }
"""


def _by_row(fields: str, start: str, add: str, finish: str) -> str:
    """The code of one row on a CPU.

    Pointers to `fields`; then for each chunk of pixels, from `begin` to `end`, how sums `start`, what is to `add`
    of the neighbours of the pixels from `first` to `last`, and how sums `finish` as results.
    """
    parts = {"FIELDS": fields, "START": start, "ADD": add, "FINISH": finish}
    code = _BY_ROW
    for name, part in parts.items():
        code = code.replace(f"{name}\n", part.strip("\n").rstrip() + "\n")
    return code


def _of_pixel(code: str, radius: int) -> str:
    """The code with its loop over the neighbours of a pixel in one row of the half window, on a GPU."""
    return code.replace("OF_PIXEL", _OF_PIXEL).replace("RADIUS", str(radius))


_RATIO_ROW = _by_row(
    """
    const float* __restrict__ const g = guide.data;
    const float* __restrict__ const a = numerator.data;
    const float* __restrict__ const b = denominator.data;
""",
    """
        float above[CHUNK], below[CHUNK];
        for (int x = begin; x < end; ++x) {
            above[x - begin] = a[row + x];
            below[x - begin] = b[row + x] + floor;
        }
""",
    """
                for (int x = first; x < last; ++x) {
                    const float apart = g[other + x] - g[row + x], v = w[x] / (1.f + apart * apart * weaken);
                    above[x - begin] += v * a[other + x];
                    below[x - begin] += v * (b[other + x] + floor);
                }
""",
    """
        for (int x = begin; x < end; ++x) ratio.data[row + x] = above[x - begin] / below[x - begin];
""",
)


@wp.func_native(_RATIO_ROW)
def _divide_row(
    weights: wp.array3d(dtype=float),
    guide: wp.array2d(dtype=float),
    numerator: wp.array2d(dtype=float),
    denominator: wp.array2d(dtype=float),
    steps: wp.array(dtype=wp.vec2i),
    support: float,
    floor: float,
    y: int,
    ratio: wp.array2d(dtype=float),
): ...


@wp.kernel
def _ratio_kernel(
    weights: wp.array3d(dtype=float),
    guide: wp.array2d(dtype=float),
    numerator: wp.array2d(dtype=float),
    denominator: wp.array2d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    support: float,
    floor: float,
    row: int,
    lanes: int,
    ratio_out: wp.array2d(dtype=float),
):
    y = row + wp.tid()
    _divide_row(weights, guide, numerator, denominator, half_window, support, floor, y, ratio_out)


_PIXEL_RATIO = """
    __shared__ float above[RADIUS + 1][32], below[RADIUS + 1][32];
    const int height = guide.shape[0], width = guide.shape[1], p = y * width + x;
    const size_t size = (size_t)height * width;
    const float* const g = guide.data;
    const float* const a = numerator.data;
    const float* const b = denominator.data;
    const float weaken = 1.f / (support * support);
    float upper = 0.f, lower = 0.f;
    if (x < width) {
        const float here = g[p];
        auto add = [&](float weight, int q, int, int) {
            const float apart = g[q] - here, v = weight / (1.f + apart * apart * weaken);
            upper += v * a[q];
            lower += v * (b[q] + floor);
        };
        OF_PIXEL
    }
    above[dy][lane] = upper;
    below[dy][lane] = lower;
    __syncthreads();
    if (dy == 0 && x < width) {
        upper = a[p];
        lower = b[p] + floor;
        for (int row = 0; row <= RADIUS; ++row) {
            upper += above[row][lane];
            lower += below[row][lane];
        }
        ratio.data[p] = upper / lower;
    }
"""


@once
def _gpu_ratio(radius: int) -> Any:
    @wp.func_native(_of_pixel(_PIXEL_RATIO, radius))
    def divide_pixel(
        weights: wp.array3d(dtype=float),
        guide: wp.array2d(dtype=float),
        numerator: wp.array2d(dtype=float),
        denominator: wp.array2d(dtype=float),
        support: float,
        floor: float,
        y: int,
        x: int,
        dy: int,
        lane: int,
        ratio: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_gpu_ratio_{radius}", enable_backward=False)
    def ratio_kernel(
        weights: wp.array3d(dtype=float),
        guide: wp.array2d(dtype=float),
        numerator: wp.array2d(dtype=float),
        denominator: wp.array2d(dtype=float),
        support: float,
        floor: float,
        ratio_out: wp.array2d(dtype=float),
    ):
        y, x, dy, lane = place_in_block(wp.tid(), wp.static(radius + 1), guide.shape[1])
        divide_pixel(weights, guide, numerator, denominator, support, floor, y, x, dy, lane, ratio_out)

    return ratio_kernel


def nlm_ratio(
    weights: Any,
    guide: Any,
    numerator: Any,
    denominator: Any,
    *,
    window: int,
    support: float,
    floor: float,
    ratio_out: Any,
) -> None:
    device, fields = guide.device, [weights, guide, numerator, denominator]
    if device.is_cpu:
        launch_rows(_ratio_kernel, [*fields, window_on(window, device.alias), support, floor], ratio_out)
    else:
        launch_pixels(_gpu_ratio(window // 2), [*fields, support, floor], window, ratio_out)


# The plane is a regression about the middle of what counts; its ridge draws slopes to 0 that the window cannot tell.

_PLANE_AT = """
    auto plane_at = [&](float value, const float* s) {
        const float inverse = 1.f / s[0], x = s[1] * inverse, y = s[2] * inverse, middle = s[6] * inverse;
        const float xx = s[3] * inverse - x * x + ridge, xy = s[4] * inverse - x * y;
        const float yy = s[5] * inverse - y * y + ridge;
        const float along_x = s[7] * inverse - x * middle, along_y = s[8] * inverse - y * middle;
        const float determinant = 1.f / (xx * yy - xy * xy);
        const float slope_x = (along_x * yy - along_y * xy) * determinant;
        const float slope_y = (along_y * xx - along_x * xy) * determinant;
        return value + middle - slope_x * x - slope_y * y;
    };
"""

_PLANE_ROW = _by_row(
    """
    const float* __restrict__ const d = values.data;
    const float* __restrict__ const c = certainty.data;
""",
    """
        float total[CHUNK], sx[CHUNK], sy[CHUNK], sxx[CHUNK], sxy[CHUNK], syy[CHUNK], sd[CHUNK], sxd[CHUNK], syd[CHUNK];
        for (int j = 0; j < end - begin; ++j) {
            total[j] = c[row + begin + j];
            sx[j] = sy[j] = sxx[j] = sxy[j] = syy[j] = sd[j] = sxd[j] = syd[j] = 0.f;
        }
""",
    """
                const float fx = (float)dx, fy = (float)dy;
                #pragma clang loop vectorize(assume_safety)
                for (int x = first; x < last; ++x) {
                    const int j = x - begin;
                    const float apart = d[other + x] - d[row + x];
                    const float u = w[x] * c[other + x] / (1.f + apart * apart * weaken), ud = u * apart;
                    total[j] += u;
                    sx[j] += fx * u;
                    sy[j] += fy * u;
                    sxx[j] += fx * fx * u;
                    sxy[j] += fx * fy * u;
                    syy[j] += fy * fy * u;
                    sd[j] += ud;
                    sxd[j] += fx * ud;
                    syd[j] += fy * ud;
                }
""",
    """
        for (int j = 0; j < end - begin; ++j) {
            const float sums[9] = {total[j], sx[j], sy[j], sxx[j], sxy[j], syy[j], sd[j], sxd[j], syd[j]};
            plane.data[row + begin + j] = plane_at(d[row + begin + j], sums);
        }
""",
)


@wp.func_native(_PLANE_AT + _PLANE_ROW)
def _plane_row(
    weights: wp.array3d(dtype=float),
    values: wp.array2d(dtype=float),
    certainty: wp.array2d(dtype=float),
    steps: wp.array(dtype=wp.vec2i),
    support: float,
    ridge: float,
    y: int,
    plane: wp.array2d(dtype=float),
): ...


@wp.kernel
def _plane_kernel(
    weights: wp.array3d(dtype=float),
    values: wp.array2d(dtype=float),
    certainty: wp.array2d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    support: float,
    ridge: float,
    row: int,
    lanes: int,
    plane_out: wp.array2d(dtype=float),
):
    y = row + wp.tid()
    _plane_row(weights, values, certainty, half_window, support, ridge, y, plane_out)


_PIXEL_PLANE = """
    __shared__ float parts[RADIUS + 1][9][32];
    const int height = values.shape[0], width = values.shape[1], p = y * width + x;
    const size_t size = (size_t)height * width;
    const float* const d = values.data;
    const float* const c = certainty.data;
    const float weaken = 1.f / (support * support);
    float sums[9] = {};
    if (x < width) {
        const float here = d[p];
        auto add = [&](float weight, int q, float fx, float fy) {
            const float apart = d[q] - here, u = weight * c[q] / (1.f + apart * apart * weaken), ud = u * apart;
            sums[0] += u;
            sums[1] += fx * u;
            sums[2] += fy * u;
            sums[3] += fx * fx * u;
            sums[4] += fx * fy * u;
            sums[5] += fy * fy * u;
            sums[6] += ud;
            sums[7] += fx * ud;
            sums[8] += fy * ud;
        };
        OF_PIXEL
    }
    for (int i = 0; i < 9; ++i) parts[dy][i][lane] = sums[i];
    __syncthreads();
    if (dy == 0 && x < width) {
        sums[0] += c[p];
        for (int row = 1; row <= RADIUS; ++row)
            for (int i = 0; i < 9; ++i) sums[i] += parts[row][i][lane];
        plane.data[p] = plane_at(d[p], sums);
    }
"""


@once
def _gpu_plane(radius: int) -> Any:
    @wp.func_native(_PLANE_AT + _of_pixel(_PIXEL_PLANE, radius))
    def plane_pixel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        certainty: wp.array2d(dtype=float),
        support: float,
        ridge: float,
        y: int,
        x: int,
        dy: int,
        lane: int,
        plane: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_gpu_plane_{radius}", enable_backward=False)
    def plane_kernel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        certainty: wp.array2d(dtype=float),
        support: float,
        ridge: float,
        plane_out: wp.array2d(dtype=float),
    ):
        y, x, dy, lane = place_in_block(wp.tid(), wp.static(radius + 1), values.shape[1])
        plane_pixel(weights, values, certainty, support, ridge, y, x, dy, lane, plane_out)

    return plane_kernel


def nlm_plane(
    weights: Any, values: Any, certainty: Any, *, window: int, support: float, ridge: float, plane_out: Any
) -> None:
    device, fields = values.device, [weights, values, certainty]
    if device.is_cpu:
        launch_rows(_plane_kernel, [*fields, window_on(window, device.alias), support, ridge], plane_out)
    else:
        launch_pixels(_gpu_plane(window // 2), [*fields, support, ridge], window, plane_out)


@wp.kernel
def _on_surface_kernel(
    weights: wp.array3d(dtype=float),
    guide: wp.array2d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    weaken: float,
    row: int,
    lanes: int,
    weights_out: wp.array3d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    lane = i % lanes
    for k in range(weights.shape[0]):
        step = half_window[k]
        for x in range(lane, guide.shape[1], lanes):
            qy = y + step[0]
            qx = x + step[1]
            weight = float(0.0)
            if qy < guide.shape[0] and qx >= 0 and qx < guide.shape[1]:
                apart = guide[qy, qx] - guide[y, x]
                weight = weights[k, y, x] / (1.0 + apart * apart * weaken)
            weights_out[k, y, x] = weight


def nlm_on_surface(weights: Any, guide: Any, *, window: int, support: float, weights_out: Any) -> None:
    steps = window_on(window, guide.device.alias)
    launch_rows(_on_surface_kernel, [weights, guide, steps, 1 / support**2], weights_out)
