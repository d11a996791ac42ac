"""The memory of a limited-memory BFGS solver (Nocedal 1980) on the device.

The last steps, gradient differences and the projected gradient are the rows of one stack. A direction is a linear
combination of the rows, so that the two-loop recursion needs no more than their inner products: it runs on
coefficients, in one thread (as in the vector-free L-BFGS of Chen et al. 2014). Rows are in units in which the curvature
is 1 everywhere; `root` is its square root.
"""

from typing import Any

import warp as wp

from . import gpu_lbfgs
from .asking import asking
from .gpu_lbfgs import LEAST_CURVATURE, State
from .memory import scalar
from .native_code import kernel
from .pixels import Field, Volume, pixelwise
from .threads import launch, launch_rows, launch_slices

wp.set_module_options({"enable_backward": False})

_DECREASE = 1e-4  # of what the slope promises: a trial that gives less is not accepted (Armijo)
_SHORTEST, _LONGEST = 0.1, 0.5  # how far a step shrinks at once
_REJECTIONS = 20  # in a row that end the search


@wp.func
def projected(gradient: float, x: float, low: float, high: float) -> float:
    """Compute the gradient, 0 where it would lead out of the bounds."""
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
    # All is read before anything is written: reads that nothing can have changed wait for memory together.
    step = state.step[0]
    promised = state.slope[0] * step
    trial = trial_value[0]
    old = value[0]
    last = state.length[0]
    rejections = state.rejections[0]
    judged = state.judged[0]
    flat = state.flat[0]
    first = trace_out[0]
    before = trace_out[wp.max(last - patience, 0)]
    state.judged[0] = judged + 1
    accepted = wp.int32(0)
    if wp.isfinite(trial) and trial <= old + wp.float64(_DECREASE) * promised:
        accepted = 1
        value[0] = trial
        trace_out[last] = trial
        state.length[0] = last + 1
        state.rejections[0] = 0
        if last >= patience and before - trial <= wp.float64(patience) * tolerance * wp.abs(first):
            flat = 1
            state.flat[0] = 1
        if flat == 1 or last + 1 == trace_out.shape[0]:
            state.go_on[0] = wp.float64(0.0)
    else:
        shorter = wp.float64(_SHORTEST) * step
        if wp.isfinite(trial):
            minimum = -promised * step / (wp.float64(2.0) * (trial - old - promised))
            shorter = wp.clamp(minimum, shorter, wp.float64(_LONGEST) * step)
        state.step[0] = shorter
        state.rejections[0] = rejections + 1
        if rejections + 1 == _REJECTIONS:
            state.go_on[0] = wp.float64(0.0)
    state.accepted[0] = accepted


@pixelwise("lfgpu_lbfgs_propose", light=True)
def _propose(y: int, x: int, state: State, at: Field, direction: Field, low: float, high: float, trial_out: Field):
    trial_out[y, x] = wp.clamp(at[y, x] + float(state.step[0]) * direction[y, x], low, high)


@pixelwise("lfgpu_lbfgs_root", light=True)
def _find_root(y: int, x: int, curvature: Field, root_out: Field):
    root = float(1.0)
    if curvature:
        root = wp.sqrt(curvature[y, x])
    root_out[y, x] = root


@pixelwise("lfgpu_lbfgs_project", light=True)
def _project(y: int, x: int, at: Field, gradient: Field, root: Field, low: float, high: float, projected_out: Field):
    projected_out[y, x] = projected(gradient[y, x], at[y, x], low, high) / root[y, x]


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
    """Move x and its gradient to an accepted trial; the step and the difference go into a slot."""
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
    """Run the two-loop recursion on coefficients of the rows; without an accepted trial these stay as they are."""
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
            for part in range(sums.shape[0]):
                s_r = s_r + sums[part, 3 * r]
                y_r = y_r + sums[part, 3 * r + 1]
                g_r = g_r + sums[part, 3 * r + 2]
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
            if curvature > wp.float64(LEAST_CURVATURE) * sizes:
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


@pixelwise("lfgpu_lbfgs_combine")
def _combine(
    y: int,
    x: int,
    stack: Volume,
    coefficients: wp.array(dtype=wp.float64),
    place: Field,
    root: Field,
    low: float,
    high: float,
    direction_out: Field,
):
    """Σ coefficients[r] stack[r] in the units of the place, 0 where the bounds stop it or hold the pixel."""
    total = float(0.0)
    for r in range(stack.shape[0]):
        c = float(coefficients[r])
        if c != 0.0:
            total = total + c * stack[r, y, x]
    at = place[y, x]
    stopped = (at <= low or at >= high) and stack[stack.shape[0] - 1, y, x] == 0.0
    direction_out[y, x] = wp.where(stopped, 0.0, -projected(-total / root[y, x], at, low, high))


class lbfgs:
    def __init__(
        self,
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
    ) -> None:
        slots = memory + 1  # one for the pair that is not kept yet
        rows = 2 * slots + 1
        self.go_on, self._device = scalar(1.0, device), wp.get_device(device)
        self._bounds, self._first_step, self._flatness = (low, high), first_step, (patience, tolerance)
        self._stack = wp.zeros((rows, *shape), dtype=float, device=device)
        self._direction, self._root = (wp.zeros(tuple(shape), dtype=float, device=device) for _ in range(2))
        self._products = wp.zeros((rows, rows), dtype=wp.float64, device=device)
        parts = 1 if self._device.is_cpu else gpu_lbfgs.PARTS
        self._sums = wp.zeros((parts, 3 * rows), dtype=wp.float64, device=device)
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
        launch(_begin_kernel, 1, [self._state, value], [self._trace], device=self._device)
        _find_root(curvature, self._root)
        _project(x, gradient, self._root, *self._bounds, self._stack[-1])
        self._turn(x, beginning=True)

    def propose(self, x: Any, trial_out: Any) -> None:
        _propose(self._state, x, self._direction, *self._bounds, trial_out)

    def judge(self, value: Any, trial_value: Any) -> None:
        inputs = [self._state, trial_value, *self._flatness]
        launch(_judge_kernel, 1, inputs, [value, self._trace], device=self._device)

    def learn(self, x: Any, gradient: Any, trial: Any, trial_gradient: Any) -> None:
        inputs = [self._state, trial, trial_gradient, self._root, *self._bounds]
        launch_rows(_advance_kernel, inputs, self._stack, x, gradient, light=True)
        self._turn(x, beginning=False)

    def report(self) -> tuple[list[float], int, bool]:
        state = self._state
        with asking(self._device.alias):
            trace = [float(value) for value in self._trace.numpy()[: state.length.numpy()[0]]]
            return trace, int(state.judged.numpy()[0]), bool(state.flat.numpy()[0])

    def _turn(self, x: Any, *, beginning: bool) -> None:
        """Return a new direction from what is in the stack."""
        device, stack, state = self._device, self._stack, self._state
        if device.is_cpu:
            products = kernel("vector.h", "find_products", State=State)
            launch_slices(products, len(stack), [state, stack], self._sums)
        else:
            gpu_lbfgs.products(state, stack, self._sums)
        inputs = [state, self._sums, self._first_step, float(x.size), int(beginning)]
        if device.is_cpu or len(stack) > gpu_lbfgs.MOST_ROWS:
            outputs = [self._products, self._alpha, self._coefficients]
            launch(_direction_by_one_thread_kernel, 1, inputs, outputs, device=device)
        else:
            gpu_lbfgs.recursion(inputs, self._products, self._coefficients)
        inputs = [stack, self._coefficients, x, self._root, *self._bounds]
        if device.is_cpu:
            _combine(*inputs, self._direction)
        else:
            gpu_lbfgs.combine(inputs, self._direction)
