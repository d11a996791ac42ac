"""Warp on this machine: files of native code, threads that give the same bits, and the cache of compiled kernels."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import checks
import numpy as np
import pytest
from test_matrix import INPUTS, OPERATIONS

import lfgpu
from lfgpu.errors import BackendError

wp = pytest.importorskip("warp")

from lfgpu.kernels.warp import (  # noqa: E402
    alignment,
    confidence,
    convolution,
    cost_volume,
    edges,
    gpu_data_term,
    gpu_lbfgs,
    gpu_plane_sweep,
    measuring,
    native_code,
    nlm,
    peak,
    range_search,
    sectors,
    semi_global,
    smoothing,
    views,
    z_buffer,
)
from lfgpu.kernels.warp.memory import pixel_type  # noqa: E402

NATIVE = Path(native_code.__file__).parent / "native"
FILES = sorted(path.name for path in NATIVE.iterdir() if path.name != "lfgpu.h")
ARCHITECTURE = 80  # compute capability


def gpu_kernels() -> Iterator[Any]:
    """One specialisation at least of each kernel for GPUs, for each way in which it differs by preprocessor."""
    byte, float16 = wp.uint8, wp.float16
    yield native_code.kernel("views.h", "copy_line", Stored=pixel_type(3, byte))
    yield views._normalization_kernels(3, byte, float16, 1.0)
    yield range_search._shrink_kernel(3, byte, 1)
    for name in ("shrink_again", "add_rows", "subtract_means", "add_differences", "find_costs"):
        yield range_search._kernel(name, 1)
    yield [range_search._kernel(name, 1) for name in ("find_distinct", "find_agreeing")]
    yield [
        measuring._quantile_kernel(),
        *(measuring._kernel(f"find_{what}", 3, 1) for what in ("differences", "grain")),
    ]
    yield [smoothing._tiles_kernel(3, byte), smoothing._reduce_kernel(3, byte)]
    yield [cost_volume._pixels_kernel(2), cost_volume._add_kernel()]
    yield [cost_volume._minimum_kernel(name, 1) for name in ("find_least", "find_lowest")]
    yield [edges._kernel(3, 2, False), confidence._line_mean_kernel()]
    yield native_code.kernel("vector.h", "for_each", EACH="a * xs[i] + b * ys[i]")
    yield [nlm._tile_kernel(1, 1), native_code.kernel("nlm.cuh", "add_neighbors", TERM="other", KEEP=1.0, RADIUS=2)]
    yield [native_code.kernel("nlm.cuh", name, RADIUS=2) for name in ("divide_sums", "fit_planes")]
    yield [semi_global._step_costs_kernel(3), semi_global._path_kernel(2), semi_global._turn_kernel()]
    yield z_buffer._gpu_kernels(2)
    yield [gpu_lbfgs._products_kernel(), gpu_lbfgs._recursion_kernel(), gpu_lbfgs._combine_kernel(5)]
    for shape, strides in (
        ((3, 3, 3, 24, 24), (1, 1, 1)),
        ((3, 3, 3, 40, 56), (2, 2, 2)),
        ((1, 1, 1, 64, 48), (1, 1, 1)),
    ):
        kind = shape, strides, True, float16, float16
        yield [convolution._gpu_kernel(*kind, convolution._tiles(shape, strides))]
    yield convolution._gpu_kernel((3, 3, 3, 24, 4), (1, 1, 1), False, float16, wp.float32)
    yield [peak._kernel(stored, False) for stored in (float16, wp.float32)]
    yield [sectors._gpu_costs_kernel(1, byte, float16, masked=False), sectors._fold_kernel(3, float16)]
    yield gpu_data_term._kernels(3, float16, float16)
    for stored in (byte, wp.uint16, float16, wp.float32):
        yield sectors._gpu_costs_kernel(3, stored, wp.float32, masked=stored is byte)
        yield alignment._kernels(1 if stored is byte else 3, stored, stored, False)
        yield [gpu_plane_sweep.pack_kernel(3, stored), gpu_plane_sweep.mark_kernel(3, stored)]
        yield gpu_plane_sweep.sweep_kernel(3, stored, 2, False, True, True, 1e-4)
    yield gpu_plane_sweep.sweep_kernel(1, byte, 1, True, False, False, 1e-4)


def each_module() -> dict[str, Any]:
    """The modules of these kernels, by name."""
    found = {}
    for made in gpu_kernels():
        several = (
            vars(made).values() if isinstance(made, SimpleNamespace) else made if isinstance(made, list) else [made]
        )
        found |= {kernel.module.name: kernel.module for kernel in several}
    return found


@pytest.mark.thorough
def test_gpu_kernels_compile(tmp_path: Path) -> None:
    wp.init()
    for module in each_module().values():
        try:
            wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=tmp_path, use_ptx=True)
        except RuntimeError as error:
            if "NVRTC" in str(error) and "not available" in str(error):
                pytest.skip("this build of Warp has no compiler for GPUs")
            raise
    assert len(list(tmp_path.glob("*.ptx"))) == len(each_module())


def test_every_function_is_used_and_what_is_for_gpus_is_compiled_here() -> None:
    python = {path.name: path.read_text(encoding="utf-8") for path in NATIVE.parent.glob("*.py")}
    here = Path(__file__).read_text(encoding="utf-8")
    for file in FILES:
        for name, part in native_code._parts(file).items():
            if part.arguments is not None:
                users = [text for text in python.values() if f'"{file}"' in text and f'"{name}"' in text]
                assert users, f"nothing asks for {name} of {file}"
                if file.endswith(".cuh"):
                    modules = [Path(module).stem for module, text in python.items() if f'"{file}"' in text]
                    assert any(f"    {module},\n" in here for module in modules)
            else:
                uses = [(NATIVE / other).read_text(encoding="utf-8") for other in FILES]
                assert sum(len(re.findall(rf"\b{name}\b", text)) for text in uses) > 1, f"nothing uses {name}"


@pytest.mark.parametrize("file", FILES)
def test_all_of_a_file_is_read(file: str) -> None:
    """Nothing of it is lost: besides comments and includes there are only parts that the loader knows."""
    text = (NATIVE / file).read_text(encoding="utf-8")
    left = native_code._PART.sub("", text)
    rest = [line for line in left.splitlines() if line and not line.startswith(("//", "#include", "#pragma once"))]
    assert [line for line in rest if not line.strip().startswith("//")] == []
    assert max(map(len, text.splitlines())) <= 120


KINDS = {"splat", "occlusion", "alignment", "ratio", "sweep", "views", "smoothing", "reduction", "nlm", "volume", "epi"}
"""Inputs of operations whose work is cut, besides those that are reduced."""
SPLIT = [
    operation
    for operation in OPERATIONS
    if operation.inputs in KINDS | {"reduced"} and str(operation) != "image_memory"
]


@pytest.fixture
def warp(other: Any) -> Any:
    if (other.backend, other.device) != ("warp", "cpu"):
        pytest.skip("only Warp on a CPU has such threads")
    return other


@pytest.fixture
def threads(warp: Any) -> Iterator[Any]:
    """The module that cuts work into slices; the number of threads is what it was before when the test is over."""
    yield pytest.importorskip("lfgpu.kernels.warp.threads")
    lfgpu.set_threads(None)


@pytest.mark.parametrize("operation", SPLIT, ids=str)
def test_bits_do_not_depend_on_the_number_of_threads(
    warp: Any, threads: Any, operation: checks.Operation, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    launched: dict[int, set[str]] = {}
    launch = wp.launch

    def noted(*args: Any, **kwargs: Any) -> None:
        launched.setdefault(lfgpu.get_threads(), set()).add(threading.current_thread().name)
        launch(*args, **kwargs)

    monkeypatch.setattr(wp, "launch", noted)
    cases, make = INPUTS[operation.inputs]
    (case,) = (case for case in cases if case.name == "work for several threads")
    inputs, results = make(case, rng), []
    for count in (1, 2, 5):
        lfgpu.set_threads(count)
        results.append(checks.compute(warp.kernels, warp.device, operation, inputs))
    assert launched[1] == {threading.current_thread().name}
    for count in (2, 5):  # the work did go through the pool
        assert any(name.startswith("lfgpu") for name in launched[count])
    for other in results[1:]:
        for output in other:
            np.testing.assert_array_equal(other[output], results[0][output])


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 100])
def test_slices_cover_everything_once(warp: Any, threads: Any, count: int) -> None:
    device = warp.kernels.zeros((1,), "cpu").device
    cuts = threads.slices(device, count)
    assert [i for first, last in cuts for i in range(first, last)] == list(range(count))
    seen: list[tuple[int, int]] = []
    threads.in_slices(device, count, lambda _, first, last: seen.append((first, last)))
    assert sorted(seen) == cuts


def test_threads_fail_together_and_refuse_what_cannot_be_counted(warp: Any, threads: Any) -> None:
    lfgpu.set_threads(2)

    def work(part: int, first: int, last: int) -> None:
        if part == 3:
            raise ZeroDivisionError("in part 3")

    with pytest.raises(ZeroDivisionError, match="in part 3"):
        threads.in_slices(warp.kernels.zeros((1,), "cpu").device, 8, work)
    from lfgpu.kernels.warp.threads import check_size

    check_size(2**31 - 1)
    with pytest.raises(BackendError, match=r"2147483648 threads .* use fewer or smaller views"):
        check_size(5, 2**31)


def test_once_runs_a_function_once_however_many_threads_ask() -> None:
    once = pytest.importorskip("lfgpu.kernels.warp.threads").once
    calls: list[int] = []
    together = threading.Barrier(8)

    @once
    def slow(value: int) -> int:
        calls.append(value)
        time.sleep(0.02)
        return value

    def ask() -> None:
        together.wait()
        slow(3)

    asking = [threading.Thread(target=ask) for _ in range(8)]
    for thread in asking:
        thread.start()
    for thread in asking:
        thread.join()
    assert calls == [3]


def test_a_reach_that_a_row_has_no_room_for_is_refused(warp: Any) -> None:
    with pytest.raises(AssertionError, match="reach is 101"):
        warp.kernels.z_buffer((4, 4), "cpu", reach=101)


pytest.importorskip("warp")

_CODE = """
import numpy as np
from lfgpu.errors import BackendError
from lfgpu._backends import load
try:
    kernels = load("warp")
    views = kernels.image(np.full((2, 8, 8, 3), 51, np.uint8), "cpu")
    image = kernels.zeros_image((8, 8, 3), "cpu")
    kernels.intensities(views, 0, None, scale=1 / 255, fill=0.0, image_out=image)
    print("done", float(kernels.numpy(image).mean()))
    residuals = kernels.residuals("cpu", tolerance=0.5, most=3)  # these are not loaded before they are launched
    residuals.begin(kernels.scalar(4.0, "cpu"))
    residuals.add(kernels.scalar(1.0, "cpu"))
    print("left", residuals.report())
except BackendError as error:
    print("refused:", error)
"""


def run(cache: Path | str) -> str:
    """In a process of its own, with another cache."""
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache)}
    done = subprocess.run([sys.executable, "-c", _CODE], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_a_cache_that_is_damaged_is_made_again(tmp_path: Path) -> None:
    """Cut short by a crash, with bits that were flipped, and with sums that are no trust."""
    first = run(tmp_path)
    assert first.startswith("done 0.2")
    assert first.endswith("left [0.5]\n")
    objects = [file for file in tmp_path.rglob("*") if file.suffix in (".o", ".so")]
    assert objects
    for file in objects:
        file.write_bytes(file.read_bytes()[:300])
    assert run(tmp_path) == first
    for file in objects:
        data = file.read_bytes()
        middle = len(data) // 2
        file.write_bytes(data[:64] + bytes(255 - byte for byte in data[64:middle]) + data[middle:])
    assert run(tmp_path) == first
    for file in objects:
        file.with_name(f"{file.name}.crc32").write_bytes(b"\xff")
    being_made = [file.parent.with_name(f"{file.parent.name}_p1_t2") for file in objects]
    for place in being_made:  # another process compiles, and will need its folder
        place.mkdir()
        (place / "half.o").write_bytes(b"half")
        (place / "half.o.crc32").write_text("another")
    assert run(tmp_path) == first
    assert all((place / "half.o").exists() for place in being_made)


@pytest.mark.thorough
@pytest.mark.parametrize("value", ["", "here"])
@pytest.mark.parametrize("name", ["XDG_CACHE_HOME", "WARP_CACHE_PATH"])
def test_no_native_code_is_kept_in_or_loaded_from_the_current_folder(tmp_path: Path, name: str, value: str) -> None:
    """A relative WARP_CACHE_PATH is an own wish; XDG_CACHE_HOME is none then, as its specification says."""
    (tmp_path / "now").mkdir()
    environment = {key: text for key, text in os.environ.items() if key != "WARP_CACHE_PATH"}
    environment |= {"HOME": str(tmp_path / "home"), name: value}
    done = subprocess.run(
        [sys.executable, "-c", _CODE], env=environment, cwd=tmp_path / "now", capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("done 0.2")
    is_wish = (name, value) == ("WARP_CACHE_PATH", "here")
    assert [path.name for path in (tmp_path / "now").iterdir()] == (["here"] if is_wish else [])


def test_all_kernels_are_launched_such_that_they_are_made_again() -> None:
    files = (Path(__file__).parents[2] / "kernels" / "warp").rglob("*.py")
    assert [file.name for file in files if "wp.launch" in file.read_text()] == ["threads.py"]


def test_a_cache_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    text = run(tmp_path / "file" / "cache")
    assert text.startswith("refused: ")
    assert "set WARP_CACHE_PATH" in text
