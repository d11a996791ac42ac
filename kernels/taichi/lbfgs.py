"""The memory of a limited-memory BFGS solver (Nocedal 1980); `kernels/reference/lbfgs.py` says what it is.

Steps, gradient differences and the projected gradient are the rows of one stack. A direction is a linear combination of
them, so that the two-loop recursion needs no more than their inner products: it runs on coefficients, in one thread (as
in the vector-free L-BFGS of Chen et al. 2014). The stack has a slot more than pairs are kept, into which a pair goes
before it is known whether it is kept.
"""

from collections.abc import Sequence
from math import prod
from types import SimpleNamespace

import numpy as np
import taichi as ti

from .memory import DeviceArray, clear, doubles, empty, flat, numpy, scalar
from .runtime import TASK, double, on_cpu, once, run, start
from .sums import BLOCK, share, summing
from .vector import fill

_DECREASE = 1e-4  # of what the slope promises: a trial that gives less is not accepted (Armijo)
_CURVATURE = 1e-10  # least s . y over |s| |y| of a pair that is kept
_SHORTEST, _LONGEST = 0.1, 0.5  # how far a step shrinks at once
_REJECTIONS = 20  # in a row that end the search
_CPU_PARTS, _GPU_PARTS = 64, 1024  # of each inner product

# Places in the state: the numbers of a solver
_STEP, _SLOPE, _ACCEPTED, _REJECTED, _JUDGED, _LENGTH, _FLAT, _PAIRS, _NEWEST = range(9)


@ti.func
def projected(vector: float, x: float, low: float, high: float):
    """Compute the gradient, 0 where a step against it would lead out of the bounds."""
    result = vector
    if (x <= low and vector > 0.0) or (x >= high and vector < 0.0):
        result = 0.0
    return result


@ti.func
def in_use(row: int, slots: int, newest: int, pairs: int):
    """True if a row of the stack is in use: the projected gradient, the new pair, or one that is kept."""
    age = (newest - row % slots + slots) % slots
    return row == 2 * slots or age < pairs or age == slots - 1


@once
def _search_kernels() -> SimpleNamespace:
    real = double()
    field, numbers = flat(), flat(real)

    @ti.kernel
    def begin_kernel(value: numbers, state_out: numbers, trace_out: numbers, go_on_out: numbers):
        for place in range(state_out.shape[0]):
            state_out[place] = 0.0
        state_out[_ACCEPTED] = 1.0
        state_out[_JUDGED] = 1.0
        state_out[_LENGTH] = 1.0
        trace_out[0] = value[0]
        go_on_out[0] = 0.0
        if trace_out.shape[0] > 1:
            go_on_out[0] = 1.0

    @ti.kernel
    def propose_kernel(state: numbers, x: field, direction: field, low: float, high: float, trial_out: field):
        for i in range(x.shape[0]):
            trial_out[i] = ti.math.clamp(x[i] + ti.cast(state[_STEP], ti.f32) * direction[i], low, high)

    @ti.kernel
    def judge_kernel(
        trial_value: numbers,
        patience: int,
        tolerance: real,
        state: numbers,
        value: numbers,
        trace_out: numbers,
        go_on_out: numbers,
    ):
        state[_ACCEPTED] = 0.0
        if go_on_out[0] <= 0.0:  # a host that looks seldom goes on for a while
            go_on_out[0] = go_on_out[0] - 1.0
        else:
            step = state[_STEP]
            promised = step * state[_SLOPE]
            trial = trial_value[0]
            finite = ti.abs(trial) < ti.math.inf
            state[_JUDGED] = state[_JUDGED] + 1.0
            if finite and trial <= value[0] + ti.cast(_DECREASE, real) * promised:
                last = ti.min(ti.cast(state[_LENGTH], ti.i32), trace_out.shape[0] - 1)
                value[0] = trial
                trace_out[last] = trial
                state[_LENGTH] = ti.cast(last + 1, real)
                state[_ACCEPTED] = 1.0
                state[_REJECTED] = 0.0
                if last >= patience:
                    most = ti.cast(patience, real) * tolerance * ti.abs(trace_out[0])
                    if trace_out[last - patience] - trial <= most:
                        state[_FLAT] = 1.0
                        go_on_out[0] = 0.0
                if last + 1 == trace_out.shape[0]:
                    go_on_out[0] = 0.0
            else:
                shorter = ti.cast(_SHORTEST, real) * step
                if finite:
                    lowest = -promised * step / (2.0 * (trial - value[0] - promised))
                    shorter = ti.min(ti.max(lowest, shorter), ti.cast(_LONGEST, real) * step)
                state[_STEP] = shorter
                state[_REJECTED] = state[_REJECTED] + 1.0
                if state[_REJECTED] == _REJECTIONS:
                    go_on_out[0] = 0.0

    return SimpleNamespace(begin=begin_kernel, propose=propose_kernel, judge=judge_kernel)


@once
def _stack_kernels() -> SimpleNamespace:
    """Kernels of the stack [2 slots + 1, pixel], steps, differences, the projected gradient, and of their units."""
    real, sums, cpu = double(), summing(), on_cpu()
    field, numbers, passes = flat(), flat(real), TASK if cpu else 1

    @ti.func
    def add_products(
        stack: ti.template(), size: int, slots: int, slot: int, row: int, part: int, parts_out: ti.template()
    ):
        """Inner products of one row with the new step, the new difference and the projected gradient, over a part."""
        parts = parts_out.shape[0] // (3 * (2 * slots + 1))
        with_step = ti.cast(0.0, real)
        with_difference = ti.cast(0.0, real)
        with_gradient = ti.cast(0.0, real)
        i, by, end = share(part, parts, size, cpu)
        while i < end:
            value = ti.cast(stack[row * size + i], real)
            with_step += value * ti.cast(stack[slot * size + i], real)
            with_difference += value * ti.cast(stack[(slots + slot) * size + i], real)
            with_gradient += value * ti.cast(stack[2 * slots * size + i], real)
            i += by
        parts_out[3 * row * parts + part] = with_step
        parts_out[(3 * row + 1) * parts + part] = with_difference
        parts_out[(3 * row + 2) * parts + part] = with_gradient

    @ti.func
    def along(row: int, coefficients: ti.template(), products: ti.template()):
        """Compute the inner product of a row with the combination that the coefficients make."""
        rows = coefficients.shape[0]
        total = ti.cast(0.0, real)
        for r in range(rows):
            if coefficients[r] != 0.0:
                total += coefficients[r] * products[row * rows + r]
        return total

    @ti.func
    def against_gradient(coefficients_out: ti.template()):
        for r in range(coefficients_out.shape[0]):
            coefficients_out[r] = 0.0
        coefficients_out[coefficients_out.shape[0] - 1] = -1.0

    @ti.kernel
    def learn_kernel(
        trial: field,
        trial_gradient: field,
        root: field,
        low: float,
        high: float,
        first_step: real,
        pixels: real,
        state: numbers,
        stack: field,
        parts: numbers,
        totals: numbers,
        products: numbers,
        alpha: numbers,
        coefficients: numbers,
        x: field,
        gradient: field,
        direction_out: field,
        go_on_out: numbers,
    ):
        """Move x and its gradient to an accepted trial, and find the next direction, its slope and its step.

        Step and difference go into the slot of a new pair. The direction is the sum of coefficients[r] * stack[r] in
        the units of x, 0 where the bounds stop it or the gradient.
        """
        size = x.shape[0]
        rows = coefficients.shape[0]
        slots = rows // 2
        count = parts.shape[0] // (3 * rows)
        for i in range(size):
            if state[_ACCEPTED] == 1.0:
                slot = (ti.cast(state[_NEWEST], ti.i32) + 1) % slots
                stack[slot * size + i] = (trial[i] - x[i]) * root[i]
                stack[(slots + slot) * size + i] = (trial_gradient[i] - gradient[i]) / root[i]
                stack[2 * slots * size + i] = projected(trial_gradient[i], trial[i], low, high) / root[i]
                x[i] = trial[i]
                gradient[i] = trial_gradient[i]
        for task in range(rows * count * passes):
            row = task // (count * passes)
            newest = ti.cast(state[_NEWEST], ti.i32)
            if task % passes == 0 and state[_ACCEPTED] == 1.0:
                if in_use(row, slots, newest, ti.cast(state[_PAIRS], ti.i32)):
                    add_products(stack, size, slots, (newest + 1) % slots, row, task // passes % count, parts)
        ti.loop_config(block_dim=BLOCK)
        for turn in range(3 * rows * sums.threads):
            total = sums.total(parts, turn // sums.threads * count, count, turn)
            if turn % sums.threads == 0:
                totals[turn // sums.threads] = total
        if state[_ACCEPTED] == 1.0:
            slot = (ti.cast(state[_NEWEST], ti.i32) + 1) % slots
            # The new inner products go into the matrix of all.
            for r in range(rows):
                for k in range(3):
                    new = ti.min(k * slots + slot, rows - 1)
                    products[r * rows + new] = totals[3 * r + k]
                    products[new * rows + r] = totals[3 * r + k]
            s_s = products[slot * rows + slot]
            s_y = products[slot * rows + slots + slot]
            y_y = products[(slots + slot) * rows + slots + slot]
            if s_y > ti.cast(_CURVATURE, real) * ti.sqrt(s_s) * ti.sqrt(y_y):
                state[_NEWEST] = ti.cast(slot, real)
                state[_PAIRS] = ti.min(state[_PAIRS] + 1.0, ti.cast(slots - 1, real))
            against_gradient(coefficients)
            slope = ti.cast(0.0, real)
            if state[_PAIRS] > 0.0:
                newest = ti.cast(state[_NEWEST], ti.i32)
                pairs = ti.cast(state[_PAIRS], ti.i32)
                for k in range(pairs):
                    s = (newest - k + slots) % slots
                    alpha[s] = along(s, coefficients, products) / products[s * rows + slots + s]
                    coefficients[slots + s] = coefficients[slots + s] - alpha[s]
                last = slots + newest
                gamma = products[newest * rows + last] / products[last * rows + last]
                for r in range(rows):
                    coefficients[r] = gamma * coefficients[r]
                for k in range(pairs):
                    s = (newest - pairs + 1 + k + slots) % slots
                    beta = along(slots + s, coefficients, products) / products[s * rows + slots + s]
                    coefficients[s] = coefficients[s] + alpha[s] - beta
                slope = along(rows - 1, coefficients, products)
                if not slope < 0.0:
                    state[_PAIRS] = 0.0
                    against_gradient(coefficients)
            step = ti.cast(1.0, real)
            if state[_PAIRS] == 0.0:
                slope = -products[rows * rows - 1]
                step = 0.0
                if slope < 0.0:
                    step = first_step / ti.sqrt(-slope / pixels)
                else:
                    go_on_out[0] = 0.0
            state[_SLOPE] = slope
            state[_STEP] = step
        for i in range(size):
            if state[_ACCEPTED] == 1.0:
                total = 0.0
                if (x[i] > low and x[i] < high) or stack[2 * slots * size + i] != 0.0:
                    for row in range(rows):
                        if coefficients[row] != 0.0:
                            total += ti.cast(coefficients[row], ti.f32) * stack[row * size + i]
                direction_out[i] = -projected(-total / root[i], x[i], low, high)

    @ti.kernel
    def root_kernel(curvature: field, root_out: field):
        for i in range(root_out.shape[0]):
            root_out[i] = ti.sqrt(curvature[i])

    return SimpleNamespace(learn=learn_kernel, root=root_kernel)


class lbfgs:
    def __init__(
        self,
        shape: Sequence[int],
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
        start(device)
        slots, size = memory + 1, prod(shape)
        rows = 2 * slots + 1
        self._bounds, self._flatness, self._scale = (low, high), (patience, tolerance), (first_step, float(size))
        self._stack, self._direction = clear(empty((rows, size))), clear(empty(shape))
        self._root = clear(empty(shape))
        self._parts = doubles(np.zeros((3 * rows, _CPU_PARTS if on_cpu() else _GPU_PARTS)))
        self._totals = doubles(np.zeros(3 * rows))
        self._products, self._alpha = doubles(np.zeros((rows, rows))), doubles(np.zeros(slots))
        self._coefficients, self._trace = doubles(np.zeros(rows)), doubles(np.zeros(most + 1))
        self._state, self.go_on = doubles(np.zeros(9)), scalar(1.0, device)
        self._search, self._rows = _search_kernels(), _stack_kernels()

    def begin(
        self, x: DeviceArray, gradient: DeviceArray, value: DeviceArray, curvature: DeviceArray | None = None
    ) -> None:
        run(self._search.begin, value, self._state, self._trace, self.go_on)
        if curvature is None:
            fill(1.0, self._root)
        else:
            run(self._rows.root, curvature, self._root)
        self.learn(x, gradient, x, gradient)

    def propose(self, x: DeviceArray, trial_out: DeviceArray) -> None:
        run(self._search.propose, self._state, x, self._direction, *self._bounds, trial_out)

    def judge(self, value: DeviceArray, trial_value: DeviceArray) -> None:
        run(self._search.judge, trial_value, *self._flatness, self._state, value, self._trace, self.go_on)

    def learn(self, x: DeviceArray, gradient: DeviceArray, trial: DeviceArray, trial_gradient: DeviceArray) -> None:
        told = trial, trial_gradient, self._root, *self._bounds, *self._scale
        kept = self._parts, self._totals, self._products, self._alpha, self._coefficients
        run(self._rows.learn, *told, self._state, self._stack, *kept, x, gradient, self._direction, self.go_on)

    def report(self) -> tuple[list[float], int, bool]:
        state = numpy(self._state)
        trace = numpy(self._trace)[: int(state[_LENGTH])]
        return [float(value) for value in trace], int(state[_JUDGED]), bool(state[_FLAT])
