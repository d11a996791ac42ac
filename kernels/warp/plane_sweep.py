"""How well the views agree with the reference view at each of a row of disparities.

`PlaneSweep` in `lfgpu/contract` says what is computed. At one disparity all pixels of a view are shifted alike: rows
are interpolated as a whole, with the same weights everywhere. Views that belong to the same view_sets are added up
first, and then once to each of these. The plan keeps the views in an order of its own: on a CPU row by row in each
channel, what the compiler makes vectors of; `gpu_plane_sweep.py` has the kernels of a GPU.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import PlaneSweep, sweep_shifts

from .gpu_plane_sweep import BLOCK, kept_type, pack_kernel, sweep_kernel, threads_of
from .memory import pixel_type
from .threads import in_slices, launch, load, once, slices

wp.set_module_options({"enable_backward": False})

_LEAST_OFFSET = 1e-3  # view steps; what is nearer to the reference view is the reference view
_PENALTY = 1e-4  # of all view_sets but the first, besides their preference
_STRIP = 16  # rows of sums that stay in a cache of a CPU
_SURFACES = 2  # past which views see a pixel, at most: the nearest one, and what is certain of it

_SWEEP = """
    const int height = image.shape[1], width = image.shape[2], views_there = order.shape[0];
    const int labels = volume.shape[0], wide = width + 2;
    const float fade = 1.f / (1.f + gradient_weight);
    const float most = fade * (truncation + gradient_weight * gradient_truncation);
    const size_t plane = (size_t)height * width, strip = (size_t)STRIP * width;
    float* const differences = room.data;                             // [3, CHANNELS, wide], row y in ring place y % 3
    float* const levels = differences + (size_t)3 * CHANNELS * wide;  // [2, CHANNELS, width], between two columns
    float* const group = levels + (size_t)2 * CHANNELS * width;       // [2, STRIP, width]: cost and count
    float* const sums = group + 2 * strip;                            // [view_sets, 2, STRIP, width]
    const bool seen = nearest.data;                                   // the sums are those past each surface
    auto least_of = [](auto a, auto b) { return a < b ? a : b; };
    auto size_of = [](float a) { return a < 0.f ? -a : a; };
    auto within = [](int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; };

    for (int top = first; top < last; top += STRIP)
    for (int l = 0; l < labels; ++l) {
        const int bottom = top + STRIP < last ? top + STRIP : last;
        for (size_t i = 0; i < view_sets * 2 * strip; ++i) sums[i] = 0.f;
        for (int k = 0; k < views_there; ++k) {
            if (k == 0 || members.data[k] != members.data[k - 1])
                for (size_t i = 0; i < 2 * strip; ++i) group[i] = 0.f;

            const int n = order.data[k];
            const auto shift = shifts.data[l * views_there + k];
            const int dx = (int)shift.c[0], dy = (int)shift.c[1];
            const float ax = shift.c[2], ay = shift.c[3];
            const int left = dx < 0 ? -dx : 0, right = least_of(width, width - dx - (ax > 0.f));
            const int begin = top > -dy ? top : -dy, end = least_of(bottom, height - dy - (ay > 0.f));
            int held[3] = {-1, -1, -1}, held_levels[2] = {-1, -1};

            auto level = [&](int t) {
                float* const result = levels + (size_t)(t & 1) * CHANNELS * width;
                if (held_levels[t & 1] == t) return result;
                held_levels[t & 1] = t;
                // Both neighbours of what is interpolated are there, but for the last column of a whole shift.
                const int inner = width - 1 - dx < width ? width - 1 - dx : width;
                for (int c = 0; c < CHANNELS; ++c) {
                    const auto* const row = views.data + ((size_t)n * CHANNELS + c) * plane + (size_t)t * width;
                    float* const out = result + (size_t)c * width;
                    for (int x = 0; x < left; ++x) out[x] = (float)row[0];
                    #pragma clang loop vectorize(assume_safety)
                    for (int x = left; x < inner; ++x) {
                        const float here = (float)row[x + dx];
                        out[x] = here + ax * ((float)row[x + dx + 1] - here);
                    }
                    for (int x = inner > left ? inner : left; x < width; ++x) out[x] = (float)row[width - 1];
                }
                return result;
            };
            auto difference = [&](int y) {
                float* const result = differences + (size_t)(y % 3) * CHANNELS * wide + 1;
                if (held[y % 3] == y) return result;
                held[y % 3] = y;
                const float* const upper = level(within(y + dy, height));
                const float* const lower = level(within(y + dy + 1, height));
                for (int c = 0; c < CHANNELS; ++c) {
                    const float* const u = upper + (size_t)c * width;
                    const float* const d = lower + (size_t)c * width;
                    const float* const color = image.data + c * plane + (size_t)y * width;
                    float* const out = result + (size_t)c * wide;
                    #pragma clang loop vectorize(assume_safety)
                    for (int x = 0; x < width; ++x) out[x] = scale * (u[x] + ay * (d[x] - u[x])) - color[x];
                    out[-1] = out[0];
                    out[width] = out[width - 1];
                }
                return result;
            };

            if (left < right) for (int y = begin; y < end; ++y) {
                const float* const above = difference(y > 0 ? y - 1 : y);
                const float* const here = difference(y);
                const float* const below = difference(y + 1 < height ? y + 1 : y);
                const size_t near = (size_t)n * plane + (size_t)(y + dy + (ay >= 0.5f)) * width;
                const int near_x = dx + (ax >= 0.5f);
                const float* const mask = valid.data + near;
                const float* const surface = nearest.data + near;
                const float* const sure = certain.data + near;
                const float deepest = limits.data[l];
                float* const cost = (seen ? sums : group) + (size_t)(y - top) * width;
                float* const count = cost + strip;
                float* const past_cost = cost + 2 * strip;
                float* const past_count = cost + 3 * strip;
                struct One { enum { both = 0 }; };
                struct Both { enum { both = 1 }; };
                auto add = [&](auto surfaces, auto takes_part, auto sees, auto past) {
                    #pragma clang loop vectorize(assume_safety)
                    for (int x = left; x < right; ++x) {
                        float color = 0.f, slope = 0.f;
                        #pragma unroll
                        for (int c = 0; c < CHANNELS; ++c) {
                            const int i = c * wide + x;
                            color += size_of(here[i]);
                            slope += size_of(here[i + 1] - here[i - 1]) + size_of(below[i] - above[i]);
                        }
                        const float part = takes_part(x) && sees(x) ? 1.f : 0.f;
                        const float robust = least_of(color * (1.f / CHANNELS), truncation)
                            + gradient_weight * least_of(slope * (0.25f / CHANNELS), gradient_truncation);
                        cost[x] += part * robust;
                        count[x] += part;
                        if constexpr (decltype(surfaces)::both) {
                            const float also = takes_part(x) && past(x) ? 1.f : 0.f;
                            past_cost[x] += also * robust;
                            past_count[x] += also;
                        }
                    }
                };
                auto all = [](int) { return true; };
                auto recorded = [&](int x) { return mask[x + near_x] != 0.f; };
                auto sees = [&](int x) { return surface[x + near_x] <= deepest; };
                auto past = [&](int x) { return sure[x + near_x] <= deepest; };
                const bool both = seen && view_sets > 1;
                if (both && valid.data) add(Both(), recorded, sees, past);
                else if (both) add(Both(), all, sees, past);
                else if (seen && valid.data) add(One(), recorded, sees, past);
                else if (seen) add(One(), all, sees, past);
                else if (valid.data) add(One(), recorded, all, all);
                else add(One(), all, all, all);
            }

            if (!seen && (k + 1 == views_there || members.data[k + 1] != members.data[k]))
                for (int m = 0; m < view_sets; ++m)
                    if ((unsigned)members.data[k] >> m & 1u) {
                        float* const total = sums + m * 2 * strip;
                        #pragma clang loop vectorize(assume_safety)
                        for (size_t i = 0; i < 2 * strip; ++i) total[i] += group[i];
                    }
        }

        float* const out = volume.data + l * plane + (size_t)top * width;
        const int pixels = (bottom - top) * width;
        for (int m = 0; m < view_sets; ++m) {
            const float* const total = sums + m * 2 * strip;
            const float* const count = total + strip;
            const float factor = m == 0 || seen ? 1.f : 1.f + preference;
            const float extra = m == 0 ? 0.f : seen ? penalty : PENALTY, needed = m == 0 || seen ? least : 1.f;
            #pragma clang loop vectorize(assume_safety)
            for (int i = 0; i < pixels; ++i) {
                const float mean = fade * total[i] / (count[i] > 1.f ? count[i] : 1.f);
                const float value = count[i] >= needed ? factor * mean + extra : most;
                out[i] = m == 0 || value < out[i] ? value : out[i];
            }
        }
    }
"""


def _kept(stored: Any) -> Any:
    """What a CPU keeps views as: as they are stored, if it can make vectors of that."""
    return wp.float32 if stored is wp.float16 else stored


@once
def _cpu_kernels(channels: int, stored: Any) -> SimpleNamespace:
    pixel, stored_pixel, kept = pixel_type(channels), pixel_type(channels, stored), _kept(stored)
    module = f"lfgpu_plane_sweep_{channels}_{stored.__name__}"
    code = _SWEEP.replace("CHANNELS", str(channels)).replace("STRIP", str(_STRIP)).replace("PENALTY", f"{_PENALTY}f")

    @wp.kernel(module=module, enable_backward=False)
    def views_kernel(views: wp.array3d(dtype=stored_pixel), kept_out: wp.array4d(dtype=kept)):
        """Channels before rows."""
        n = wp.tid()
        for y in range(views.shape[1]):
            for x in range(views.shape[2]):
                value = views[n, y, x]
                for c in range(wp.static(channels)):
                    kept_out[n, c, y, x] = kept(value[c])

    @wp.kernel(module=module, enable_backward=False)
    def image_kernel(image: wp.array2d(dtype=pixel), kept_out: wp.array3d(dtype=float)):
        y, x = wp.tid()
        for c in range(wp.static(channels)):
            kept_out[c, y, x] = image[y, x][c]

    @wp.func_native(code)
    def sweep_rows(
        views: wp.array4d(dtype=kept),
        image: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        nearest: wp.array3d(dtype=float),
        certain: wp.array3d(dtype=float),
        order: wp.array(dtype=int),
        members: wp.array(dtype=int),
        shifts: wp.array2d(dtype=wp.vec4f),
        limits: wp.array(dtype=float),
        view_sets: int,
        scale: float,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        preference: float,
        least: float,
        penalty: float,
        first: int,
        last: int,
        room: wp.array(dtype=float),
        volume: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def sweep_kernel(
        views: wp.array4d(dtype=kept),
        image: wp.array3d(dtype=float),
        valid: wp.array3d(dtype=float),
        nearest: wp.array3d(dtype=float),
        certain: wp.array3d(dtype=float),
        order: wp.array(dtype=int),
        members: wp.array(dtype=int),
        shifts: wp.array2d(dtype=wp.vec4f),
        limits: wp.array(dtype=float),
        view_sets: int,
        scale: float,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        preference: float,
        least: float,
        penalty: float,
        first: int,
        last: int,
        room: wp.array(dtype=float),
        volume_out: wp.array3d(dtype=float),
    ):
        """One thread sweeps the rows from `first` to before `last`."""
        sweep_rows(
            views,
            image,
            valid,
            nearest,
            certain,
            order,
            members,
            shifts,
            limits,
            view_sets,
            scale,
            truncation,
            gradient_weight,
            gradient_truncation,
            preference,
            least,
            penalty,
            first,
            last,
            room,
            volume_out,
        )

    return SimpleNamespace(views=views_kernel, image=image_kernel, sweep=sweep_kernel)


class _PlaneSweep:
    """Which views are shifted by how much, in the order of their view_sets, and the views as the device likes them."""

    def __init__(
        self,
        shape: Sequence[int],
        offsets: Any,
        view_sets: Any,
        first: float,
        step: float,
        count: int,
        tolerance: float,
        least: int,
        penalty: float,
        numbers: list[float],
    ) -> None:
        self._shape, self._device, self._numbers = tuple(shape), offsets.device, numbers
        self._least, self._penalty = float(least), penalty
        places, belongs = offsets.numpy(), view_sets.numpy() != 0
        self._view_sets, self._count = len(belongs), count
        bits = np.left_shift(np.uint32(1), np.arange(len(belongs), dtype=np.uint32))
        members = (belongs * bits[:, None]).sum(0, dtype=np.uint32)
        others = np.flatnonzero(np.hypot(*places.T) > _LEAST_OFFSET)
        others = others[np.argsort(members[others], kind="stable")]
        shifts = sweep_shifts(places[others], first=first, step=step, count=count)
        whole, deepest = np.floor(shifts), first + step * np.arange(count) + tolerance
        self._order = self._array(others.astype(np.int32), int)
        self._members = self._array(members[others].view(np.int32), int)
        self._shifts = self._array(np.concatenate([whole, shifts - whole], axis=2).astype(np.float32), wp.vec4f)
        self._deepest = self._array(deepest.astype(np.float32), float)
        self._stored: Any = None

    def _array(self, values: NDArray[Any], dtype: Any) -> Any:
        return wp.array(values, dtype=dtype, device=self._device)

    def load(self, image: Any, recorded: Any, valid: Any) -> None:
        stored = recorded.dtype._wp_scalar_type_
        if stored is not self._stored:
            self._prepare(stored)
        if not self._device.is_cpu:
            self._image = image
            launch(self._pack, recorded.size, [recorded, valid], [self._views], device=self._device)
            return
        self._valid = valid
        load(self._device, self._kernels.views)

        def some_views(_: int, first: int, last: int) -> None:
            some, kept = recorded[first:last], self._views[first:last]
            launch(self._kernels.views, last - first, [some], [kept], device="cpu")

        in_slices(self._device, len(recorded), some_views)
        launch(self._kernels.image, image.shape, [image], [self._image], device="cpu")

    def _prepare(self, stored: Any) -> None:
        """Allocate for views of scalar type `stored`, the first time and when that changes."""
        n, height, width, channels = self._shape
        self._stored = stored
        if not self._device.is_cpu:
            self._views = wp.empty((n, height, width), dtype=kept_type(channels, stored), device=self._device)
            self._pack = pack_kernel(channels, stored)
            return
        self._kernels = _cpu_kernels(channels, stored)
        self._views = wp.empty((n, channels, height, width), dtype=_kept(stored), device="cpu")
        self._image = wp.empty((channels, height, width), dtype=float, device="cpu")
        differences, levels = 3 * channels * (width + 2), 2 * channels * width
        size = differences + levels + 2 * (1 + max(self._view_sets, _SURFACES)) * _STRIP * width
        self._room = wp.empty((len(slices(self._device, height)), size), dtype=float, device="cpu")

    def by_view_sets(self, volume_out: Any) -> None:
        self._sweep(None, None, self._view_sets, 1.0, 0.0, volume_out)

    def by_visibility(self, nearest: Any, certain: Any, volume_out: Any) -> None:
        surfaces = 1 if nearest.ptr == certain.ptr else _SURFACES  # one surface needs no second sum
        self._sweep(nearest, certain, surfaces, self._least, self._penalty, volume_out)

    def _sweep(self, nearest: Any, certain: Any, sums: int, least: float, penalty: float, volume_out: Any) -> None:
        _, height, width, _ = self._shape
        planned = [nearest, certain, self._order, self._members, self._shifts, self._deepest]
        if not self._device.is_cpu:
            seen = nearest is not None
            kernel = sweep_kernel(self._shape[3], self._stored, sums, seen, _PENALTY)
            dim = threads_of(self._count, height, width, seen=seen)
            inputs = [self._views, self._image, *planned, *self._numbers, least, penalty]
            launch(kernel, dim, inputs, [volume_out], device=self._device, block_dim=BLOCK)
            return
        views = [self._views, self._image, self._valid]
        load(self._device, self._kernels.sweep)

        def some_rows(k: int, first: int, last: int) -> None:
            inputs = [*views, *planned, sums, *self._numbers, least, penalty, first, last, self._room[k]]
            launch(self._kernels.sweep, 1, inputs, [volume_out], device="cpu")

        in_slices(self._device, height, some_rows)


def plane_sweep(
    shape: Sequence[int],
    offsets: Any,
    view_sets: Any,
    *,
    first: float,
    step: float,
    count: int,
    scale: float,
    truncation: float,
    gradient_weight: float,
    gradient_truncation: float,
    preference: float,
    tolerance: float,
    least: int,
    penalty: float,
) -> PlaneSweep:
    numbers = [scale, truncation, gradient_weight, gradient_truncation, preference]
    return _PlaneSweep(shape, offsets, view_sets, first, step, count, tolerance, least, penalty, numbers)
