"""The direction of L-BFGS on a GPU: inner products, the recursion, and the combination; `lbfgs.py` says of what.

All three wait for memory more than they compute. So a thread asks for a pixel of many rows at once, the sums of the
parts are fetched by as many threads as there are, and the recursion itself is one warp, a coefficient in each lane.
"""

from typing import Any

import warp as wp

from .cost_volume import code
from .lbfgs_state import LEAST_CURVATURE, State
from .threads import check_size, launch, once

wp.set_module_options({"enable_backward": False})

PARTS = 128  # of each inner product
MOST_ROWS = 32  # of which the recursion knows how to make a direction: a lane each
_ROWS = 9  # of which a block has the inner products
_BLOCK = 256
_TURNS = 4  # groups of threads that fetch the sums

_PRODUCTS = """
    const int rows = stack.shape[0], memory = rows / 2, slot = (newest + 1) % memory;
    const int group = block / PARTS, part = block - group * PARTS, first = group * ROWS;
    const size_t size = (size_t)stack.shape[1] * stack.shape[2];
    const float* const step = stack.data + slot * size;
    const float* const difference = stack.data + (memory + slot) * size;
    const float* const gradient = stack.data + 2 * memory * size;
    double totals[ROWS][3] = {};
    for (size_t i = part * BLOCK + thread; i < size; i += PARTS * BLOCK) {
        float values[ROWS];
    #pragma unroll
        for (int r = 0; r < ROWS; ++r) values[r] = stack.data[min(first + r, rows - 1) * size + i];
        const double s = step[i], y = difference[i], g = gradient[i];
    #pragma unroll
        for (int r = 0; r < ROWS; ++r) {
            const double value = values[r];
            totals[r][0] += value * s;
            totals[r][1] += value * y;
            totals[r][2] += value * g;
        }
    }
    __shared__ double by_warp[BLOCK / 32][3 * ROWS];
    #pragma unroll
    for (int r = 0; r < ROWS; ++r)
    #pragma unroll
        for (int which = 0; which < 3; ++which) {
            double total = totals[r][which];
            for (int step = 16; step; step >>= 1) total += __shfl_xor_sync(~0u, total, step);
            if ((thread & 31) == 0) by_warp[thread >> 5][3 * r + which] = total;
        }
    __syncthreads();
    if (thread < 3 * ROWS && first + thread / 3 < rows) {
        double total = 0.0;
        for (int warp = 0; warp < BLOCK / 32; ++warp) total += by_warp[warp][thread];
        sums.data[part * 3 * rows + 3 * first + thread] = total;
    }
"""

_RECURSION = """
    // Lane r of the first warp has coefficient r; sums over rows are sums over lanes.
    __shared__ double g[32 * 32], fetched[TURNS][3 * 32], inverse[32];
    const int rows = products.shape[0], memory = rows / 2, last = rows - 1, parts = sums.shape[0], lane = thread & 31;
    int newest = state.newest.data[0], pairs = state.pairs.data[0];
    const int slot = (newest + 1) % memory, turn = thread / 128, place = thread - turn * 128;
    if (place < 3 * rows) {
        double total = 0.0;
    #pragma unroll 8
        for (int part = turn; part < parts; part += TURNS) total += sums.data[part * 3 * rows + place];
        fetched[turn][place] = total;
    }
    for (int i = thread; i < rows * rows; i += 128 * TURNS) g[i / rows * 32 + i % rows] = products.data[i];
    __syncthreads();
    if (thread >= 32) return;
    const bool mine = lane < rows;
    if (mine) {
        double by[3];
        for (int which = 0; which < 3; ++which) {
            by[which] = 0.0;
            for (int t = 0; t < TURNS; ++t) by[which] += fetched[t][3 * lane + which];
        }
        auto keep = [&](int row, double product) {
            g[lane * 32 + row] = g[row * 32 + lane] = product;
            products.data[lane * rows + row] = products.data[row * rows + lane] = product;
        };
        if (!beginning) {
            keep(slot, by[0]);
            keep(memory + slot, by[1]);
        }
        keep(last, by[2]);
    }
    __syncwarp();
    auto total = [&](double value) {
        for (int step = 16; step; step >>= 1) value += __shfl_xor_sync(~0u, value, step);
        return value;
    };
    if (!beginning) {
        const double sy = g[slot * 32 + memory + slot], ss = g[slot * 32 + slot];
        const double yy = g[(memory + slot) * 32 + memory + slot];
        if (sy > curvature * sqrt(ss * yy)) {
            newest = slot;
            pairs = min(pairs + 1, memory - 1);
        }
    }
    if (lane < memory) inverse[lane] = 1.0 / g[lane * 32 + memory + lane];
    __syncwarp();
    double c = lane == last ? -1.0 : 0.0, alpha = 0.0, slope = -g[last * 32 + last], step = 1.0;
    if (pairs > 0) {
        for (int k = 0; k < pairs; ++k) {
            const int p = (newest - k + memory) % memory;
            const double along = total(mine ? c * g[p * 32 + lane] : 0.0) * inverse[p];
            if (lane == p) alpha = along;
            if (lane == memory + p) c -= along;
        }
        c *= g[newest * 32 + memory + newest] / g[(memory + newest) * 32 + memory + newest];
        for (int k = 0; k < pairs; ++k) {
            const int p = (newest - pairs + 1 + k + memory) % memory;
            const double beta = total(mine ? c * g[(memory + p) * 32 + lane] : 0.0) * inverse[p];
            if (lane == p) c += alpha - beta;
        }
        slope = total(mine ? c * g[last * 32 + lane] : 0.0);
        if (slope >= 0.0) {  // no descent: begin anew
            c = lane == last ? -1.0 : 0.0;
            slope = -g[last * 32 + last];
            pairs = 0;
        }
    }
    if (pairs == 0) step = slope < 0.0 ? first_step / sqrt(-slope / pixels) : 0.0;
    if (mine) coefficients.data[lane] = c;
    if (lane == 0) {
        state.newest.data[0] = newest;
        state.pairs.data[0] = pairs;
        state.slope.data[0] = slope;
        state.step.data[0] = step;
        if (step == 0.0) state.go_on.data[0] = 0.0;
    }
"""

_COMBINE = """
    const size_t size = (size_t)stack.shape[1] * stack.shape[2];
    __shared__ float shares[COUNT];
    if (thread < COUNT) shares[thread] = (float)coefficients.data[thread];
    const size_t i = (size_t)block * BLOCK + thread;
    float values[COUNT], at = 0.f, unit = 1.f;
    if (i < size) {
        at = x.data[i];
        unit = root.data[i];
    #pragma unroll
        for (int r = 0; r < COUNT; ++r) values[r] = stack.data[r * size + i];
    }
    __syncthreads();
    if (i >= size) return;
    float total = 0.f;
    #pragma unroll
    for (int r = 0; r < COUNT; ++r) total += shares[r] != 0.f ? shares[r] * values[r] : 0.f;  // what is old may be NaN
    const float step = total / unit;
    const bool held = (at <= low || at >= high) && values[COUNT - 1] == 0.f;
    const bool stopped = (at <= low && step < 0.f) || (at >= high && step > 0.f);
    direction.data[i] = held || stopped ? 0.f : step;
"""


@wp.func_native(code(_PRODUCTS, PARTS=PARTS, ROWS=_ROWS, BLOCK=_BLOCK))
def _some_products(
    stack: wp.array3d(dtype=float), newest: int, block: int, thread: int, sums: wp.array2d(dtype=wp.float64)
): ...


@wp.kernel
def _products_kernel(state: State, stack: wp.array3d(dtype=float), sums_out: wp.array2d(dtype=wp.float64)):
    """Inner products of some rows with the new step, the new difference and the projected gradient, [part, row, 3]."""
    i = wp.tid()
    if state.accepted[0] == 1:
        block = i / wp.static(_BLOCK)
        _some_products(stack, state.newest[0], block, i - block * wp.static(_BLOCK), sums_out)


@wp.func_native(code(_RECURSION, TURNS=_TURNS))
def _two_loops(
    state: State,
    sums: wp.array2d(dtype=wp.float64),
    first_step: wp.float64,
    pixels: wp.float64,
    curvature: wp.float64,
    beginning: int,
    thread: int,
    products: wp.array2d(dtype=wp.float64),
    coefficients: wp.array(dtype=wp.float64),
): ...


@wp.kernel
def _recursion_kernel(
    state: State,
    sums: wp.array2d(dtype=wp.float64),
    first_step: wp.float64,
    pixels: wp.float64,
    beginning: int,
    products: wp.array2d(dtype=wp.float64),
    coefficients_out: wp.array(dtype=wp.float64),
):
    """The two-loop recursion on coefficients of the rows; if the trial was not accepted they stay what they are."""
    thread = wp.tid()
    if state.accepted[0] == 1:
        least = wp.float64(wp.static(LEAST_CURVATURE))
        _two_loops(state, sums, first_step, pixels, least, beginning, thread, products, coefficients_out)


@once
def _combine_kernel(rows: int) -> Any:
    @wp.func_native(code(_COMBINE, COUNT=rows, BLOCK=_BLOCK))
    def combine_pixel(
        stack: wp.array3d(dtype=float),
        coefficients: wp.array(dtype=wp.float64),
        x: wp.array2d(dtype=float),
        root: wp.array2d(dtype=float),
        low: float,
        high: float,
        block: int,
        thread: int,
        direction: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_gpu_lbfgs_{rows}", enable_backward=False)
    def combine_kernel(
        stack: wp.array3d(dtype=float),
        coefficients: wp.array(dtype=wp.float64),
        x: wp.array2d(dtype=float),
        root: wp.array2d(dtype=float),
        low: float,
        high: float,
        direction_out: wp.array2d(dtype=float),
    ):
        """Σ coefficients[r] stack[r] in the units of x, 0 where the bounds stop it or hold the pixel."""
        i = wp.tid()
        block = i / wp.static(_BLOCK)
        combine_pixel(stack, coefficients, x, root, low, high, block, i - block * wp.static(_BLOCK), direction_out)

    return combine_kernel


def products(state: State, stack: Any, sums_out: Any) -> None:
    dim = -(-len(stack) // _ROWS) * PARTS * _BLOCK
    launch(_products_kernel, dim, [state, stack], [sums_out], device=stack.device, block_dim=_BLOCK)


def recursion(inputs: list[Any], products: Any, coefficients_out: Any) -> None:
    outputs, threads = [products, coefficients_out], 128 * _TURNS
    launch(_recursion_kernel, threads, inputs, outputs, device=products.device, block_dim=threads)


def combine(inputs: list[Any], direction_out: Any) -> None:
    dim = -(-direction_out.size // _BLOCK) * _BLOCK
    check_size(dim)
    kernel = _combine_kernel(len(inputs[0]))
    launch(kernel, dim, inputs, [direction_out], device=direction_out.device, block_dim=_BLOCK)
