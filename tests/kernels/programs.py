"""Programs: work of many operations that nobody on the host looks at until it is done; and their checks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from checks import Outputs, Values, largest_error

from lfgpu._backends import load
from lfgpu.contract import KernelSet, half_window


@dataclass(frozen=True)
class Program:
    """Work on a device that reads `inputs` and writes `outputs`; both are fields and images."""

    inputs: Outputs
    work: Callable[[], None]
    outputs: Outputs
    tolerance: float = 1e-5
    """Relative error of the outputs: sums may be in another order."""

    def read(self, kernels: KernelSet) -> dict[str, Values]:
        return {name: kernels.numpy(array) for name, array in self.outputs.items()}


MakeProgram = Callable[[KernelSet, str, dict[str, Values]], Program]


def counting(kernels: KernelSet, device: str, values: dict[str, Values], most: int = 5) -> Program:
    """Counts `left` [1, 1] down to 0 and `calls` up, but not more than `most` times."""
    left = kernels.field(values["left"], device)
    one, rest, calls = (kernels.field(np.full((1, 1), value), device) for value in (1.0, 9.0, 9.0))
    go_on = kernels.scalar(9.0, device)

    def count() -> None:
        kernels.axpby(1.0, rest, -1.0, one, rest)
        kernels.axpby(1.0, calls, 1.0, one, calls)
        kernels.dot(rest, one, go_on)

    def work() -> None:
        kernels.copy(left, rest)
        kernels.fill(0.0, calls)
        kernels.dot(rest, one, go_on)
        kernels.repeat(count, go_on, most)

    return Program({"left": left}, work, {"calls": calls, "rest": rest})


WINDOW = 5  # of the operators of the linear system


def solving(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """Conjugate gradients on (L + 1) x = b with L the Laplacian of `weights`."""
    inputs = {name: kernels.field(values[name], device) for name in ("weights", "b")}
    shape = values["b"].shape
    x, r, p, q = (kernels.zeros(shape, device) for _ in range(4))
    now, before, product, step, back = (kernels.scalar(0.0, device) for _ in range(5))
    trace = kernels.residuals(device, tolerance=1e-6, most=60)

    def iterate() -> None:
        kernels.nlm_laplacian(inputs["weights"], p, window=WINDOW, laplacian_out=q)
        kernels.axpby(1.0, q, 1.0, p, q)
        kernels.dot(p, q, product)
        kernels.ratio(now, product, step)
        kernels.ratio(now, product, back, factor=-1.0)
        kernels.axpby(1.0, x, step, p, x)
        kernels.axpby(1.0, r, back, q, r)
        kernels.copy(now, before)
        kernels.dot(r, r, now)
        kernels.ratio(now, before, step)
        kernels.axpby(1.0, r, step, p, p)
        trace.add(now)

    def work() -> None:
        kernels.fill(0.0, x)
        kernels.copy(inputs["b"], r)
        kernels.copy(r, p)
        kernels.dot(r, r, now)
        trace.begin(now)
        trace.add(now)
        kernels.repeat(iterate, trace.go_on, 60)

    return Program(inputs, work, {"x": x}, tolerance=1e-4)


def minimizing(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """L-BFGS on the sum of h x² / 2 - b x within [-1, 1]: the minimum is b / h moved into the bounds."""
    inputs = {name: kernels.field(values[name], device) for name in ("h", "b", "start")}
    shape = values["b"].shape
    x, gradient, trial, trial_gradient, scratch = (kernels.zeros(shape, device) for _ in range(5))
    value, trial_value = (kernels.scalar(0.0, device) for _ in range(2))
    options = {"low": -1.0, "high": 1.0, "first_step": 0.1, "tolerance": 1e-12, "patience": 5, "most": 100}
    solver = kernels.lbfgs(shape, device, memory=6, **options)

    def evaluate(at: Any, gradient_out: Any, value_out: Any) -> None:
        kernels.multiply(inputs["h"], at, scratch)
        kernels.axpby(0.5, scratch, -1.0, inputs["b"], gradient_out)
        kernels.dot(at, gradient_out, value_out)
        kernels.axpby(1.0, scratch, -1.0, inputs["b"], gradient_out)

    def step() -> None:
        solver.propose(x, trial)
        evaluate(trial, trial_gradient, trial_value)
        solver.judge(value, trial_value)
        solver.learn(x, gradient, trial, trial_gradient)

    def work() -> None:
        kernels.clamp(inputs["start"], -1.0, 1.0, x)
        evaluate(x, gradient, value)
        solver.begin(x, gradient, value)
        kernels.repeat(step, solver.go_on, 300)

    # A minimum is as exact as a value is that no longer falls.
    return Program(inputs, work, {"x": x}, tolerance=2e-3)


def comparing(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """The data term of a light field that is loaded each time."""
    views = values["recorded"]
    inputs = {name: kernels.image(values[name], device) for name in ("image", "recorded")}
    inputs |= {name: kernels.field(values[name], device) for name in ("valid", "disparity")}
    offsets = kernels.field(values["offsets"], device)
    plan = kernels.data_term(views.shape, offsets, scale=1.0, softness=0.125)
    gradient, scaled = (kernels.zeros(views.shape[1:3], device) for _ in range(2))
    value, size = kernels.scalar(0.0, device), kernels.scalar(100.0, device)

    def work() -> None:
        plan.load(inputs["image"], inputs["recorded"], inputs["valid"])
        plan(inputs["disparity"], gradient, value)
        kernels.ratio(value, size, value)
        kernels.fill(value, scaled)

    return Program(inputs, work, {"gradient": gradient, "value": scaled})


def program_inputs(make: MakeProgram, rng: np.random.Generator) -> dict[str, Values]:
    """Random inputs of a program."""
    shape = 9, 11
    if make is counting:
        return {"left": np.full((1, 1), float(rng.integers(0, 9)))}
    if make is solving:
        weights = rng.random((len(half_window(WINDOW)), *shape))
        y, x = np.mgrid[: shape[0], : shape[1]]
        for w, (dy, dx) in zip(weights, half_window(WINDOW), strict=True):
            w[(y + dy >= shape[0]) | (x + dx < 0) | (x + dx >= shape[1])] = 0
        return {"weights": weights, "b": rng.normal(size=shape)}
    if make is minimizing:
        h = rng.uniform(1, 20, shape)
        return {"h": h, "b": 1.5 * h * rng.uniform(-1, 1, shape), "start": rng.uniform(-1.5, 1.5, shape)}
    offsets = np.array([[1.0, 0.0], [-1.0, 0.5], [0.0, 2.0]])
    recorded = rng.random((3, *shape, 3), np.float32)
    return {
        "image": rng.random((*shape, 3), np.float32),
        "recorded": recorded,
        "valid": (rng.random(recorded.shape[:3]) < 0.8).astype(np.float32),
        "disparity": np.round(rng.uniform(-1.5, 1.5, shape) * 2**10) / 2**10,
        "offsets": offsets,
    }


PROGRAMS: tuple[MakeProgram, ...] = (counting, solving, minimizing, comparing)


def check_repeat(kernels: KernelSet, device: str) -> None:
    """The body runs while `go_on` is positive, which is looked at before each call, but at most `most` times."""
    for left, most in ((0, 5), (1, 5), (3, 5), (5, 5), (9, 5), (3, 0), (-1, 2)):
        program = counting(kernels, device, {"left": np.full((1, 1), float(left))}, most)
        program.work()
        calls = float(program.read(kernels)["calls"][0, 0])
        want = max(0, min(left, most))
        assert calls == want, f"repeat called its body {calls:g} times, not {want} (to do: {left}, most: {most})"


def check_repeat_looks_seldom(kernels: KernelSet, device: str) -> None:
    """Loops one after the other, in which the host may go on for a while, end where each of them should."""
    trace = kernels.residuals(device, tolerance=2.0**-9, most=12)
    number, norm = (kernels.scalar(1.0, device) for _ in range(2))

    def halve() -> None:
        kernels.axpby(0.25, number, 0.0, number, number)  # the trace has its root
        trace.add(number)

    for start in (0, 0, 9, 4, 3, 5, 5, -5, 8, 2):
        kernels.copy(kernels.scalar(4.0**-start, device), number)
        trace.begin(norm)
        trace.add(number)
        kernels.repeat(halve, trace.go_on, 12, at_once=3)
        want = [2.0**-k for k in range(start, 10)][:13]
        assert trace.report() == want, f"a loop from {want[0]} to {want[-1]} ended at {trace.report()[-1]}"
        assert kernels.number(trace.go_on) <= 0, "there is nothing to do any more, but the loop would go on"


def check_program(kernels: KernelSet, device: str, make: MakeProgram, values: dict[str, Values]) -> None:
    """A program that minimises or solves finds what it should; every one gives what it gives in the reference."""
    program, true_program = make(kernels, device, values), make(load("reference"), "cpu", values)
    program.work()
    true_program.work()
    got, want = program.read(kernels), true_program.read(load("reference"))
    if make is minimizing:
        want = {"x": np.clip(values["b"] / values["h"], -1, 1)}
    _same_outputs(make.__name__, got, want, program.tolerance)


def check_capture(
    kernels: KernelSet, device: str, make: MakeProgram, first: dict[str, Values], second: dict[str, Values]
) -> bool:
    """Captured work does the same again, with what its inputs hold by then; False where it cannot be captured."""
    program, fresh = make(kernels, device, first), make(kernels, device, second)
    program.work()
    before = program.read(kernels)
    again = kernels.capture(program.work, device)
    if again is None:
        return False
    fresh.work()
    after = fresh.read(kernels)
    for values, want in ((second, after), (first, before), (second, after)):
        for name, array in program.inputs.items():
            kernels.upload(values[name], array)
        again()
        _same_outputs(f"captured {make.__name__}", program.read(kernels), want, program.tolerance)
    return True


def _same_outputs(what: str, got: dict[str, Values], want: dict[str, Values], tolerance: float) -> None:
    assert got.keys() == want.keys()
    for name in want:
        error = largest_error(got[name], want[name])
        assert error <= tolerance, f"{what}: {name} is off by {error:.2e}, more than {tolerance:.0e}"
