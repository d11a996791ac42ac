"""The memory of a limited-memory BFGS solver (Nocedal 1980) on the device.

The last steps, gradient differences and the projected gradient are the rows of one stack. A direction is a linear
combination of the rows, so that the two-loop recursion needs no more than their inner products: it runs on
coefficients, in one thread (as in the vector-free L-BFGS of Chen et al. 2014). Rows are in units in which the curvature
is 1 everywhere; `root` is its square root.
"""

from typing import Any

import warp as wp

from .memory import scalar
from .threads import in_slices, launch_rows, load

wp.set_module_options({"enable_backward": False})

_DECREASE = 1e-4  # of what the slope promises: a trial that gives less is not accepted (Armijo)
_CURVATURE = 1e-10  # least s . y over |s| |y| of a pair that is kept
_SHORTEST, _LONGEST = 0.1, 0.5  # how far a step shrinks at once
_REJECTIONS = 20  # in a row that end the search
_PARTS = 32  # of each inner product on a GPU
_BLOCK = 256
_WARP = 32


@wp.struct
class State:
    """One number each."""

    go_on: wp.array(dtype=wp.float64)
    step: wp.array(dtype=wp.float64)
    slope: wp.array(dtype=wp.float64)
    accepted: wp.array(dtype=int)
    rejections: wp.array(dtype=int)
    judged: wp.array(dtype=int)
    newest: wp.array(dtype=int)  # slot of the newest pair
    pairs: wp.array(dtype=int)
    length: wp.array(dtype=int)  # of the trace
    flat: wp.array(dtype=int)


@wp.func
def projected(gradient: float, x: float, low: float, high: float) -> float:
    """The gradient, 0 where it would lead out of the bounds."""
    return wp.where((x <= low and gradient > 0.0) or (x >= high and gradient < 0.0), 0.0, gradient)


@wp.kernel
def _begin_kernel(state: State, value: wp.array(dtype=wp.float64), trace_out: wp.array(dtype=wp.float64)):
    state.accepted[0] = 1
    state.rejections[0] = 0
    state.judged[0] = 1
    state.newest[0] = 0
    state.pairs[0] = 0
    state.length[0] = 1
    state.flat[0] = 0
    state.go_on[0] = wp.where(trace_out.shape[0] > 1, wp.float64(1.0), wp.float64(0.0))
    trace_out[0] = value[0]


@wp.kernel
def _judge_kernel(
    state: State,
    trial_value: wp.array(dtype=wp.float64),
    patience: int,
    tolerance: wp.float64,
    value: wp.array(dtype=wp.float64),
    trace_out: wp.array(dtype=wp.float64),
):
    step = state.step[0]
    promised = state.slope[0] * step
    trial = trial_value[0]
    state.judged[0] = state.judged[0] + 1
    state.accepted[0] = 0
    if wp.isfinite(trial) and trial <= value[0] + wp.float64(_DECREASE) * promised:
        last = state.length[0]
        value[0] = trial
        trace_out[last] = trial
        state.length[0] = last + 1
        state.accepted[0] = 1
        state.rejections[0] = 0
        if last >= patience:
            fallen = trace_out[last - patience] - trial
            if fallen <= wp.float64(patience) * tolerance * wp.abs(trace_out[0]):
                state.flat[0] = 1
        if state.flat[0] == 1 or last + 1 == trace_out.shape[0]:
            state.go_on[0] = wp.float64(0.0)
    else:
        shorter = wp.float64(_SHORTEST) * step
        if wp.isfinite(trial):
            minimum = -promised * step / (wp.float64(2.0) * (trial - value[0] - promised))
            shorter = wp.clamp(minimum, shorter, wp.float64(_LONGEST) * step)
        state.step[0] = shorter
        state.rejections[0] = state.rejections[0] + 1
        if state.rejections[0] == _REJECTIONS:
            state.go_on[0] = wp.float64(0.0)


@wp.kernel
def _propose_kernel(
    state: State,
    x: wp.array(dtype=float),
    direction: wp.array(dtype=float),
    low: float,
    high: float,
    trial_out: wp.array(dtype=float),
):
    i = wp.tid()
    trial_out[i] = wp.clamp(x[i] + float(state.step[0]) * direction[i], low, high)


@wp.kernel
def _root_kernel(curvature: wp.array(dtype=float), root_out: wp.array(dtype=float)):
    i = wp.tid()
    root = float(1.0)
    if curvature:
        root = wp.sqrt(curvature[i])
    root_out[i] = root


@wp.kernel
def _project_kernel(
    x: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=float),
    root: wp.array2d(dtype=float),
    low: float,
    high: float,
    row: int,
    lanes: int,
    projected_out: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    lane = i % lanes
    for j in range(lane, x.shape[1], lanes):
        projected_out[y, j] = projected(gradient[y, j], x[y, j], low, high) / root[y, j]


@wp.kernel
def _advance_kernel(
    state: State,
    trial: wp.array2d(dtype=float),
    trial_gradient: wp.array2d(dtype=float),
    root: wp.array2d(dtype=float),
    low: float,
    high: float,
    row: int,
    lanes: int,
    stack: wp.array3d(dtype=float),
    x: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=float),
):
    """If the trial was accepted: x and its gradient become the trial's; the step and the difference go into a slot."""
    i = wp.tid()
    y = row + i / lanes
    lane = i % lanes
    if state.accepted[0] == 1:
        memory = stack.shape[0] / 2
        slot = (state.newest[0] + 1) % memory
        for j in range(lane, x.shape[1], lanes):
            moved = trial[y, j]
            turned = trial_gradient[y, j]
            stack[slot, y, j] = (moved - x[y, j]) * root[y, j]
            stack[memory + slot, y, j] = (turned - gradient[y, j]) / root[y, j]
            stack[2 * memory, y, j] = projected(turned, moved, low, high) / root[y, j]
            x[y, j] = moved
            gradient[y, j] = turned


_PRODUCTS = """
    // Eight sums of each kind side by side, which a CPU adds to at once.
    const size_t size = (size_t)stack.shape[1] * stack.shape[2];
    const float* __restrict__ const a = stack.data + row * size;
    const float* __restrict__ const b[3] = {
        stack.data + slot * size, stack.data + (memory + slot) * size, stack.data + 2 * memory * size};
    for (int which = 0; which < 3; ++which) {
        double total[8] = {};
        size_t i = 0;
        for (; i + 8 <= size; i += 8)
            for (int j = 0; j < 8; ++j) total[j] += (double)a[i + j] * (double)b[which][i + j];
        for (; i < size; ++i) total[0] += (double)a[i] * (double)b[which][i];
        double sum = 0.0;
        for (int j = 0; j < 8; ++j) sum += total[j];
        sums.data[3 * row + which] = sum;
    }
"""


@wp.func_native(_PRODUCTS)
def _three_products(
    stack: wp.array3d(dtype=float), row: int, slot: int, memory: int, sums: wp.array2d(dtype=wp.float64)
): ...


@wp.kernel(module="lfgpu_lbfgs_cpu", enable_backward=False)
def _products_on_cpu_kernel(
    state: State, stack: wp.array3d(dtype=float), row: int, sums_out: wp.array2d(dtype=wp.float64)
):
    """Inner products of a row with the new step, the new difference and the projected gradient."""
    memory = stack.shape[0] / 2
    if state.accepted[0] == 1:
        _three_products(stack, wp.tid() + row, (state.newest[0] + 1) % memory, memory, sums_out)


@wp.kernel
def _products_on_gpu_kernel(state: State, stack: wp.array2d(dtype=float), sums_out: wp.array(dtype=wp.float64)):
    """The same, of two rows and a part of the pixels for each block; sums are [row, part, which]."""
    pair, part, thread = wp.tid()
    memory = stack.shape[0] / 2
    slot = (state.newest[0] + 1) % memory
    upper = 2 * pair
    lower = wp.min(upper + 1, stack.shape[0] - 1)
    a = wp.vec3d()
    b = wp.vec3d()
    for i in range(part * wp.block_dim() + thread, stack.shape[1], wp.static(_PARTS) * wp.block_dim()):
        with_these = wp.vec3d(
            wp.float64(stack[slot, i]), wp.float64(stack[memory + slot, i]), wp.float64(stack[2 * memory, i])
        )
        a = a + wp.float64(stack[upper, i]) * with_these
        b = b + wp.float64(stack[lower, i]) * with_these
    first = (upper * wp.static(_PARTS) + part) * 3
    wp.tile_store(sums_out, wp.tile_sum(wp.tile(a[0])), offset=first)
    wp.tile_store(sums_out, wp.tile_sum(wp.tile(a[1])), offset=first + 1)
    wp.tile_store(sums_out, wp.tile_sum(wp.tile(a[2])), offset=first + 2)
    if lower > upper:
        first = first + 3 * wp.static(_PARTS)
        wp.tile_store(sums_out, wp.tile_sum(wp.tile(b[0])), offset=first)
        wp.tile_store(sums_out, wp.tile_sum(wp.tile(b[1])), offset=first + 1)
        wp.tile_store(sums_out, wp.tile_sum(wp.tile(b[2])), offset=first + 2)


@wp.kernel
def _direction_by_one_thread_kernel(
    state: State,
    sums: wp.array2d(dtype=wp.float64),
    first_step: wp.float64,
    pixels: wp.float64,
    beginning: int,
    products: wp.array2d(dtype=wp.float64),
    alpha: wp.array(dtype=wp.float64),
    coefficients_out: wp.array(dtype=wp.float64),
):
    """The two-loop recursion on coefficients of the rows; if the trial was not accepted they stay what they are."""
    if state.accepted[0] == 1:
        rows = products.shape[0]
        memory = rows / 2
        g = rows - 1
        zero = wp.float64(0.0)
        slot = (state.newest[0] + 1) % memory
        for r in range(rows):
            s_r = zero
            y_r = zero
            g_r = zero
            for part in range(sums.shape[1] / 3):
                s_r = s_r + sums[r, 3 * part]
                y_r = y_r + sums[r, 3 * part + 1]
                g_r = g_r + sums[r, 3 * part + 2]
            if beginning == 0:
                products[r, slot] = s_r
                products[slot, r] = s_r
                products[r, memory + slot] = y_r
                products[memory + slot, r] = y_r
            products[r, g] = g_r
            products[g, r] = g_r
            coefficients_out[r] = zero
        if beginning == 0:
            curvature = products[slot, memory + slot]
            sizes = wp.sqrt(products[slot, slot] * products[memory + slot, memory + slot])
            if curvature > wp.float64(_CURVATURE) * sizes:
                state.newest[0] = slot
                state.pairs[0] = wp.min(state.pairs[0] + 1, memory - 1)
        pairs = state.pairs[0]
        newest = state.newest[0]
        coefficients_out[g] = wp.float64(-1.0)
        state.step[0] = wp.float64(1.0)
        slope = -products[g, g]
        if pairs > 0:
            for k in range(pairs):
                p = (newest - k + memory) % memory
                along = zero
                for r in range(rows):
                    along = along + coefficients_out[r] * products[p, r]
                alpha[p] = along / products[p, memory + p]
                coefficients_out[memory + p] = coefficients_out[memory + p] - alpha[p]
            last = memory + newest
            gamma = products[newest, last] / products[last, last]
            for r in range(rows):
                coefficients_out[r] = gamma * coefficients_out[r]
            for k in range(pairs):
                p = (newest - pairs + 1 + k + memory) % memory
                along = zero
                for r in range(rows):
                    along = along + coefficients_out[r] * products[memory + p, r]
                coefficients_out[p] = coefficients_out[p] + alpha[p] - along / products[p, memory + p]
            slope = zero
            for r in range(rows):
                slope = slope + coefficients_out[r] * products[g, r]
            if slope >= zero:  # no descent: begin anew
                for r in range(rows):
                    coefficients_out[r] = zero
                coefficients_out[g] = wp.float64(-1.0)
                slope = -products[g, g]
                pairs = 0
                state.pairs[0] = 0
        if pairs == 0:
            if slope < zero:
                state.step[0] = first_step / wp.sqrt(-slope / pixels)
            else:
                state.step[0] = zero
                state.go_on[0] = zero
        state.slope[0] = slope


_DIRECTION = """
    // Lane r has coefficient r; sums over rows are sums over lanes.
    __shared__ double g[32 * 32], inverse[32];
    const int rows = products.shape[0], memory = rows / 2, last = rows - 1, parts = sums.shape[1] / 3;
    const bool mine = lane < rows;
    int newest = state.newest.data[0], pairs = state.pairs.data[0];
    const int slot = (newest + 1) % memory;
    if (mine) {
        double by[3] = {0.0, 0.0, 0.0};
        for (int part = 0; part < parts; ++part)
            for (int which = 0; which < 3; ++which) by[which] += sums.data[(lane * parts + part) * 3 + which];
        if (!beginning) {
            products.data[lane * rows + slot] = products.data[slot * rows + lane] = by[0];
            products.data[lane * rows + memory + slot] = products.data[(memory + slot) * rows + lane] = by[1];
        }
        products.data[lane * rows + last] = products.data[last * rows + lane] = by[2];
    }
    __syncwarp();
    for (int r = 0; r < rows; ++r)
        if (mine) g[r * 32 + lane] = products.data[r * rows + lane];
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


@wp.func_native(_DIRECTION)
def _two_loops(
    state: State,
    sums: wp.array2d(dtype=wp.float64),
    first_step: wp.float64,
    pixels: wp.float64,
    curvature: wp.float64,
    beginning: int,
    lane: int,
    products: wp.array2d(dtype=wp.float64),
    coefficients: wp.array(dtype=wp.float64),
): ...


@wp.kernel(module="lfgpu_lbfgs_gpu", enable_backward=False)
def _direction_by_one_warp_kernel(
    state: State,
    sums: wp.array2d(dtype=wp.float64),
    first_step: wp.float64,
    pixels: wp.float64,
    beginning: int,
    products: wp.array2d(dtype=wp.float64),
    coefficients_out: wp.array(dtype=wp.float64),
):
    """The same by one warp."""
    lane = wp.tid()
    if state.accepted[0] == 1:
        _two_loops(
            state,
            sums,
            first_step,
            pixels,
            wp.float64(wp.static(_CURVATURE)),
            beginning,
            lane,
            products,
            coefficients_out,
        )


@wp.kernel
def _combine_kernel(
    stack: wp.array3d(dtype=float),
    coefficients: wp.array(dtype=wp.float64),
    x: wp.array2d(dtype=float),
    root: wp.array2d(dtype=float),
    low: float,
    high: float,
    row: int,
    lanes: int,
    direction_out: wp.array2d(dtype=float),
):
    """Σ coefficients[r] stack[r] in the units of x, 0 where the bounds stop it or hold the pixel."""
    i = wp.tid()
    y = row + i / lanes
    lane = i % lanes
    for j in range(lane, x.shape[1], lanes):
        total = float(0.0)
        for r in range(stack.shape[0]):
            c = float(coefficients[r])
            if c != 0.0:
                total = total + c * stack[r, y, j]
        at = x[y, j]
        stopped = (at <= low or at >= high) and stack[stack.shape[0] - 1, y, j] == 0.0
        direction_out[y, j] = wp.where(stopped, 0.0, -projected(-total / root[y, j], at, low, high))


class _Lbfgs:
    def __init__(
        self,
        shape: Any,
        device: str,
        memory: int,
        bounds: tuple[float, float],
        first_step: float,
        flatness: tuple[int, float],
        most: int,
    ) -> None:
        slots = memory + 1  # one for the pair that is not kept yet
        rows = 2 * slots + 1
        self.go_on, self._device = scalar(1.0, device), wp.get_device(device)
        self._bounds, self._first_step, self._flatness = bounds, first_step, flatness
        self._stack = wp.zeros((rows, *shape), dtype=float, device=device)
        self._direction, self._root = (wp.zeros(tuple(shape), dtype=float, device=device) for _ in range(2))
        self._products = wp.zeros((rows, rows), dtype=wp.float64, device=device)
        self._sums = wp.zeros((rows, 3 if self._device.is_cpu else 3 * _PARTS), dtype=wp.float64, device=device)
        self._alpha = wp.zeros(slots, dtype=wp.float64, device=device)
        self._coefficients = wp.zeros(rows, dtype=wp.float64, device=device)
        self._trace = wp.zeros(most + 1, dtype=wp.float64, device=device)
        self._state = State()
        self._state.go_on = self.go_on
        for name in ("step", "slope"):
            setattr(self._state, name, wp.zeros(1, dtype=wp.float64, device=device))
        for name in ("accepted", "rejections", "judged", "newest", "pairs", "length", "flat"):
            setattr(self._state, name, wp.zeros(1, dtype=int, device=device))

    def begin(self, x: Any, gradient: Any, value: Any, curvature: Any = None) -> None:
        wp.launch(_begin_kernel, 1, [self._state, value], [self._trace], device=self._device)
        line = None if curvature is None else curvature.flatten()
        wp.launch(_root_kernel, x.size, [line], [self._root.flatten()], device=self._device)
        launch_rows(_project_kernel, [x, gradient, self._root, *self._bounds], self._stack[-1], light=True)
        self._turn(x, beginning=True)

    def propose(self, x: Any, trial_out: Any) -> None:
        inputs = [self._state, x.flatten(), self._direction.flatten(), *self._bounds]
        wp.launch(_propose_kernel, x.size, inputs, [trial_out.flatten()], device=self._device)

    def judge(self, value: Any, trial_value: Any) -> None:
        inputs = [self._state, trial_value, *self._flatness]
        wp.launch(_judge_kernel, 1, inputs, [value, self._trace], device=self._device)

    def learn(self, x: Any, gradient: Any, trial: Any, trial_gradient: Any) -> None:
        inputs = [self._state, trial, trial_gradient, self._root, *self._bounds]
        launch_rows(_advance_kernel, inputs, self._stack, x, gradient, light=True)
        self._turn(x, beginning=False)

    def report(self) -> tuple[list[float], int, bool]:
        trace = self._trace.numpy()[: self._state.length.numpy()[0]]
        return [float(value) for value in trace], int(self._state.judged.numpy()[0]), bool(self._state.flat.numpy()[0])

    def _turn(self, x: Any, *, beginning: bool) -> None:
        """A new direction from what is in the stack."""
        device, stack, state = self._device, self._stack, self._state
        if device.is_cpu:
            load(device, _products_on_cpu_kernel)

            def some(_: int, first: int, last: int) -> None:
                wp.launch(_products_on_cpu_kernel, last - first, [state, stack, first], [self._sums], device=device)

            in_slices(device, stack.shape[0], some)
        else:
            flat = stack.reshape((stack.shape[0], -1))
            dim = [-(-stack.shape[0] // 2), _PARTS]
            outputs = [self._sums.flatten()]
            wp.launch_tiled(
                _products_on_gpu_kernel, dim=dim, inputs=[state, flat], outputs=outputs, block_dim=_BLOCK, device=device
            )
        inputs = [state, self._sums, self._first_step, float(x.size), int(beginning)]
        if device.is_cpu or len(stack) > _WARP:
            outputs = [self._products, self._alpha, self._coefficients]
            wp.launch(_direction_by_one_thread_kernel, 1, inputs, outputs, device=device)
        else:
            outputs = [self._products, self._coefficients]
            wp.launch(_direction_by_one_warp_kernel, _WARP, inputs, outputs, device=device, block_dim=_WARP)
        launch_rows(_combine_kernel, [stack, self._coefficients, x, self._root, *self._bounds], self._direction)


def lbfgs(
    shape: Any,
    device: str,
    *,
    memory: int,
    low: float,
    high: float,
    first_step: float,
    tolerance: float,
    patience: int,
    most: int,
) -> _Lbfgs:
    return _Lbfgs(shape, device, memory, (low, high), first_step, (patience, tolerance), most)
