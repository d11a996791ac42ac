"""The matrix: backend x device x operation x case. The reference is the truth, backends are found by themselves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cases
import checks
import numpy as np
import pytest

from lfgpu import types

CASES: dict[str, tuple[Any, ...]] = {
    "splat": cases.SPLAT_CASES,
    "nlm": cases.NLM_CASES,
    "epi": cases.EPI_CASES,
    "vector": cases.VECTOR_CASES,
}
MAKERS: dict[str, Any] = {
    "splat": cases.splat_inputs,
    "nlm": cases.nlm_inputs,
    "epi": cases.epi_inputs,
    "vector": cases.vector_inputs,
}
CELLS = [
    pytest.param(operation, case, id=f"{operation}-{case}")
    for operation in checks.OPERATIONS
    for case in CASES[operation.inputs]
]
MASKED = [case for case in cases.SPLAT_CASES if case.masked]


def test_matrix_has_every_operation_of_the_contract() -> None:
    contract = {name for name in vars(types.KernelSet) if not name.startswith("_")} - {"name", "dtype", "devices"}
    covered = {str(operation) for operation in checks.OPERATIONS} - {"memory", "image_memory"}
    memory = {"field", "image", "zeros", "zeros_image", "numpy"}  # in every check, and in the two about memory
    assert contract == covered | memory


def test_backend_and_device_are_here(absent: Any) -> None:
    pytest.skip(f"{absent}: {absent.reason}")


@pytest.mark.parametrize(("operation", "case"), CELLS)
def test_operation_equals_the_reference(
    other: Any, operation: checks.Operation, case: Any, rng: np.random.Generator, record_property: Any
) -> None:
    inputs = MAKERS[operation.inputs](case, rng)
    errors = checks.check_value(other.kernels, other.device, operation, inputs, case.tolerance)
    for output, error in errors.items():
        record_property(f"{operation} {output}", error)


@pytest.mark.parametrize(("operation", "case"), CELLS)
def test_same_bits_when_run_again_on_a_cpu(
    other: Any, operation: checks.Operation, case: Any, rng: np.random.Generator
) -> None:
    if other.device != "cpu":
        pytest.skip("sums in an order that a GPU decides")
    checks.check_repeats(other.kernels, other.device, operation, MAKERS[operation.inputs](case, rng))


@pytest.mark.parametrize("case", cases.SPLAT_CASES, ids=str)
def test_splat_transpose_is_the_adjoint_of_splat(target: Any, case: cases.SplatCase, rng: np.random.Generator) -> None:
    checks.check_image_adjoint(target.kernels, target.device, cases.splat_inputs(case, rng))


@pytest.mark.parametrize("case", cases.SPLAT_CASES, ids=str)
def test_splat_vjp_is_the_adjoint_of_splat_jvp(target: Any, case: cases.SplatCase, rng: np.random.Generator) -> None:
    checks.check_disparity_adjoint(target.kernels, target.device, cases.splat_inputs(case, rng))


@pytest.mark.parametrize("case", cases.NLM_CASES, ids=str)
def test_nlm_operators_are_symmetric_and_belong_together(
    target: Any, case: cases.NlmCase, rng: np.random.Generator
) -> None:
    checks.check_nlm_symmetric(target.kernels, target.device, cases.nlm_inputs(case, rng))


@pytest.mark.parametrize("case", MASKED, ids=str)
def test_masked_pixels_do_not_count(target: Any, case: cases.SplatCase, rng: np.random.Generator) -> None:
    checks.check_masked_pixels_do_not_count(target.kernels, target.device, cases.splat_inputs(case, rng))


@pytest.mark.parametrize("case", MASKED, ids=str)
def test_masked_view_is_a_missing_view(target: Any, case: cases.SplatCase, rng: np.random.Generator) -> None:
    checks.check_masked_view_is_a_missing_view(target.kernels, target.device, cases.splat_inputs(case, rng))


def test_all_out_of_the_frame_is_nothing_at_all(target: Any, rng: np.random.Generator) -> None:
    (case,) = (case for case in cases.SPLAT_CASES if case.name == "all out of the frame")
    inputs: SimpleNamespace = cases.splat_inputs(case, rng)
    for run in (checks.splat, checks.splat_transpose, checks.splat_jvp, checks.splat_vjp):
        operation = checks.operation_of(run)
        for name, output in checks.compute(target.kernels, target.device, operation, inputs).items():
            assert not output.any(), f"{operation}: {name}"


def test_dot_accumulates_in_float64(target: Any) -> None:
    checks.check_dot_in_double(target.kernels, target.device)


def test_devices_are_names_with_the_default_first(target: Any) -> None:
    devices = target.kernels.devices()
    assert target.device in devices
    assert "cpu" in devices
    assert len(set(devices)) == len(devices)
    assert target.kernels.name == target.backend
