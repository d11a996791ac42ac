"""Time of commands beside that of another program, in turn: a machine whose speed drifts is as fast for both.

Times are those of whole processes, as the operating system counts them: the wall's, and that of all cores together.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated

import typer

from benchmarks.errors import BenchmarkError
from benchmarks.options import Out, Presets, Row, check_known, collected, listed, say
from benchmarks.tables import Columns, Table
from lfgpu import estimate_depth, read
from lfgpu.methods import PRESETS, configured

if sys.platform != "win32":
    import resource

_LEAST = 3  # pairs, for a median that one slow run does not move

COLUMNS: Columns = {
    "light field": "{light_field}",
    "preset": "{preset}",
    "what": "{what}",
    "CPU, s": "{cpu_s:.2f}",
    "wall, s": "{wall_s:.2f}",
    "other, CPU, s": "{other_cpu_s:.2f}",
    "other, wall, s": "{other_wall_s:.2f}",
    "CPU, ratio": "{cpu_ratio:.2f}",
    "wall, ratio": "{wall_ratio:.2f}",
}

Times = tuple[float, float]
"""Seconds of all cores, and of the wall."""


def command(
    light_field: Annotated[Path, typer.Argument(metavar="LIGHT_FIELD", help="The light field of both.")],
    other: Annotated[str, typer.Argument(metavar="COMMAND", help="The other program with its arguments.")],
    presets: Presets = "fast,accurate",
    pairs: Annotated[int, typer.Option(min=_LEAST, help="Runs of each, in turn, after one that is not counted.")] = 7,
    out: Out = None,
) -> None:
    """Compare the time of `lfgpu depth`, and of a second estimate in one process, with that of another program."""
    if sys.platform == "win32":
        raise BenchmarkError("the times of a process's cores are counted on Linux and macOS only.")
    check_known(listed(presets), "preset", PRESETS)
    rows = run(light_field, _words(other), listed(presets), pairs)
    Table.of("", 3, collected(rows, out, benchmark="pairs", about={"other": other}), COLUMNS).show()


def run(light_field: Path, other: Sequence[str], presets: Sequence[str], pairs: int) -> Iterator[Row]:
    """Measure the `command` `lfgpu depth`, and an `estimate` in a process that made one before, with each preset.

    Times are medians, ratios medians of those of the pairs, ours over the other program's. BenchmarkError if a command
    fails.
    """
    lf = read(light_field)
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as name:
        for preset in presets:
            depth = [sys.executable, "-m", "lfgpu", "depth", str(light_field), "-o", f"{name}/{preset}"]
            works: dict[str, Callable[[], Times]] = {
                "command": partial(_process, [*depth, "--preset", preset]),
                "estimate": partial(_here, partial(estimate_depth, lf, config=configured(preset), device="cpu")),
            }
            for what, timed in works.items():
                say(f"{preset}: {what}")
                found = [(timed(), _process(other)) for _ in range(1 + pairs)][1:]
                (cpu, wall), (other_cpu, other_wall) = (
                    [median(times) for times in zip(*side, strict=True)] for side in zip(*found, strict=True)
                )
                cpu_ratio, wall_ratio = (median(a[k] / b[k] for a, b in found) for k in range(2))
                yield {
                    "light_field": lf.name or light_field.name,
                    "preset": preset,
                    "what": what,
                    "pairs": pairs,
                    "cpu_s": cpu,
                    "wall_s": wall,
                    "other_cpu_s": other_cpu,
                    "other_wall_s": other_wall,
                    "cpu_ratio": cpu_ratio,
                    "wall_ratio": wall_ratio,
                }


def _words(command: str) -> list[str]:
    """Split a command as a shell does."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise BenchmarkError(f"{command!r} is no command of another program: {error}.") from error
    if not words:
        raise BenchmarkError("no command of another program was given.")
    return words


def _process(command: Sequence[str]) -> Times:
    """Time a process that prints nowhere."""
    began, before = time.monotonic(), _spent_by_children()
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BenchmarkError(f"{command[0]} cannot be started: {error.strerror}.") from error
    wall = time.monotonic() - began
    if done.returncode:
        raise BenchmarkError(f"{shlex.join(command)} failed: {(done.stderr or done.stdout).strip()[-300:]}")
    return _spent_by_children() - before, wall


def _spent_by_children() -> float:
    """Return the seconds of all cores that ended processes of this one took."""
    assert sys.platform != "win32"
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _here(work: Callable[[], object]) -> Times:
    """Time work of this process."""
    began, before = time.monotonic(), time.process_time()
    work()
    return time.process_time() - before, time.monotonic() - began
