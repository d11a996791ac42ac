"""The matrix: backend x device x operation x case. The reference is the truth, backends are found by themselves."""

import os
import pkgutil
import re
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import alignment_checks
import checks
import learned_checks
import local_checks
import measuring_checks
import nlm_checks
import numpy as np
import occlusion_checks
import programs
import pytest
import range_search_checks
import resampling_checks
import smoothing_checks
import solver_checks
import splat_checks
import streaming_checks
import sweep_checks
import vector_checks
import view_checks
import volume_checks
import without_truth
from conftest import SEED

from lfgpu import _backends, contract as types

INPUTS: dict[str, tuple[tuple[Any, ...], Any]] = {
    "splat": (splat_checks.SPLAT_CASES, splat_checks.splat_inputs),
    "occlusion": (occlusion_checks.OCCLUSION_CASES, occlusion_checks.occlusion_inputs),
    "alignment": (alignment_checks.ALIGNMENT_CASES, alignment_checks.alignment_inputs),
    "ratio": (alignment_checks.RATIO_CASES, alignment_checks.ratio_inputs),
    "outline": (alignment_checks.OUTLINE_CASES, alignment_checks.outline_inputs),
    "sweep": (sweep_checks.SWEEP_CASES, sweep_checks.sweep_inputs),
    "sectors": (learned_checks.SECTOR_CASES, learned_checks.sector_inputs),
    "convolution": (learned_checks.CONVOLUTION_CASES, learned_checks.convolution_inputs),
    "peak": (learned_checks.PEAK_CASES, learned_checks.peak_inputs),
    "choice": (learned_checks.CHOICE_CASES, learned_checks.choice_inputs),
    "facets": (learned_checks.FACET_CASES, learned_checks.facet_inputs),
    "seen": (splat_checks.SEEN_CASES, splat_checks.seen_inputs),
    "views": (view_checks.VIEWS_CASES, view_checks.views_inputs),
    "resampling": (resampling_checks.RESAMPLING_CASES, resampling_checks.resampling_inputs),
    "smoothing": (smoothing_checks.SMOOTHING_CASES, smoothing_checks.smoothing_inputs),
    "reduction": (smoothing_checks.REDUCTION_CASES, smoothing_checks.smoothing_inputs),
    "nlm": (nlm_checks.NLM_CASES, nlm_checks.nlm_inputs),
    "volume": (volume_checks.VOLUME_CASES, volume_checks.volume_inputs),
    "reduced": (volume_checks.REDUCED_CASES, volume_checks.volume_inputs),
    "range search": (range_search_checks.RANGE_SEARCH_CASES, range_search_checks.range_search_inputs),
    "measuring": (measuring_checks.MEASURING_CASES, measuring_checks.measuring_inputs),
    "epi": (local_checks.EPI_CASES, local_checks.epi_inputs),
    "coherence": (local_checks.COHERENCE_CASES, local_checks.coherence_inputs),
    "vector": (vector_checks.VECTOR_CASES, vector_checks.vector_inputs),
    "residuals": (solver_checks.RESIDUALS_CASES, solver_checks.residuals_inputs),
    "lbfgs": (solver_checks.LBFGS_CASES, solver_checks.lbfgs_inputs),
    "streaming": (streaming_checks.STREAMING_CASES, streaming_checks.streaming_inputs),
}
"""Of each kind of inputs: the cases, and what makes them of a case."""
FAMILIES = (
    splat_checks,
    view_checks,
    nlm_checks,
    local_checks,
    vector_checks,
    solver_checks,
    occlusion_checks,
    sweep_checks,
    volume_checks,
    learned_checks,
    alignment_checks,
    resampling_checks,
    smoothing_checks,
    range_search_checks,
    measuring_checks,
    streaming_checks,
)
OPERATIONS = tuple(operation for family in FAMILIES for operation in family.OPERATIONS)
UNORDERED = ("splat_z_buffered",)
"""Operations that no estimate needs, so that they may add atomically on a GPU."""

FIRST = 2
"""Cases of an operation that every backend is tried with by `make test`; with the others only the default is."""


def marks_of(place: int, case: Any) -> list[pytest.MarkDecorator]:
    """Say how a case that is not among the first is run: networks store volumes as float16, so float32 is thorough."""
    is_thorough = isinstance(case, learned_checks.ConvolutionCase) and case.stored == "float32"
    return [pytest.mark.thorough if is_thorough else pytest.mark.special] if place >= FIRST else []


CELLS = [
    pytest.param(operation, case, id=f"{operation}-{case}", marks=marks_of(place, case))
    for operation in OPERATIONS
    for place, case in enumerate(INPUTS[operation.inputs][0])
]


def test_matrix_has_every_operation_of_the_contract() -> None:
    facts = {"name", "dtype", "devices", "is_deterministic", "asking", "kernel_cache", "compiles"}
    contract = checks.names_of(types.KernelSet) - facts
    streams = {str(operation) for operation in streaming_checks.OPERATIONS}
    assert streams == checks.names_of(types.Streaming)
    covered = {str(operation) for operation in OPERATIONS} - {"memory", "image_memory"} - streams
    # What is in the two checks of memory, and what has checks of its own.
    memory = {
        "field",
        "image",
        "zeros",
        "zeros_image",
        "within",
        "clear",
        "scalar",
        "upload",
        "numpy",
        "number",
        "read",
    }
    alone = {"repeat", "capture", "prepare", "shared"}
    assert contract == covered | memory | alone


PAGE = (Path(__file__).parents[2] / "kernels" / "README.md").read_text(encoding="utf-8")


def test_pages_on_new_backends_name_all() -> None:
    contract = checks.names_of(types.KernelSet) | {"streaming", "recording", "changing"}
    assert contract == {name for name in contract if f"`{name}`" in PAGE}
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
    inputs = vector_checks.vector_inputs(vector_checks.VECTOR_CASES[0], rng)
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
    inputs = vector_checks.vector_inputs(vector_checks.VECTOR_CASES[0], np.random.default_rng(0))
    errors = checks.check_value(_backends.load("reference"), "cpu", operation, inputs, 0.0)
    assert [type(error) for error in errors.values()] == [float]


@pytest.mark.parametrize("check", without_truth.CHECKS, ids=str)
def test_check_that_knows_no_truth(target: Any, check: without_truth.Check, rng: np.random.Generator) -> None:
    check.run(target.kernels, target.device, *check.make(rng))


def test_other_libraries_see_fields(target: Any) -> None:
    if target.device != "cpu":
        pytest.skip("tests/test_interop.py is about GPUs")
    if not vector_checks.check_shared(target.kernels, target.device):
        pytest.skip("this backend has no arrays that other libraries could take")


@pytest.mark.parametrize("make", programs.PROGRAMS)
def test_program_on_the_device(target: Any, make: programs.MakeProgram, rng: np.random.Generator) -> None:
    programs.check_program(target.kernels, target.device, make, programs.program_inputs(make, rng))


@pytest.mark.parametrize("make", programs.PROGRAMS)
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
