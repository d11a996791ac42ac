"""Of every operation of the contract there is a fault that a check catches."""

from __future__ import annotations

import checks
import test_alignment_checks_can_fail
import test_occlusion_checks_can_fail
import test_range_search_reference
import test_resampling
import test_smoothing_checks_can_fail
import test_solver_checks_can_fail
import test_splat_checks_can_fail
import test_sweep_checks_can_fail
import test_vector_checks_can_fail
import test_view_checks_can_fail
import test_volume_checks_can_fail

from lfgpu.contract import KernelSet

FAULTS = (
    *test_alignment_checks_can_fail.FAULTS,
    *test_occlusion_checks_can_fail.FAULTS,
    *test_range_search_reference.FAULTS,
    *test_resampling.FAULTS,
    *test_smoothing_checks_can_fail.FAULTS,
    *test_solver_checks_can_fail.FAULTS,
    *test_splat_checks_can_fail.FAULTS,
    *test_sweep_checks_can_fail.FAULTS,
    *test_vector_checks_can_fail.FAULTS,
    *test_view_checks_can_fail.FAULTS,
    *test_volume_checks_can_fail.FAULTS,
)
FACTS = {"name", "dtype", "devices", "is_deterministic", "asking", "kernel_cache", "compiles"}


def test_every_operation_has_a_fault_that_its_check_catches() -> None:
    assert {fault.operation for fault in FAULTS} == checks.names_of(KernelSet) - FACTS
