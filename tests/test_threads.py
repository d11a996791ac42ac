"""The number of threads: who decides it, and that results do not depend on it."""

import os
import threading
from typing import Any

import pytest

import lfgpu
from lfgpu import threads
from lfgpu.errors import LfgpuError
from lfgpu.threads import in_threads, meanwhile

VARIABLE = "LFGPU_THREADS"


@pytest.fixture(autouse=True)
def _nothing_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(threads, "_chosen", None)


def test_one_for_each_core_of_the_process_by_default() -> None:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert lfgpu.get_threads() == cores


def test_the_environment_decides_and_set_threads_overrules_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "3")
    assert lfgpu.get_threads() == 3
    lfgpu.set_threads(5)
    assert lfgpu.get_threads() == 5
    lfgpu.set_threads(None)
    assert lfgpu.get_threads() == 3
    monkeypatch.setenv(VARIABLE, "")
    assert lfgpu.get_threads() >= 1


def test_what_is_no_number_of_threads_is_refused_and_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    lfgpu.set_threads(2)
    wrongs: list[Any] = [0, -1, 1.5, "many", "", True, float("nan"), float("inf"), [2]]
    for wrong in wrongs:
        with pytest.raises(LfgpuError) as error:
            lfgpu.set_threads(wrong)
        assert str(error.value) == f"set_threads: the number of threads must be an integer >= 1, found {wrong!r}."
    assert lfgpu.get_threads() == 2
    lfgpu.set_threads(None)
    for wrong in ("0", "-2", "1.5", "all"):
        monkeypatch.setenv(VARIABLE, wrong)
        with pytest.raises(LfgpuError) as error:
            lfgpu.get_threads()
        assert str(error.value) == f"${VARIABLE}: the number of threads must be an integer >= 1, found {wrong!r}."


def test_what_waits_is_done_on_this_thread_while_others_work() -> None:
    begun, done = threading.Event(), threading.Event()
    where: list[threading.Thread] = []

    def other() -> None:
        where.append(threading.current_thread())
        assert begun.wait(10)
        done.set()

    def work(item: int) -> int:
        begun.set()
        assert done.wait(10)
        return 2 * item

    with meanwhile(other):
        assert in_threads(work, [1, 2]) == [2, 4]
        in_threads(work, [3])
    assert where == [threading.current_thread()]


def test_what_waits_is_done_even_if_nobody_works_in_threads_but_not_after_an_error() -> None:
    calls: list[str] = []
    with meanwhile(lambda: calls.append("at the end")):
        assert not calls
    with pytest.raises(ValueError, match="wrong"), meanwhile(lambda: calls.append("never")):
        raise ValueError("wrong")
    in_threads(str, [1])
    assert calls == ["at the end"]


def test_an_error_of_what_waits_keeps_others_from_beginning() -> None:
    begun: list[int] = []
    gate = threading.Event()

    def other() -> None:
        gate.set()
        raise ValueError("wrong")

    def work(item: int) -> None:
        begun.append(item)
        assert gate.wait(10)

    with pytest.raises(ValueError, match="wrong"), meanwhile(other):
        in_threads(work, range(100_000))
    assert len(begun) < 100_000
