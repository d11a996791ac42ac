"""Start-up: the import of lfgpu, and a first result with empty and with filled kernel caches."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from time import perf_counter

from benchmarks import clock
from benchmarks.cases import STARTUP_CASE
from benchmarks.errors import BenchmarkError
from benchmarks.job import Job
from benchmarks.results import Record
from benchmarks.sources import ROOT

CACHES = ("WARP_CACHE_PATH", "TI_OFFLINE_CACHE_FILE_PATH", "CUDA_CACHE_PATH")
"""Environment variables of the folders in which Warp, Taichi and the CUDA driver keep compiled kernels."""

_IMPORT = "from time import perf_counter as t; start = t(); import lfgpu; print(t() - start)"
_FIRST_RESULT = """
import sys
from pathlib import Path
from benchmarks import cases
from lfgpu import estimate_depth
estimate_depth(cases.load(Path(sys.argv[1])), backend=sys.argv[2], device=sys.argv[3])
"""
_IMPORTS, _WARM = 7, 3  # processes


def import_time(environment: Mapping[str, str]) -> Record:
    """Time `import lfgpu` in fresh interpreters; the first one only fills caches."""
    seconds = [float(_run([sys.executable, "-c", _IMPORT], environment, None)) for _ in range(_IMPORTS)]
    return Job("startup", "lfgpu", "cpu", "", "import", _IMPORTS).record(seconds=clock.spread(seconds[1:]))


def first_results(
    backend: str, device: str, scene: Path, environment: Mapping[str, str], timeout: float
) -> Iterator[Record]:
    """Time whole processes that import lfgpu and estimate a small map: one with empty caches, then some with full."""
    command = [sys.executable, "-c", _FIRST_RESULT, str(scene), backend, device]
    job = Job("startup", backend, device, STARTUP_CASE.name, "", _WARM)
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        caches = {name: str(Path(folder, name)) for name in CACHES}
        for path in caches.values():
            Path(path).mkdir()
        for name, times in (("cold", 1), ("warm", _WARM)):
            seconds = []
            for _ in range(times):
                start = perf_counter()
                try:
                    _run(command, {**environment, **caches}, timeout)
                except BenchmarkError as error:
                    yield job.record(name, failed=str(error))
                    return
                seconds.append(perf_counter() - start)
            cached = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
            yield job.record(name, seconds=clock.spread(seconds), details={"cache_bytes": cached})
            if not cached:  # nothing to start faster from
                return


def _run(command: list[str], environment: Mapping[str, str], timeout: float | None) -> str:
    """Run a process and return its output; BenchmarkError says why it failed."""
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, errors="replace", timeout=timeout
        )
    except subprocess.TimeoutExpired:
        raise BenchmarkError(f"took longer than {timeout:g} s") from None
    if done.returncode:
        raise BenchmarkError((done.stderr.strip().splitlines() or [f"ended with exit code {done.returncode}"])[-1])
    return done.stdout
