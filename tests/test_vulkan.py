"""Taichi on a GPU beyond single operations: memory, tiles, batches. `make test-vulkan` runs it on a Vulkan driver."""

from __future__ import annotations

import gc
import re
import weakref
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lfgpu import DepthPipeline, LightField, estimate_depth, scenes
from lfgpu._backends import open_device
from lfgpu.cli import app
from lfgpu.io import read_map, write_hci
from lfgpu.methods import method_of, preset
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.resident import KEPT

ti = pytest.importorskip("taichi")
to_numpy_type = pytest.importorskip("taichi.lang.util").to_numpy_type
RANGE = (-0.8, 0.8)
QUICK = preset("fast").with_values({"prior.window": 3, "sweep.step": 1.0, "sweep.noise": 0.01})


@pytest.fixture
def gpu(pytestconfig: pytest.Config) -> dict[str, str]:
    chosen = {name: pytestconfig.getoption(f"--{name}") for name in ("backend", "device")}
    if chosen["backend"] != "taichi" or chosen["device"] in (None, "cpu"):
        pytest.skip("for Taichi on a GPU: --backend taichi --device vulkan")
    return chosen


class Arrays:
    """Bytes of all arrays of Taichi: now, and at most so far."""

    def __init__(self) -> None:
        self.now = self.most = 0

    def counted(self, array: Any) -> Any:
        size = prod(array.shape) * prod(array.element_shape) * np.dtype(to_numpy_type(array.dtype)).itemsize
        self._add(size)
        weakref.finalize(array, self._add, -size)
        return array

    def _add(self, size: int) -> None:
        self.now += size
        self.most = max(self.most, self.now)


@pytest.fixture
def arrays(monkeypatch: pytest.MonkeyPatch) -> Arrays:
    gc.collect()
    from lfgpu.kernels.taichi import memory

    counting = Arrays()
    for kind in ("_Scalars", "_Vectors"):
        made = getattr(memory, kind)
        monkeypatch.setattr(memory, kind, lambda *given, made=made: counting.counted(made(*given)))
    return counting


@pytest.fixture(scope="module")
def strip() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(48, 400), disparity_range=(-0.7, 0.7), noise=0.01, seed=5)


def test_tiles_give_the_same_map_in_the_memory_that_is_given(
    gpu: dict[str, str], strip: LightField, arrays: Arrays
) -> None:
    from lfgpu.kernels.taichi import alignment

    whole = estimate_depth(strip, config=QUICK, disparity_range=RANGE, **gpu)  # type: ignore[arg-type]
    method = method_of(QUICK)
    measured = method.given(strip.layout, RANGE)
    assert measured is not None
    needed = method.footprint(strip.layout, measured, on_gpu=True)
    across = method.halo(strip.layout, measured)[1]
    limit = needed.bytes(48, 200 + across)
    KEPT.free()
    arrays.most = before = arrays.now
    found = estimate_depth(strip, config=QUICK, disparity_range=RANGE, max_memory=limit, **gpu)  # type: ignore[arg-type]
    assert re.match(r"[23] tiles of 3\d\d x 48 pixels", found.status)
    assert np.abs(found.disparity - whole.disparity).max() < 1e-3
    # The buffer of the nearest surfaces does not grow with the views, and is a part of what a GPU needs besides.
    assert 0 < arrays.most - before - alignment._BUFFER < limit - needed.besides


@pytest.mark.parametrize("name", ["fast", "accurate", "paper", "learned"])
def test_memory_is_as_foreseen(gpu: dict[str, str], name: Any, arrays: Arrays, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a run that launches nothing, as kernels take no memory, and goes through loops once."""
    from lfgpu.kernels.taichi import backend, runtime

    class Nothing(dict[Any, Any]):
        def __contains__(self, key: object) -> bool:
            return True

        def __getitem__(self, key: object) -> Any:
            return lambda *arguments: None

    views = np.zeros((5, 5, 448, 672, 3), np.uint8)
    lf, measured, method = LightField.from_grid(views), Measured((-1.5, 1.5), 0.01), method_of(name)
    used = lf.subset(method.used_views(lf.offsets))
    pipeline = DepthPipeline(used, config=name, measured=measured, **gpu)  # type: ignore[arg-type]
    monkeypatch.setattr(runtime, "_prepared", Nothing())
    monkeypatch.setattr(backend, "repeat", lambda body, go_on, most, at_once=1: body())
    pipeline.run()
    needed = method.footprint(used.layout, measured, on_gpu=True)
    foreseen = needed.bytes(448, 672) - needed.besides
    assert 0.75 * foreseen < arrays.most < 1.05 * foreseen


@pytest.mark.parametrize("volumes", [0, 1, 3])
def test_directions_come_in_batches(gpu: dict[str, str], volumes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever fits beside the sums, they are added up in the same order."""
    from lfgpu.kernels.taichi import semi_global

    device, rng = open_device(**gpu), np.random.default_rng(3)  # type: ignore[arg-type]
    volume, image = device.field(rng.random((5, 13, 21))), device.image(rng.random((13, 21, 3)).astype(np.float32))

    def sums() -> Any:
        out = device.zeros((5, 13, 21))
        scale = device.field(np.ones((13, 21)))
        device.kernels.semi_global(volume, image, scale, small=0.02, large=0.1, contrast=0.2, sum_out=out)
        return device.kernels.numpy(out)

    at_once = sums()
    monkeypatch.setattr(semi_global, "_SPARE", 4 * volumes * 5 * 13 * 21)
    np.testing.assert_array_equal(sums(), at_once)


def test_iterations_after_the_last_one_change_nothing(gpu: dict[str, str]) -> None:
    """The host looks at `go_on` after some iterations only."""
    device = open_device(**gpu)  # type: ignore[arg-type]
    ends = {"low": -9.0, "high": 9.0, "first_step": 1.0, "tolerance": 0.0, "patience": 5}
    memory = device.kernels.lbfgs((2, 2), device.name, memory=3, most=1, **ends)
    x, gradient, trial, value = (*(device.field(np.full((2, 2), n)) for n in (0.0, 1.0, 0.0)), device.scalar(0.0))
    memory.begin(x, gradient, value)
    seen = []
    for lower in (-3.0, -5.0):
        memory.propose(x, trial)
        memory.judge(value, device.scalar(lower))
        memory.learn(x, gradient, trial, device.field(np.full((2, 2), 0.5)))
        seen.append((memory.report(), device.kernels.number(value), device.kernels.numpy(x).tolist()))
    assert seen[0] == (([0.0, -3.0], 2, False), -3.0, [[-1.0, -1.0]] * 2)
    assert seen[1] == seen[0]


@pytest.mark.parametrize("count", [1, 127, 128, 129, 1000])
def test_loops_are_made_in_a_fixed_number_of_threads(
    gpu: dict[str, str], count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lfgpu.kernels.taichi import memory, runtime

    open_device(**gpu)  # type: ignore[arg-type]
    monkeypatch.setattr(runtime, "_threads", lambda: 128)

    def square(values, size, values_out):  # type: ignore[no-untyped-def]
        half = size // 2
        for i in range(values.shape[0]):
            values_out[i] = values[i] * values[i]
        for i in range(half):
            values_out[i] = values_out[i] + 1.0
        for i in range(0):
            values_out[i] = 9.0

    square.__annotations__ = {"values": memory.flat(), "size": int, "values_out": memory.flat()}
    values = np.arange(count, dtype=np.float32)
    out = memory.empty((count,))
    runtime.run(ti.kernel(square), memory.field(values, gpu["device"]), count, out)
    np.testing.assert_array_equal(memory.numpy(out), values**2 + (np.arange(count) < count // 2))


def test_loops_whose_end_is_known_stay_as_they_are() -> None:
    import ast

    from lfgpu.kernels.taichi import wide_loops

    source = """
def work(a: flat(), chosen: ti.template(), size: int):
    half = size // 2
    for i in range(a.shape[0] * 3):
        a[i] = 0.0
    for i in range(128):
        a[i] = 1.0
    for i in range(TURNS):
        a[i] = 2.0
    for i in range(chosen):
        a[i] = 3.0
    ti.loop_config(block_dim=BLOCK)
    for i in range(a.shape[0]):
        a[i] = 4.0
    for i in range(half):
        a[i] = 5.0
    for i, j in ti.ndrange(size, size):
        a[i] = 6.0
"""
    kernel = ast.parse(source).body[0]
    assert isinstance(kernel, ast.FunctionDef)
    wide_loops._widen(kernel, 64)
    texts = [ast.unparse(loop) for loop in kernel.body if isinstance(loop, ast.For)]
    assert [text.startswith("for thread_ in range(64):") for text in texts] == [True, *[False] * 4, True, False]
    lines = ["for thread_ in range(64):", "for turn_ in range((a.shape[0] * 3 - 1 - thread_) // 64 + 1):"]
    assert [line.strip() for line in texts[0].splitlines()] == [*lines, "i = thread_ + turn_ * 64", "a[i] = 0.0"]


@pytest.mark.parametrize("chosen", [None, [0, 1, 2, 4, 5, 6], [6, 1], [1, 3, 5, 0, 2, 4, 6, 5, 3]])
def test_views_are_uploaded_in_pieces(
    gpu: dict[str, str], chosen: list[int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lfgpu.kernels.taichi import memory

    device, values = open_device(**gpu), np.random.default_rng(0).integers(0, 255, (7, 5, 6, 3), np.uint8)  # type: ignore[arg-type]
    wanted, sizes = values if chosen is None else values[chosen], []
    array, run = device.image(np.zeros_like(wanted)), memory.run

    def launch(kernel: Any, *given: Any) -> None:
        sizes.extend(len(pixels) // values[0, ..., 0].size for pixels in given[:-2])
        run(kernel, *given)

    monkeypatch.setattr(memory, "_PIECE", 2 * values[0].nbytes)
    monkeypatch.setattr(memory, "run", launch)
    device.kernels.upload(values, array, chosen=chosen)
    monkeypatch.undo()
    assert sum(sizes) == len(wanted)
    assert max(sizes) <= 2
    np.testing.assert_array_equal(device.kernels.numpy(array), wanted)


def test_a_batch_runs_there(gpu: dict[str, str], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    lf = scenes.make("boxes", grid=(3, 3), size=(40, 48), disparity_range=(-0.7, 0.7), seed=1)
    for name in ("a", "b"):
        write_hci(lf, tmp_path / "in" / name)
    places = [f"--{key}={value}" for key, value in gpu.items()]
    options = ["--preset", "fast", "--disparity-range", "-0.8,0.8", *places, "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(app, ["batch", str(tmp_path / "in"), *options])
    assert done.exit_code == 0, done.output
    wanted = estimate_depth(lf, config="fast", disparity_range=RANGE, **gpu).disparity  # type: ignore[arg-type]
    for name in ("a", "b"):
        found = next((tmp_path / "out" / name).glob("disparity.*"))
        np.testing.assert_allclose(read_map(found), wanted, atol=1e-4)
