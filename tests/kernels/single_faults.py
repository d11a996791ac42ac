"""A backend with one single fault, and the tests that its checks catch it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import checks
import numpy as np
import programs
import pytest

from lfgpu._backends import load
from lfgpu.contract import KernelSet

REFERENCE = load("reference")


Check = Callable[[KernelSet, np.random.Generator], Any]
MakeInputs = Callable[[np.random.Generator], SimpleNamespace]


def program(make: programs.MakeProgram) -> Check:
    return lambda kernels, rng: programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng))


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


def values_of(
    operations: Sequence[checks.Operation], inputs: Mapping[str, MakeInputs]
) -> Callable[[str, MakeInputs | None], Check]:
    """From the name of an operation to its check against the reference, on `inputs` of its kind or on other ones."""

    def value_of(name: str, make: MakeInputs | None = None) -> Check:
        (operation,) = (operation for operation in operations if str(operation) == name)
        made = make or inputs[operation.inputs]
        return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, made(rng), 1e-5)

    return value_of


def single_fault_tests(faults: Sequence[Fault]) -> tuple[Callable[[Fault], None], Callable[[], None]]:
    """Two tests for a test file: each fault is caught by its check, and the reference as it is passes every check.

    Random numbers are the same each time: among new ones, a fault might now and then make no difference.
    """

    @pytest.mark.parametrize("fault", faults, ids=str)
    def single_fault_is_caught(fault: Fault) -> None:
        kernels = fault.kernels
        with pytest.raises(AssertionError), np.errstate(all="ignore"):
            fault.check(kernels, np.random.default_rng(0))

    def reference_passes() -> None:
        wrapped = with_operation("dot", REFERENCE.dot)  # so that it is the fault that is caught and not the wrapping
        for check in dict.fromkeys(fault.check for fault in faults):
            check(wrapped, np.random.default_rng(0))

    return single_fault_is_caught, reference_passes
