"""Warp on a CPU: work cut into slices for a pool of threads gives the same bits however many threads there are."""

import threading
import time
from collections.abc import Iterator
from typing import Any

import checks
import numpy as np
import pytest
from test_matrix import INPUTS, OPERATIONS

import lfgpu
from lfgpu.errors import BackendError

wp = pytest.importorskip("warp")

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


def test_a_failure_in_a_thread_is_not_lost(warp: Any, threads: Any) -> None:
    lfgpu.set_threads(2)

    def work(part: int, first: int, last: int) -> None:
        if part == 3:
            raise ZeroDivisionError("in part 3")

    with pytest.raises(ZeroDivisionError, match="in part 3"):
        threads.in_slices(warp.kernels.zeros((1,), "cpu").device, 8, work)


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


def test_launches_that_cannot_be_counted_are_refused() -> None:
    from lfgpu.kernels.warp.threads import check_size

    check_size(2**31 - 1)
    with pytest.raises(BackendError, match=r"2147483648 threads .* use fewer or smaller views"):
        check_size(5, 2**31)


def test_a_reach_that_a_row_has_no_room_for_is_refused(warp: Any) -> None:
    with pytest.raises(AssertionError, match="reach is 101"):
        warp.kernels.z_buffer((1, 4, 4, 1), warp.kernels.field(np.zeros((1, 2), np.float32), "cpu"), reach=101)
