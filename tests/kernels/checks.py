"""The checks of the kernel matrix. Each takes a backend, and raises AssertionError where it breaks the contract.

They know nothing of pytest, so that `test_mutants.py` can hold broken backends to them.

Disparities, offsets and shears of cases have so few binary digits that their products are exact in float32: every
backend lands at the same place, so that what differs is its arithmetic. `exact=False` leaves that out and says by how
much the place may differ.
"""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import load
from lfgpu.contract import KernelSet

Values = NDArray[Any]
Outputs = dict[str, Any]
"""Fields and images of a backend, floats that it gave, and lists of such."""
FLOAT32_STEP = 2.0**-24  # half the distance of neighbouring float32 numbers around 1


@dataclass(frozen=True)
class Case:
    """A case of the matrix by its name, which its tests carry."""

    name: str

    def __str__(self) -> str:
        return self.name.replace(" ", "-")

    @property
    def tolerance(self) -> float:
        """Relative error of a float32 backend."""
        return 1e-5


def grid(rows: int, columns: int) -> tuple[tuple[float, float], ...]:
    """Offsets (du, dv) of a grid of views from its middle one, which is among them."""
    return tuple((float(u - columns // 2), float(v - rows // 2)) for v in range(rows) for u in range(columns))


IRREGULAR = ((0.328125, -1.0), (-1.71875, 0.40625), (2.015625, 1.140625), (-0.046875, -2.28125))


def stored(intensities: NDArray[np.float64], dtype: str) -> NDArray[Any]:
    """Intensities in [0, 1] as a file of that dtype holds them."""
    if dtype.startswith("float"):
        return intensities.astype(dtype)
    return np.rint(intensities * np.iinfo(dtype).max).astype(dtype)


def scale_of(dtype: str) -> float:
    return 1.0 if dtype.startswith("float") else 1.0 / np.iinfo(dtype).max


def float32(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def coarse(values: NDArray[Any], step: float) -> NDArray[np.float32]:
    return float32(np.round(values / step) * step)


class Desk:
    """Arrays of one backend on one device: inputs whose changes would be noticed, outputs that hold garbage."""

    def __init__(self, kernels: KernelSet, device: str) -> None:
        self.kernels, self.device = kernels, device
        self._inputs: list[tuple[Any, Values]] = []
        self._numbers: list[tuple[Any, float]] = []

    def field(self, values: Values) -> Any:
        return self._remember(self.kernels.field(values, self.device))

    def image(self, values: Values) -> Any:
        return self._remember(self.kernels.image(values, self.device))

    def out(self, shape: tuple[int, ...]) -> Any:
        return self.kernels.field(np.full(shape, np.nan, np.float32), self.device)

    def image_out(self, shape: tuple[int, ...]) -> Any:
        return self.kernels.image(np.full(shape, np.nan, np.float32), self.device)

    def stored_out(self, shape: tuple[int, ...], stored: Any) -> Any:
        """An image of garbage of the NumPy type `stored`."""
        out = self.kernels.zeros_image(shape, self.device, stored)
        garbage = np.nan if np.dtype(stored).kind == "f" else np.iinfo(stored).max
        self.kernels.upload(np.full(shape, garbage, stored), out)
        return out

    def held(self, values: Values) -> Any:
        """A field that is input and output."""
        return self.kernels.field(values, self.device)

    def number(self, value: float) -> Any:
        scalar = self.kernels.scalar(value, self.device)
        self._numbers.append((scalar, value))
        return scalar

    def number_out(self, value: float = np.nan) -> Any:
        return self.kernels.scalar(value, self.device)

    def stored_values(self, image: Any) -> Any:
        """What an image holds as a field: stored values are whole numbers or floats, whatever they are read as."""
        return self.kernels.field(self.kernels.numpy(image), self.device)

    def load_within(self, plan: Any, image: Values, recorded: Values, valid: Any) -> None:
        """Load views in memory of garbage, if the plan asks for some; then it has to use it."""
        floats = plan.room(recorded.dtype.type)
        room = self.out((floats,)) if floats else None
        plan.load(self.image(image), self.image(recorded), valid, room)
        assert room is None or not np.isnan(self.kernels.numpy(room)).all(), "memory was asked for in vain"

    def check_inputs_unchanged(self) -> None:
        for array, before in self._inputs:
            np.testing.assert_array_equal(self.kernels.numpy(array), before, "an input was changed")
        for scalar, number in self._numbers:
            np.testing.assert_equal(self.kernels.number(scalar), number, "a number was changed")

    def _remember(self, array: Any) -> Any:
        self._inputs.append((array, self.kernels.numpy(array).copy()))
        return array


def names_of(contract: type) -> set[str]:
    """The names of all operations and facts of a contract; what only some backends have is left out."""
    named = {name for base in contract.__mro__ for name in vars(base) if base.__module__.startswith("lfgpu.contract")}
    return {name for name in named if not name.startswith("_")} - {"streaming", "recording", "changing"}


Errors = Callable[[dict[str, Values], dict[str, Values], SimpleNamespace], dict[str, float]]


def largest_error(got: Values, want: Values, scale: float | None = None) -> float:
    """max |got - want| relative to `scale`, by default max |want|; 0 where both are 0."""
    error = float(np.abs(np.asarray(got, np.float64) - want).max(initial=0))
    scale = float(np.abs(want).max(initial=0)) if scale is None else scale
    return error / scale if scale else (0.0 if error == 0 else np.inf)


def relative_to_terms(**terms: Callable[[SimpleNamespace], float]) -> Errors:
    """Relative to max |want|, or where sums nearly cancel (on images of few pixels) to a tenth of their largest term.

    `terms` gives that term's size for each output in which terms of different signs are added.
    """

    def errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
        least = {name: 0.1 * terms[name](i) if name in terms else 0.0 for name in want}
        return {
            name: largest_error(got[name], want[name], max(float(np.abs(want[name]).max()), least[name]))
            for name in want
        }

    return errors


NOT_CANCELLING = relative_to_terms()


def size(*arrays: Values) -> float:
    """The product of the arrays' largest absolute values."""
    return float(np.prod([np.abs(array).max() for array in arrays]))


@dataclass(frozen=True)
class Operation:
    """One operation of `KernelSet`: how to run it, which inputs it takes, how errors are measured."""

    run: Callable[[Desk, SimpleNamespace], Outputs]
    inputs: str
    errors: Errors = NOT_CANCELLING

    def __str__(self) -> str:
        return self.run.__name__


def compute(kernels: KernelSet, device: str, operation: Operation, inputs: SimpleNamespace) -> dict[str, Values]:
    """The operation's outputs as NumPy arrays; checks what needs no truth: dtypes, and that inputs are unchanged."""
    desk = Desk(kernels, device)
    outputs = operation.run(desk, inputs)
    desk.check_inputs_unchanged()
    read: dict[str, Values] = {}
    for name, output in outputs.items():
        if isinstance(output, float | list):
            assert all(isinstance(number, float) for number in np.ravel(np.array(output, object))), (
                f"{operation}: {name}"
            )
            read[name] = np.array(output, np.float64)
            continue
        assert not np.isscalar(output), f"{operation}: {name} is a {type(output).__name__}, not a float"
        read[name] = kernels.numpy(output)
        assert read[name].dtype == kernels.dtype, f"{operation}: {name} is {read[name].dtype}, not {kernels.dtype}"
    return read


def check_value(
    kernels: KernelSet,
    device: str,
    operation: Operation,
    inputs: SimpleNamespace,
    tolerance: float,
    want: dict[str, Values] | None = None,
    *,
    again: bool = False,
) -> dict[str, float]:
    """Compare an operation, whose outputs held garbage, with the reference; return the errors.

    `want` is what the reference gives, where that is known. With `again` it is run twice and has to give the same bits.
    """
    want = want or compute(load("reference"), "cpu", operation, inputs)
    got = compute(kernels, device, operation, inputs)
    errors = check_outputs(operation, got, want, inputs, tolerance)
    if again:
        check_same_bits(operation, got, compute(kernels, device, operation, inputs))
    return errors


def check_outputs(
    operation: Operation, got: dict[str, Values], want: dict[str, Values], inputs: SimpleNamespace, tolerance: float
) -> dict[str, float]:
    """Compare what a backend gave with what the reference gives; return the errors."""
    assert got.keys() == want.keys()
    for name in want:
        assert got[name].shape == want[name].shape, f"{operation}: {name} is {got[name].shape}, not {want[name].shape}"
        assert np.isfinite(got[name]).all(), f"{operation}: {name} is not finite everywhere"
    errors = operation.errors(got, want, inputs)
    for name, error in errors.items():
        assert error <= tolerance, f"{operation}: {name} is off by {error:.2e}, more than {tolerance:.0e}"
    # Python's own numbers: workers of pytest-xdist end without a word where a report holds any of NumPy's.
    return {name: float(error) for name, error in errors.items()}


def check_same_bits(operation: Operation, first: dict[str, Values], second: dict[str, Values]) -> None:
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], f"{operation}: {name} differs between runs")
