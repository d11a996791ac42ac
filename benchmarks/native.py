"""The exported C++ program beside Python: time of a frame on each, with the same bits."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks import cases
from benchmarks.errors import BenchmarkError
from benchmarks.moving import RANGE, Film
from lfgpu import DepthStream, TemporalPrior, export_pipeline
from lfgpu.methods import configured
from lfgpu.threads import limited_threads

_SAID = re.compile(r"(\d+) frames, (\d+) without the map before; ([\d.]+) ms each in the median, ([\d.]+) ms for 99 %")


@dataclass(frozen=True)
class Plan:
    """Cases and presets by name, frames that are cast and how often they are played, threads of a CPU, the device."""

    cases: tuple[str, ...]
    presets: tuple[str, ...]
    frames: int
    repeats: int
    threads: tuple[int, ...]
    device: str


@dataclass(frozen=True)
class Row:
    """One preset on one case with so many threads: milliseconds from a frame on the host to its maps there, one frame
    after the other, in the median and for 99 %; and whether all maps of the first round have the same bits.
    """

    case: str
    preset: str
    device: str
    threads: int
    python_p50: float
    python_p99: float
    native_p50: float
    native_p99: float
    same_bits: bool


def run(plan: Plan, say: Callable[[str], None]) -> Iterator[Row]:
    """Export, build and measure each preset on each case."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        program = None
        for case in plan.cases:
            say(f"{case}: casting {plan.frames} frames")
            size = cases.parse(case)
            frames = Film(size.grid, size.size, plan.frames).frames()
            np.stack([lf.views for lf in frames]).tofile(folder / "frames.raw")
            for preset in plan.presets:
                out = folder / f"{case}-{preset}"
                say(f"{case} {preset}: exporting")
                export_pipeline(frames[0], out, config=configured(preset), disparity_range=RANGE, device=plan.device)
                program = program or _built(out, folder / "build")
                for threads in plan.threads:
                    say(f"{case} {preset}, {threads} threads")
                    yield _measured(case, preset, threads, frames, out, program, folder, plan)


def _built(sources: Path, build: Path) -> Path:
    """The program, built as the README of the export says."""
    cmake = shutil.which("cmake")
    if cmake is None:
        raise BenchmarkError("there is no CMake to build the program with; install it.")
    for command in (
        (cmake, "-S", sources, "-B", build, "-DCMAKE_BUILD_TYPE=Release", f"-DWARP={Path(wp.__file__).parent}"),
        (cmake, "--build", build),
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise BenchmarkError(f"the program cannot be built: {' '.join((done.stdout + done.stderr).split())[-500:]}")
    return build / "replay"


def _measured(
    case: str, preset: str, threads: int, frames: list[Any], out: Path, program: Path, folder: Path, plan: Plan
) -> Row:
    times: list[float] = []
    maps = []
    options: dict[str, Any] = {"config": preset, "disparity_range": RANGE, "device": plan.device, "policy": "block"}
    with limited_threads(threads), DepthStream(frames[0], prior=TemporalPrior(), **options) as stream:
        for round_ in range(plan.repeats):
            for lf in frames:
                start = perf_counter()
                result = stream.push(lf.views)
                pair = result.numpy(), result.confidence()
                times.append(1000 * (perf_counter() - start))
                if round_ == 0:
                    maps.append(pair)
    files = folder / "frames.raw", folder / "maps.raw"
    command: list[Path | str] = [program, out, *files, "--threads", str(threads), "--repeat", str(plan.repeats)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = _SAID.search(done.stderr)
    if done.returncode != 0 or said is None:
        raise BenchmarkError(f"the program failed: {' '.join(done.stderr.split())}")
    found = np.fromfile(folder / "maps.raw", np.float32).reshape(np.array(maps).shape)
    return Row(
        case,
        preset,
        plan.device,
        threads,
        median(times),
        float(np.percentile(times, 99)),
        float(said[3]),
        float(said[4]),
        bool(np.array_equal(found, np.array(maps), equal_nan=True)),
    )


def show(rows: list[Row]) -> None:
    """A table."""
    table = Table("case", "preset", "threads", "Python, ms", "99 %", "C++, ms", "99 %", "same bits")
    for row in rows:
        times = (row.python_p50, row.python_p99, row.native_p50, row.native_p99)
        said = [f"{time:.2f}" for time in times]
        table.add_row(row.case, f"{row.preset} {row.device}", str(row.threads), *said, "yes" if row.same_bits else "NO")
    Console(highlight=False).print(table)
