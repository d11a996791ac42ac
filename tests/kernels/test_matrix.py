"""The matrix: backend x device x operation x case. The reference is the truth, backends are found by themselves."""

import os
import pkgutil
import re
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import alignment_cases
import alignment_checks
import checks
import learned_cases
import learned_checks
import local_cases
import local_checks
import nlm_cases
import nlm_checks
import numpy as np
import occlusion_cases
import occlusion_checks
import programs
import pytest
import range_search_cases
import range_search_checks
import resampling_cases
import resampling_checks
import smoothing_cases
import smoothing_checks
import solver_cases
import solver_checks
import splat_cases
import splat_checks
import streaming_cases
import streaming_checks
import sweep_cases
import sweep_checks
import vector_cases
import vector_checks
import view_cases
import view_checks
import volume_cases
import volume_checks
import without_truth
from conftest import SEED

from lfgpu import _backends
from lfgpu import contract as types

INPUTS: dict[str, tuple[tuple[Any, ...], Any]] = {
    "splat": (splat_cases.SPLAT_CASES, splat_cases.splat_inputs),
    "occlusion": (occlusion_cases.OCCLUSION_CASES, occlusion_cases.occlusion_inputs),
    "alignment": (alignment_cases.ALIGNMENT_CASES, alignment_cases.alignment_inputs),
    "ratio": (alignment_cases.RATIO_CASES, alignment_cases.ratio_inputs),
    "outline": (alignment_cases.OUTLINE_CASES, alignment_cases.outline_inputs),
    "sweep": (sweep_cases.SWEEP_CASES, sweep_cases.sweep_inputs),
    "sectors": (learned_cases.SECTOR_CASES, learned_cases.sector_inputs),
    "convolution": (learned_cases.CONVOLUTION_CASES, learned_cases.convolution_inputs),
    "peak": (learned_cases.PEAK_CASES, learned_cases.peak_inputs),
    "seen": (splat_cases.SEEN_CASES, splat_cases.seen_inputs),
    "views": (view_cases.VIEWS_CASES, view_cases.views_inputs),
    "resampling": (resampling_cases.RESAMPLING_CASES, resampling_cases.resampling_inputs),
    "smoothing": (smoothing_cases.SMOOTHING_CASES, smoothing_cases.smoothing_inputs),
    "reduction": (smoothing_cases.REDUCTION_CASES, smoothing_cases.smoothing_inputs),
    "nlm": (nlm_cases.NLM_CASES, nlm_cases.nlm_inputs),
    "volume": (volume_cases.VOLUME_CASES, volume_cases.volume_inputs),
    "reduced": (volume_cases.REDUCED_CASES, volume_cases.volume_inputs),
    "range search": (range_search_cases.RANGE_SEARCH_CASES, range_search_cases.range_search_inputs),
    "epi": (local_cases.EPI_CASES, local_cases.epi_inputs),
    "coherence": (local_cases.COHERENCE_CASES, local_cases.coherence_inputs),
    "vector": (vector_cases.VECTOR_CASES, vector_cases.vector_inputs),
    "residuals": (solver_cases.RESIDUALS_CASES, solver_cases.residuals_inputs),
    "lbfgs": (solver_cases.LBFGS_CASES, solver_cases.lbfgs_inputs),
    "streaming": (streaming_cases.STREAMING_CASES, streaming_cases.streaming_inputs),
}
"""Of each kind of inputs: the cases, and what makes them of a case."""
OPERATIONS = (
    *splat_checks.OPERATIONS,
    *view_checks.OPERATIONS,
    *nlm_checks.OPERATIONS,
    *local_checks.OPERATIONS,
    *vector_checks.OPERATIONS,
    *solver_checks.OPERATIONS,
    *occlusion_checks.OPERATIONS,
    *sweep_checks.OPERATIONS,
    *volume_checks.OPERATIONS,
    *learned_checks.OPERATIONS,
    *alignment_checks.OPERATIONS,
    *resampling_checks.OPERATIONS,
    *smoothing_checks.OPERATIONS,
    *range_search_checks.OPERATIONS,
    *streaming_checks.OPERATIONS,
)
PROGRAMS = (
    *programs.PROGRAMS,
    sweep_checks.sweeping,
    volume_checks.finding_the_lowest,
    range_search_checks.finding_what_is_distinct,
    alignment_checks.stepping,
    smoothing_checks.showing_less_noise,
    learned_checks.finding_the_peak,
)
UNORDERED = ("splat", "splat_z_buffered")
"""Operations that no estimate needs, so that they may add atomically on a GPU."""

CELLS = [
    pytest.param(operation, case, id=f"{operation}-{case}")
    for operation in OPERATIONS
    for case in INPUTS[operation.inputs][0]
]


def test_matrix_has_every_operation_of_the_contract() -> None:
    facts = {"name", "dtype", "devices", "is_deterministic", "asking", "kernel_cache", "compiles"}
    contract = checks.names_of(types.KernelSet) - facts
    streams = {str(operation) for operation in streaming_checks.OPERATIONS}
    assert streams == checks.names_of(types.Streaming)
    covered = {str(operation) for operation in OPERATIONS} - {"memory", "image_memory"} - streams
    memory = {
        "field",
        "image",
        "zeros",
        "zeros_image",
        "clear",
        "scalar",
        "upload",
        "numpy",
        "number",
    }  # in the two about memory
    alone = {"repeat", "capture", "prepare", "shared"}  # in checks of their own
    assert contract == covered | memory | alone


PAGE = (Path(__file__).parents[2] / "kernels" / "README.md").read_text(encoding="utf-8")


def test_page_on_new_backends_names_the_whole_contract() -> None:
    contract = checks.names_of(types.KernelSet) | {"streaming", "recording"}
    assert contract == {name for name in contract if f"`{name}`" in PAGE}


def test_page_on_new_backends_names_files_and_leaves_that_there_are() -> None:
    folder = Path(__file__).parents[2] / "kernels" / "reference"
    assert all(f"`{path.name}`" in PAGE for path in folder.glob("*.py"))
    for leaf in re.findall(r"`(lfgpu\.\w+(?:\.\w+)?)`", PAGE):
        assert pkgutil.resolve_name(leaf) is not None


def test_example_of_the_page_is_a_backend(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.setattr(_backends, "_PACKAGES", dict(_backends._PACKAGES))
    monkeypatch.setitem(sys.modules, "lfgpu.kernels.mine", None)  # so that it is gone again afterwards
    exec(compile(example, "mine.py", "exec"), {})
    kernels = _backends.load("mine")
    assert kernels.name == "mine"
    assert kernels.dot is not _backends.load("reference").dot
    inputs = vector_cases.vector_inputs(vector_cases.VECTOR_CASES[0], rng)
    checks.check_value(kernels, "cpu", vector_checks.DOT, inputs, 1e-12)


def test_backend_and_device_are_here(named: Any) -> None:
    """Backends and devices that are not here are skipped, with the reason."""
    assert named.device in named.kernels.devices()


class Cell(NamedTuple):
    """The inputs of all backends for one operation and one case, and the outputs of the reference."""

    inputs: SimpleNamespace
    want: dict[str, checks.Values]


@cache
def cell(name: str) -> Cell:
    """Compute the cell of a name in `CELLS` once for all backends; random inputs follow from the run's seed."""
    operation, case = next(param.values for param in CELLS if param.id == name)
    rng = np.random.default_rng([int(os.environ[SEED]), *name.encode()])
    inputs = INPUTS[operation.inputs][1](case, rng)
    return Cell(inputs, checks.compute(_backends.load("reference"), "cpu", operation, inputs))


@pytest.mark.parametrize(("operation", "case"), CELLS)
def test_operation_equals_the_reference(
    other: Any, operation: checks.Operation, case: Any, record_property: Any
) -> None:
    """Twice, with the same bits, except where a GPU decides about the order of sums."""
    if operation.inputs == "streaming" and other.kernels.streaming is None:
        pytest.skip("a backend without streams")
    inputs, want = cell(f"{operation}-{case}")
    ordered = other.device == "cpu" or (
        other.kernels.is_deterministic(other.device) and str(operation) not in UNORDERED
    )
    errors = checks.check_value(other.kernels, other.device, operation, inputs, case.tolerance, want, again=ordered)
    for output, error in errors.items():
        record_property(f"{operation} {output}", error)


def test_errors_can_be_recorded() -> None:
    """They are Python's numbers, whatever computed them; workers of pytest-xdist cannot send NumPy's."""
    operation = checks.Operation(vector_checks.DOT.run, "vector", lambda got, want, i: {"dot": np.float64(0)})
    inputs = vector_cases.vector_inputs(vector_cases.VECTOR_CASES[0], np.random.default_rng(0))
    errors = checks.check_value(_backends.load("reference"), "cpu", operation, inputs, 0.0)
    assert [type(error) for error in errors.values()] == [float]


@pytest.mark.parametrize("check", without_truth.CHECKS, ids=str)
def test_check_that_knows_no_truth(target: Any, check: without_truth.Check, rng: np.random.Generator) -> None:
    check.run(target.kernels, target.device, *check.make(rng))


def test_all_out_of_the_frame_is_nothing_at_all(target: Any, rng: np.random.Generator) -> None:
    (case,) = (case for case in splat_cases.SPLAT_CASES if case.name == "all out of the frame")
    inputs: SimpleNamespace = splat_cases.splat_inputs(case, rng)
    for name, output in checks.compute(target.kernels, target.device, splat_checks.SPLAT, inputs).items():
        assert not output.any(), name


def test_other_libraries_see_fields(target: Any) -> None:
    if target.device != "cpu":
        pytest.skip("tests/test_interop.py is about GPUs")
    if not vector_checks.check_shared(target.kernels, target.device):
        pytest.skip("this backend has no arrays that other libraries could take")


@pytest.mark.parametrize("make", PROGRAMS)
def test_program_on_the_device(target: Any, make: programs.MakeProgram, rng: np.random.Generator) -> None:
    programs.check_program(target.kernels, target.device, make, programs.program_inputs(make, rng))


@pytest.mark.parametrize("make", PROGRAMS)
def test_captured_program_does_the_same_with_new_inputs(
    target: Any, make: programs.MakeProgram, rng: np.random.Generator
) -> None:
    first, second = (programs.program_inputs(make, rng) for _ in range(2))
    second |= {name: first[name] for name in ("offsets",) if name in first}
    if not programs.check_capture(target.kernels, target.device, make, first, second):
        pytest.skip("this device cannot be given work as a whole")


def test_devices_are_names_with_the_default_first(target: Any) -> None:
    devices = target.kernels.devices()
    assert target.device in devices
    assert "cpu" in devices
    assert len(set(devices)) == len(devices)
    assert target.kernels.name == target.backend
