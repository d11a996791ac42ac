"""The GPU kernels of the Warp backend on a CPU: blocks of threads as `gpu_blocks` runs them, against the reference.

The cases are those that differ in what a GPU decides for itself: tiles, strips, blocks and their edges, channels, how
pixels are packed, masks. Each kind of kernel takes seconds to compile, so these are not all cases of the matrix:
`python -m benchmarks gpu-parity --device cuda` runs all of them on a GPU.
"""

import importlib
import re
import sys
import weakref
from collections.abc import Iterator
from typing import Any

import checks
import gpu_blocks
import numpy as np
import pytest
import warp as wp
from test_matrix import CELLS, INPUTS, cell

from lfgpu import scenes
from lfgpu._backends import open_device
from lfgpu.contract import Device, KernelSet
from lfgpu.data import LightField
from lfgpu.methods import configured, method_of
from lfgpu.methods.matching import frame
from lfgpu.methods.synthesis import model
from tests import printed

pytestmark = pytest.mark.thorough

CHOSEN = (
    r"data_term-(grey-uint8-masked|colour-float16-masked|partly-out|all-out|one-pixel-high|several-tiles|more-strips)",
    r"data_term-views-of-a-benchmark",
    r"plane_sweep-(grey-uint8-masked|colour-uint16-masked|grey-uint16|colour-float16|one-pixel-high|high|wide|corner-reference)",
    r"semi_global-(colour|slices-for|many-slices|wide|work-for)",
    r"nlm_(laplacian|ratio|plane)-(colour|one-pixel|window-wider)",
    r"nlm_neighbors-(colour|one-pixel)",
    r"nlm_weights-(colour|one-pixel|window-wider|wide)",
    r"line_mean-(colour|wide)",
    r"nlm_average-(colour|window-wider|one-pixel|wide|many-slices)",
    r"z_buffer-(grey-float32|one-pixel|work-for)",
    r"alignment-(grey-float32|grey-uint8|colour-uint16|one-pixel-wide|work-for)",
    r"smooth_views-(colour-uint16-masked|grey-float16-masked|one-pixel-wide|few-valid|several-tiles)",
    r"lbfgs-(memory-of-one|curved-valley|as-many|curvature-and|work-for)",
    r"(dot|conjugate_step)-",
    r"sector_costs-(colour|grey-uint8|grey-uint16|grey-float|half|one-pixel|room|rows|work-for)",
    r"(brightness|fold)-(colour-uint8|grey-uint16|half-precision|room)",
    r"convolution-(half-)?(all-around|as-it-is|pixel|an-image|a-coarse|strides|many|one-voxel|high|large|rows|work-for)",
    r"peak-",
    r"(quantile|window_grain)-(colour|grey|few|the-|nothing|least|work-for)",
    r"(distinct_minimum|agreeing_disparity)-(colour|one-line|work-for)",
)
"""Of the matrix, by name."""


def chosen(name: str) -> bool:
    return any(re.match(pattern, name) for pattern in CHOSEN)


@pytest.fixture(scope="module")
def gpu() -> Iterator[KernelSet]:
    kernels = gpu_blocks.load()
    with gpu_blocks.in_blocks():
        yield kernels


@pytest.mark.parametrize(("operation", "case"), [param for param in CELLS if chosen(str(param.id))])
def test_operation_equals_the_reference(gpu: KernelSet, operation: checks.Operation, case: Any) -> None:
    inputs, want = cell(f"{operation}-{case}")
    checks.check_value(gpu, "cpu", operation, inputs, case.tolerance, want)


@pytest.mark.parametrize("preset", ["fast", "accurate"])
def test_a_plan_follows_other_numbers(gpu: KernelSet, preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With scalars in place of numbers, and room for more disparities, maps are those of a plan of its own."""
    one, other = (scenes.make("relief", grid=(3, 5), size=(40, 48), seed=s, noise=0.01 / s) for s in (1, 2))
    method, place = method_of(configured(preset)), Device(gpu, "cpu")
    measured = [method.measure(lf, open_device("warp", "cpu")) for lf in (one, other)]
    assert measured[0].disparity_range != measured[1].disparity_range
    assert measured[0].noise != measured[1].noise

    def maps(plan: Any, lf: LightField) -> list[Any]:
        for work in plan.stages(place.image(lf.views[used])).values():
            work(None)
        return [*plan.maps().values(), gpu.numpy(plan.confidence), plan.uncertainty()]

    used = method.used_views(one.offsets)
    layout = one.layout.subset(used)
    want = maps(method.plan(layout, measured[1], place), other)
    monkeypatch.setitem(frame._ROOM, "cpu", 64)
    plan = method.plan(layout, measured[0], place)
    maps(plan, one)
    assert plan.follow(measured[1])
    for found, alone in zip(maps(plan, other), want, strict=True):
        np.testing.assert_array_equal(found, alone)


def test_a_launch_with_the_same_memory_and_numbers_is_prepared_once(
    gpu: KernelSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording needs the arrays of each launch; what is kept of others holds no memory."""
    threads, launch, seen = sys.modules[f"{gpu_blocks.NAME}.threads"], wp.launch, []
    monkeypatch.setattr(threads, "_commands", {})
    monkeypatch.setattr(wp, "launch", lambda *given, **options: (seen.append(options), launch(*given, **options))[1])
    one, other = (gpu.zeros((2, 3), "cpu") for _ in range(2))

    def launched(value: float, out: Any) -> int:
        seen.clear()
        gpu.fill(value, out)
        assert gpu.numpy(out).tobytes() == np.full((2, 3), value, np.float32).tobytes()
        return len(seen)

    launched(3.0, one)  # loads the kernel
    calls = ((1.0, one), (1.0, other), (1.0, one), (0.0, one), (-0.0, one), (0.0, one), (2.0, other), (1.0, other))
    assert [launched(*call) for call in calls] == [1, 1, 0, 1, 1, 0, 1, 0]
    with threads.marked_slices():
        assert launched(1.0, one) == launched(1.0, one) == 1
    memory = weakref.ref(one)
    del one, calls
    assert memory() is None


def test_what_is_kept_of_a_struct_holds_no_memory(gpu: KernelSet) -> None:
    threads, lbfgs = (importlib.import_module(f"{gpu_blocks.NAME}.{name}") for name in ("threads", "gpu_lbfgs"))
    one, other = lbfgs.State(), lbfgs.State()
    assert threads._packed(one) == threads._packed(other)
    one.step = wp.zeros(1, dtype=wp.float64, device="cpu")
    memory, kept = weakref.ref(one.step), threads._packed(one)
    assert kept != threads._packed(other)
    del one
    assert memory() is None


BATCHES = (
    ("semi_global", "_ROOM", 1, "semi_global-(colour|slices-for|wide)"),
    ("semi_global", "_ROOM", 20000, "semi_global-(colour|slices-for|wide)"),
    ("z_buffer", "_BUFFER", 1, "z_buffer-(colour|work-for)"),
    ("views", "_BATCH", 2, "normalization-(grey-uint16-masked|one-pixel-high)"),
)
"""A module, what limits how much it works on at a time, a limit that gives several batches, and cases."""


@pytest.mark.parametrize(
    ("module", "limit", "small", "pattern"), BATCHES, ids=[f"{batch[0]}-{batch[2]}" for batch in BATCHES]
)
def test_work_comes_in_batches(
    gpu: KernelSet, module: str, limit: str, small: int, pattern: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[f"{gpu_blocks.NAME}.{module}"], limit, small)
    some = [param for param in CELLS if re.match(pattern, str(param.id))]
    assert some
    for param in some:
        operation, case = param.values
        inputs, want = cell(str(param.id))
        checks.check_value(gpu, "cpu", operation, inputs, case.tolerance, want)  # type: ignore[union-attr, arg-type]


def test_the_printed_equations_hold_as_a_gpu_computes_them(gpu: KernelSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """With views as a GPU keeps them: in half precision the gradient would be off by 3e-6."""
    compared_as = model.compared_as
    monkeypatch.setattr(model, "compared_as", lambda config, on_gpu: compared_as(config, on_gpu=True))
    found = printed.errors(gpu, "cpu")
    assert {name: error for name, error in found.items() if not error <= 1.2e-6} == {}
    assert len(found) == 10


def test_the_paths_are_those_of_a_gpu(gpu: KernelSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Native code that only a GPU has is what ran: kernels of blocks, by the names of their modules."""
    launched: set[str] = set()
    start = wp.launch

    def seen(kernel: Any, *arguments: Any, **options: Any) -> Any:
        launched.add(kernel.module.name)
        return start(kernel, *arguments, **options)

    monkeypatch.setattr(wp, "launch", seen)
    monkeypatch.setattr(sys.modules[f"{gpu_blocks.NAME}.threads"], "_commands", {})
    for name in ("data_term-two-by-two", "plane_sweep-two-by-two", "nlm_ratio-one-pixel", "semi_global-one-pixel"):
        operation, case = next(param.values for param in CELLS if param.id == name)
        checks.compute(gpu, "cpu", operation, INPUTS[operation.inputs][1](case, np.random.default_rng(0)))  # type: ignore[union-attr]
    for part in ("gpu_data_term", "plane_sweep_cuh", "nlm_cuh_divide_sums", "semi_global_cuh"):
        assert any(part in module for module in launched), (part, launched)
    assert all(module.startswith(gpu_blocks.NAME) for module in launched)
