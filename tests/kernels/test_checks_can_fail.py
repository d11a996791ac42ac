"""Each check can fail: the reference with one single fault is caught by the very checks of the matrix.

The reference as it is passes them, so that it is the fault that is caught and not the wrapping. At the end, a whole
backend with a fault goes through the matrix itself, in a run of pytest of its own.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cases
import checks
import numpy as np
import pytest

from lfgpu._backends import load
from lfgpu.types import KernelSet, half_window

REFERENCE = load("reference")
SPLAT = cases.SplatCase("splat", offsets=cases.IRREGULAR, masked=True, dtype="uint8")
NLM = cases.NlmCase("nlm")
EPI = cases.EpiCase("epi", dtype="uint8", shear=0.75)
VECTOR = cases.VectorCase("vector", (11, 14))

Check = Callable[[KernelSet, np.random.Generator], Any]


def value_of(name: str) -> Check:
    """The check of one operation against the reference."""
    (operation,) = (operation for operation in checks.OPERATIONS if str(operation) == name)
    make: dict[str, Any] = {
        "splat": lambda rng: cases.splat_inputs(SPLAT, rng),
        "nlm": lambda rng: cases.nlm_inputs(NLM, rng),
        "epi": lambda rng: cases.epi_inputs(EPI, rng),
        "vector": lambda rng: cases.vector_inputs(VECTOR, rng),
    }
    return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, make[operation.inputs](rng), 1e-5)


def repeats_of(name: str) -> Check:
    (operation,) = (operation for operation in checks.OPERATIONS if str(operation) == name)
    return lambda kernels, rng: checks.check_repeats(kernels, "cpu", operation, cases.splat_inputs(SPLAT, rng))


def of_splat(check: Callable[[KernelSet, str, SimpleNamespace], Any]) -> Check:
    return lambda kernels, rng: check(kernels, "cpu", cases.splat_inputs(SPLAT, rng))


IMAGE_ADJOINT = of_splat(checks.check_image_adjoint)
DISPARITY_ADJOINT = of_splat(checks.check_disparity_adjoint)
MASKED_PIXELS = of_splat(checks.check_masked_pixels_do_not_count)
MASKED_VIEW = of_splat(checks.check_masked_view_is_a_missing_view)
NOTHING_VALID = of_splat(checks.check_nothing_valid_is_nothing_at_all)
DOUBLE_DOT: Check = lambda kernels, rng: checks.check_dot_in_double(kernels, "cpu")  # noqa: E731


def NLM_SYMMETRIC(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    checks.check_nlm_symmetric(kernels, "cpu", cases.nlm_inputs(NLM, rng))


def ENERGY(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    checks.check_energy(kernels, "cpu", cases.energy_inputs(cases.EnergyCase("energy"), rng), 1e-5)


@dataclass(frozen=True)
class Fault:
    """What is wrong, with which operation, and the check that must notice; `broken(right)` makes the wrong one."""

    what: str
    operation: str
    broken: Callable[[Callable[..., Any]], Callable[..., Any]]
    check: Check

    def __str__(self) -> str:
        return f"{self.operation}-{self.what}".replace(" ", "-")

    @property
    def kernels(self) -> KernelSet:
        return with_operation(self.operation, self.broken(getattr(REFERENCE, self.operation)))


def with_operation(name: str, operation: Any) -> KernelSet:
    """The reference with another operation in the place of one of its own."""
    return cast(KernelSet, SimpleNamespace(**{**vars(REFERENCE), name: operation}))


@pytest.fixture
def rng() -> np.random.Generator:
    """The same numbers each time: among new ones, a fault might now and then make no difference."""
    return np.random.default_rng(0)


# --- ways to be wrong: each turns a right operation into a wrong one ---


def after(change: Callable[[np.ndarray], Any], *outputs: str) -> Callable[..., Any]:
    """Outputs named `outputs` (or the last argument) are changed in place afterwards."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> Any:
            result = right(*args, **options)
            for output in [options[name] for name in outputs] or [args[-1]]:
                change(output)
            return result

        return wrong

    return broken


def before(change: Callable[[list[Any], dict[str, Any]], None]) -> Callable[..., Any]:
    """Arguments are changed before the operation sees them; `change` gets (positional, keyword)."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> Any:
            positional = list(args)
            change(positional, options)
            return right(*positional, **options)

        return wrong

    return broken


def planned(change: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Callable[..., Any]:
    """The plan that an operation makes is turned into a wrong one."""
    return lambda right: lambda *args, **options: change(right(*args, **options))


def accumulating(*outputs: str) -> Callable[..., Any]:
    """Adds to what the outputs held instead of overwriting it."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> None:
            held = [options[name].copy() for name in outputs]
            right(*args, **options)
            for name, old in zip(outputs, held, strict=True):
                options[name] += old

        return wrong

    return broken


def argument(index: int, change: Callable[[Any], Any]) -> Callable[..., Any]:
    def replace(args: list[Any], options: dict[str, Any]) -> None:
        args[index] = change(args[index])

    return before(replace)


def option(name: str, change: Callable[[Any], Any]) -> Callable[..., Any]:
    return before(lambda args, options: options.update({name: change(options[name])}))


def scaled(factor: float) -> Callable[[np.ndarray], None]:
    def change(output: np.ndarray) -> None:
        output *= factor

    return change


def zeroed(where: Any) -> Callable[[np.ndarray], None]:
    def change(output: np.ndarray) -> None:
        output[where] = 0

    return change


def noisy(output: np.ndarray) -> None:
    output += np.random.default_rng().normal(size=output.shape) * 1e-13


def one_off(output: np.ndarray) -> None:
    """One weight in the middle is wrong by one part in a thousand of the largest."""
    output[tuple(side // 2 for side in output.shape)] += 1e-3 * np.abs(output).max()


def without_tap(right: Callable[..., Any]) -> Callable[..., Any]:
    """The tap below and to the right is left out of the image of the splat and of its transpose alike."""

    def wrong(image: Any, disparity: Any, offsets: Any, *, softness: float, **outputs: Any) -> None:
        from lfgpu.kernels.reference.splat import taps  # the fault needs a look inside

        right(image, disparity, offsets, softness=softness, **outputs)
        for n, offset in enumerate(offsets):
            *_, tap = taps(disparity, offset, softness)
            np.subtract.at(outputs["views_out"][n], tap.target, tap.weight[:, None] * image[tap.inside])

    return wrong


def skewed(weights: np.ndarray) -> np.ndarray:
    """Weights that lie one column to the right of their pixels."""
    return np.roll(weights, 1, axis=2)


def without_itself(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(weights: np.ndarray, values: np.ndarray, *, window: int, sums_out: np.ndarray) -> None:
        right(weights, values, window=window, sums_out=sums_out)
        sums_out -= values

    return wrong


def mirrored(output: np.ndarray) -> None:
    output[:] = output[:, ::-1].copy()


def without_last_view(args: list[Any], options: dict[str, Any]) -> None:
    """Arguments of `data_term`: recorded views, mask and offsets end one earlier."""
    args[1:4] = [array[:-1] for array in args[1:4]]


def changing_its_input(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(x: Any, *args: Any, **options: Any) -> Any:
        result = right(x, *args, **options)
        x += 1
        return result

    return wrong


def swapped(offsets: np.ndarray) -> np.ndarray:
    return offsets[:, ::-1].copy()


def half(right: Callable[..., Any]) -> Callable[..., Any]:
    """Only pixels before their neighbour gather: one half of the window is forgotten."""

    def wrong(weights: np.ndarray, values: np.ndarray, *, window: int, sums_out: np.ndarray) -> None:
        sums_out[:] = values
        height, width = values.shape
        for w, (dy, dx) in zip(weights, half_window(window), strict=True):
            for y in range(height - dy):
                for x in range(max(0, -dx), min(width, width - dx)):
                    sums_out[y, x] += w[y, x] * values[y + dy, x + dx]

    return wrong


def half_gradient(plan: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(disparity: Any, gradient_out: Any) -> float:
        value = plan(disparity, gradient_out)
        gradient_out *= 0.5
        return float(value)

    return wrong


def remembering(plan: Callable[..., Any]) -> Callable[..., Any]:
    """Adds up the values of all its calls."""
    total = 0.0

    def wrong(disparity: Any, gradient_out: Any) -> float:
        nonlocal total
        total += plan(disparity, gradient_out)
        return total

    return wrong


def flipped_slope(plan: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(shear: float, disparity_out: Any, coherence_out: Any) -> None:
        plan(shear, disparity_out, coherence_out)
        disparity_out[:] = 2 * shear - disparity_out

    return wrong


def shear_forgotten(plan: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(shear: float, disparity_out: Any, coherence_out: Any) -> None:
        plan(shear, disparity_out, coherence_out)
        disparity_out -= shear

    return wrong


def root_of_coherence(plan: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(shear: float, disparity_out: Any, coherence_out: Any) -> None:
        plan(shear, disparity_out, coherence_out)
        coherence_out[:] = np.sqrt(coherence_out)

    return wrong


FAULTS = (
    # the splat
    Fault("without one tap", "splat", without_tap, value_of("splat")),
    Fault("without one tap, seen by the adjoint", "splat", without_tap, IMAGE_ADJOINT),
    Fault("rows and columns of offsets exchanged", "splat", argument(2, swapped), value_of("splat")),
    Fault("against the convention of signs", "splat", argument(2, np.negative), value_of("splat")),
    Fault("with a sharp tent", "splat", option("softness", lambda _: 1e-3), value_of("splat")),
    Fault("last view skipped", "splat", after(zeroed(-1), "views_out", "coverage_out"), value_of("splat")),
    Fault("coverage of the last view skipped", "splat", after(zeroed(-1), "coverage_out"), value_of("splat")),
    Fault("views mirrored", "splat", after(mirrored, "views_out"), IMAGE_ADJOINT),
    Fault("last row of pixels skipped", "splat", after(zeroed(np.s_[:, -1]), "views_out"), value_of("splat")),
    Fault("first channel only", "splat", after(zeroed(np.s_[..., 1:]), "views_out"), value_of("splat")),
    Fault("adds to its output", "splat", accumulating("views_out"), value_of("splat")),
    Fault("adds to its coverage", "splat", accumulating("coverage_out"), value_of("splat")),
    Fault("other bits each time", "splat", after(noisy, "views_out"), repeats_of("splat")),
    Fault("changes its input", "splat", changing_its_input, value_of("splat")),
    Fault("wrong sign", "splat_transpose", after(scaled(-1), "image_out"), IMAGE_ADJOINT),
    Fault("one pixel off", "splat_transpose", after(one_off, "image_out"), value_of("splat_transpose")),
    Fault(
        "last view skipped",
        "splat_transpose",
        argument(0, lambda v: v * (np.arange(len(v)) < len(v) - 1)[:, None, None, None]),
        IMAGE_ADJOINT,
    ),
    Fault("wrong sign", "splat_jvp", after(scaled(-1), "views_out"), DISPARITY_ADJOINT),
    Fault("wrong sign, against the reference", "splat_jvp", after(scaled(-1), "views_out"), value_of("splat_jvp")),
    Fault("rows and columns of offsets exchanged", "splat_jvp", argument(3, swapped), DISPARITY_ADJOINT),
    Fault("wrong sign", "splat_vjp", after(scaled(-1), "gradient_out"), value_of("splat_vjp")),
    Fault("wrong sign, seen by the adjoint", "splat_vjp", after(scaled(-1), "gradient_out"), DISPARITY_ADJOINT),
    Fault("horizontal part only", "splat_vjp", argument(3, lambda o: o * (1, 0)), value_of("splat_vjp")),
    Fault("one pixel off", "splat_vjp", after(one_off, "gradient_out"), DISPARITY_ADJOINT),
    Fault("mirrored", "splat_vjp", after(mirrored, "gradient_out"), value_of("splat_vjp")),
    # the data term
    Fault("factor 2 of the gradient missing", "data_term", planned(half_gradient), value_of("data_term")),
    Fault("remembers", "data_term", planned(remembering), value_of("data_term")),
    Fault("scale ignored", "data_term", option("scale", lambda _: 1.0), value_of("data_term")),
    Fault("mask ignored", "data_term", argument(2, lambda _: None), value_of("data_term")),
    Fault("mask ignored, seen without a truth", "data_term", argument(2, lambda _: None), MASKED_PIXELS),
    Fault("masked view counts", "data_term", argument(2, lambda _: None), MASKED_VIEW),
    Fault("mask ignored, seen where nothing is valid", "data_term", argument(2, lambda _: None), NOTHING_VALID),
    Fault("factor 2 of the gradient missing, seen in the energy", "data_term", planned(half_gradient), ENERGY),
    Fault("mask the other way round", "data_term", argument(2, lambda v: None if v is None else 1 - v), MASKED_PIXELS),
    Fault("last view skipped", "data_term", before(without_last_view), value_of("data_term")),
    Fault("softness ignored", "data_term", option("softness", lambda _: 0.5), value_of("data_term")),
    Fault(
        "a float32 as value",
        "data_term",
        planned(lambda plan: lambda d, g: np.float32(plan(d, g))),
        value_of("data_term"),
    ),
    # the prior
    Fault("one weight off", "nlm_weights", after(one_off, "weights_out"), value_of("nlm_weights")),
    Fault("floor ignored", "nlm_weights", option("floor", lambda _: 0.0), value_of("nlm_weights")),
    Fault(
        "floor beyond the border",
        "nlm_weights",
        after(lambda w: np.maximum(w, 1e-3, out=w), "weights_out"),
        value_of("nlm_weights"),
    ),
    Fault("patch ignored", "nlm_weights", option("patch", lambda _: 1), value_of("nlm_weights")),
    Fault("colour ignored", "nlm_weights", option("sigma_color", lambda _: 1e3), value_of("nlm_weights")),
    Fault("gradient ignored", "nlm_weights", option("sigma_gradient", lambda _: 1e3), value_of("nlm_weights")),
    Fault("first channel only", "nlm_weights", argument(0, lambda image: image[..., :1]), value_of("nlm_weights")),
    Fault("without the pixel itself", "nlm_neighbors", without_itself, value_of("nlm_neighbors")),
    Fault("without the pixel itself, seen by L", "nlm_neighbors", after(scaled(0.999), "sums_out"), NLM_SYMMETRIC),
    Fault("one half of the window", "nlm_neighbors", half, value_of("nlm_neighbors")),
    Fault("one half of the window, seen by symmetry", "nlm_neighbors", half, NLM_SYMMETRIC),
    Fault("weights of the pixel beside", "nlm_laplacian", argument(0, skewed), value_of("nlm_laplacian")),
    Fault("wrong sign", "nlm_laplacian", after(scaled(-1), "laplacian_out"), NLM_SYMMETRIC),
    Fault("factor 2 too much", "nlm_laplacian", after(scaled(2), "laplacian_out"), value_of("nlm_laplacian")),
    Fault(
        "a constant is not smooth",
        "nlm_laplacian",
        after(lambda a: np.add(a, 1e-3, out=a), "laplacian_out"),
        NLM_SYMMETRIC,
    ),
    Fault("factor 2 too much, seen in the energy", "nlm_laplacian", after(scaled(2), "laplacian_out"), ENERGY),
    # the local estimate
    Fault("wrong sign", "structure_tensor", planned(flipped_slope), value_of("structure_tensor")),
    Fault("shear not added", "structure_tensor", planned(shear_forgotten), value_of("structure_tensor")),
    Fault("root of coherence", "structure_tensor", planned(root_of_coherence), value_of("structure_tensor")),
    Fault("floor ignored", "structure_tensor", option("floor", lambda _: 0.3), value_of("structure_tensor")),
    Fault("scale ignored", "structure_tensor", option("scale", lambda _: 1.0), value_of("structure_tensor")),
    Fault(
        "views in the wrong order",
        "structure_tensor",
        argument(0, lambda epis: epis[::-1]),
        value_of("structure_tensor"),
    ),
    Fault("offsets ignored", "structure_tensor", argument(1, np.zeros_like), value_of("structure_tensor")),
    Fault(
        "no outer window",
        "structure_tensor",
        argument(2, lambda f: f._replace(across_outer=np.ones(1))),
        value_of("structure_tensor"),
    ),
    # vectors
    Fault("in float32", "dot", lambda right: lambda a, b: float(np.float32(right(a, b))), DOUBLE_DOT),
    Fault("of sizes", "dot", lambda right: lambda a, b: right(np.abs(a), np.abs(b)), value_of("dot")),
    Fault(
        "last element skipped", "dot", lambda right: lambda a, b: right(a.ravel()[:-1], b.ravel()[:-1]), value_of("dot")
    ),
    Fault("nothing done", "copy", lambda right: lambda source, target_out: None, value_of("copy")),
    Fault(
        "numbers exchanged",
        "axpby",
        before(lambda a, _: a.__setitem__(slice(0, 3, 2), [a[2], a[0]])),
        value_of("axpby"),
    ),
    Fault(
        "adds to its output",
        "axpby",
        lambda right: lambda a, x, b, y, out: np.add(a * x + b * y, out, out=out),
        value_of("axpby"),
    ),
    Fault("a sum", "multiply", lambda right: lambda x, y, out: np.add(x, y, out=out), value_of("multiply")),
    Fault("upper bound ignored", "clamp", argument(2, lambda _: 1e9), value_of("clamp")),
    Fault("changes its input", "clamp", changing_its_input, value_of("clamp")),
    # memory
    Fault("no copy", "field", lambda right: lambda values, device: np.asarray(values), value_of("memory")),
    Fault("not zero", "zeros", lambda right: lambda shape, device: np.ones(shape), value_of("memory")),
    Fault("of another shape", "zeros", lambda right: lambda shape, device: np.zeros((*shape, 1)), value_of("memory")),
    Fault("no copy", "numpy", lambda right: lambda array: array, value_of("memory")),
    Fault("of another dtype", "numpy", lambda right: lambda array: right(array).astype(np.float32), value_of("copy")),
    Fault(
        "channels first",
        "image",
        lambda right: lambda values, device: right(np.moveaxis(values, -1, 0), device),
        value_of("image_memory"),
    ),
    Fault(
        "scaled", "image", lambda right: lambda values, device: right(values, device) / 255, value_of("image_memory")
    ),
    Fault("not zero", "zeros_image", lambda right: lambda shape, device: np.ones(shape), value_of("image_memory")),
)


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_single_fault_is_caught(fault: Fault, rng: np.random.Generator) -> None:
    with pytest.raises(AssertionError):
        fault.check(fault.kernels, rng)


def test_reference_passes_every_check_that_catches_faults(rng: np.random.Generator) -> None:
    wrapped = with_operation("dot", REFERENCE.dot)
    for fault in FAULTS:
        fault.check(wrapped, rng)


def test_every_operation_has_a_fault_that_its_check_catches() -> None:
    broken = {fault.operation for fault in FAULTS}
    assert broken == {str(operation) for operation in checks.OPERATIONS} - {"memory", "image_memory"} | {
        *("field", "image", "zeros", "zeros_image", "numpy")
    }


# --- a whole broken backend, in the matrix itself ---

ROOT = Path(__file__).parents[2]
REGISTRATION = """
import lfgpu.kernels
from lfgpu import _backends

lfgpu.kernels.__path__.append({folder!r})
_backends._PACKAGES["copied"] = "numpy"
"""
OFFSETS, FLIPPED = "zip(residual, offsets, strict=True)", "zip(residual, offsets * (-1, 1), strict=True)"
"""In `splat_vjp`: the sign of du is the wrong one. The data term of the copy goes through it too."""


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} does not stand once in {path.name}: this test needs another fault"
    path.write_text(text.replace(old, new))


def outcomes_of_the_matrix(folder: Path, cases: str) -> dict[str, str]:
    """Outcome of each test of the matrix for the backend `copied`, a package in that folder."""
    (folder / "register_copied.py").write_text(REGISTRATION.format(folder=str(folder)))
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    options = ("-p", "register_copied", "-p", "no:cacheprovider", "-rA", "--tb=no", "--backend=copied", "-k", cases)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(ROOT / "tests" / "kernels" / "test_matrix.py")],
        cwd=ROOT,
        env={**environment, "PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        timeout=120,
    )
    found = re.findall(r"^(PASSED|FAILED|ERROR) \S+::(\S+)", done.stdout, re.MULTILINE)
    assert found, done.stdout + done.stderr
    return {test: outcome for outcome, test in found}


@pytest.mark.parametrize("fault", [False, True], ids=["right", "broken"])
def test_matrix_finds_a_new_backend_and_what_is_wrong_with_it(fault: bool, tmp_path: Path) -> None:
    copied = shutil.copytree(ROOT / "kernels" / "reference", tmp_path / "copied")
    edit(copied / "backend.py", 'name = "reference"', 'name = "copied"')
    if fault:
        edit(copied / "splat.py", OFFSETS, FLIPPED)
    outcomes = outcomes_of_the_matrix(tmp_path, "one-row-of-views or devices_are_names")
    wrong = {
        "test_operation_equals_the_reference[copied-cpu-splat_vjp-one-row-of-views]",
        "test_operation_equals_the_reference[copied-cpu-data_term-one-row-of-views]",
        "test_splat_vjp_is_the_adjoint_of_splat_jvp[copied-cpu-one-row-of-views]",
        "test_energy_and_its_gradient[copied-cpu-one-row-of-views]",
    }
    assert wrong <= outcomes.keys()
    assert len(outcomes) > 2 * len(wrong)
    assert outcomes == {test: "FAILED" if fault and test in wrong else "PASSED" for test in outcomes}
