"""Start-up: what importing lfgpu takes, and a first result with empty and with filled kernel caches."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from time import perf_counter

from benchmarks import clock
from benchmarks.cases import STARTUP_CASE
from benchmarks.machine import ROOT
from benchmarks.processes import reason
from benchmarks.results import Record

CACHES = ("WARP_CACHE_PATH", "TI_OFFLINE_CACHE_FILE_PATH", "CUDA_CACHE_PATH")
"""Environment variables that say where Warp, Taichi and the CUDA driver keep what they compiled."""

_IMPORT = "from time import perf_counter as t; start = t(); import lfgpu; print(t() - start)"
_IMPORTS = 7
_WARM = 3


def import_time(environment: Mapping[str, str]) -> Record:
    """Seconds of `import lfgpu` in fresh interpreters."""
    seconds = []
    for _ in range(_IMPORTS):
        done = subprocess.run(
            [sys.executable, "-c", _IMPORT], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        )
        seconds.append(float(done.stdout))
    return Record("startup", "lfgpu", "cpu", "", "import", seconds=clock.spread(seconds[1:]))


def first_results(
    backend: str, device: str, scene: Path, environment: Mapping[str, str], timeout: float
) -> Iterator[Record]:
    """Wall time of whole processes that import lfgpu and estimate a small map: once cold, then warm."""
    command = [sys.executable, "-m", "benchmarks.first_result", str(scene), backend, device]
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        caches = {name: str(Path(folder, name)) for name in CACHES}
        for path in caches.values():
            Path(path).mkdir()
        for name, times in (("cold", 1), ("warm", _WARM)):
            seconds = []
            for _ in range(times):
                start = perf_counter()
                failure = _run(command, {**environment, **caches}, timeout)
                if failure:
                    yield Record("startup", backend, device, STARTUP_CASE.name, name, failed=failure)
                    return
                seconds.append(perf_counter() - start)
            cached = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
            yield Record(
                "startup",
                backend,
                device,
                STARTUP_CASE.name,
                name,
                seconds=clock.spread(seconds),
                details={"cache_bytes": cached},
            )
            if not cached:  # nothing to start faster from
                return


def _run(command: list[str], environment: Mapping[str, str], timeout: float) -> str:
    """Why the process failed; "" if it did not."""
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, errors="replace", timeout=timeout
        )
    except subprocess.TimeoutExpired:
        return f"took longer than {timeout:g} s"
    return reason(done.returncode, done.stderr) if done.returncode else ""
