"""Processes of their own: memory counted from the start, and a crash that costs one measurement only."""

from __future__ import annotations

import math
import os
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any, TypeVar
from unittest.mock import patch

from lfgpu.errors import LfgpuError

T = TypeVar("T")

_THREADS = ("LFGPU_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_LONGEST = 200  # characters of a reason


def threads_in(threads: int) -> dict[str, str]:
    """Return the variables of an environment whose processes use so many threads of the CPU."""
    return dict.fromkeys(_THREADS, str(threads))


def collect(
    function: Callable[..., Iterable[T]], *arguments: Any, variables: Mapping[str, str], timeout: float
) -> tuple[list[T], str]:
    """Run a generator in a fresh process.

    Returns what it yielded, and the reason why it did not come to its end ("" if it did). `variables` are added to the
    environment of the process; after `timeout` seconds it is killed.
    """
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, function, arguments))
    found: list[T] = []
    with tempfile.TemporaryFile("w+", errors="replace") as output:
        with patch.dict(os.environ, variables), _written_to(output.fileno()):
            process.start()
        sender.close()
        end = monotonic() + timeout
        try:
            while receiver.poll(None if end == math.inf else max(0.0, end - monotonic())):
                is_value, content = receiver.recv()
                if not is_value:
                    return found, content
                found.append(content)
            process.kill()
            return found, f"took longer than {timeout:g} s"
        except EOFError:
            process.join()
            output.seek(0)
            return found, ended(process.exitcode or 0, output.read())
        finally:
            receiver.close()
            process.join()


def ended(code: int, output: str) -> str:
    """Say what the exit code of a process that ended without a word, and its output, mean."""
    if code < 0:
        name = signal.Signals(-code).name
        return f"ended by {name}" + (", as when memory runs out" if name == "SIGKILL" else "")
    lines = output.strip().splitlines()
    return lines[-1][:_LONGEST] if lines else f"ended with exit code {code}"


def sentence(error: Exception) -> str:
    """Say in one line what went wrong."""
    if isinstance(error, MemoryError):
        return "the memory does not suffice"
    text = " ".join(str(error).split()) or "no reason given"
    return text if isinstance(error, LfgpuError) else f"{type(error).__name__}: {text[:_LONGEST]}"


def _send(sender: Connection, function: Callable[..., Iterable[Any]], arguments: tuple[Any, ...]) -> None:
    """Send (True, value) for each value, and at the end (False, reason)."""
    try:
        for value in function(*arguments):
            sender.send((True, value))
    except Exception as error:  # whatever a backend raises: it is listed, and the rest goes on
        sender.send((False, sentence(error)))
    else:
        sender.send((False, ""))


@contextmanager
def _written_to(file: int) -> Iterator[None]:
    """Let a process that starts meanwhile write its output to a file: backends talk, and crashes leave words."""
    before = [os.dup(output) for output in (1, 2)]
    for output in (1, 2):
        os.dup2(file, output)
    try:
        yield
    finally:
        for output, old in zip((1, 2), before, strict=True):
            os.dup2(old, output)
            os.close(old)
