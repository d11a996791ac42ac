"""The machine, the versions and the commit of a measurement."""

from __future__ import annotations

import os
import platform
import subprocess
from typing import Any

from benchmarks.sources import ROOT, stamp
from lfgpu.io.damage import physical_memory
from lfgpu.machine import device_name, version_of

_PACKAGES = ("lfgpu", "warp-lang", "taichi", "numpy", "scipy")


def about(benchmark: str) -> dict[str, Any]:
    """Say where a result file of a benchmark comes from: machine, versions, commit, sources."""
    return {"machine": describe(), "versions": versions(), "commit": commit(), "sources": stamp(benchmark)}


def describe() -> dict[str, Any]:
    """Name the CPU, the cores that may be used, the memory, the GPUs and their driver, the system, Python."""
    gpus = nvidia_smi("name") or []
    drivers = nvidia_smi("driver_version") or []
    return {
        "cpu": device_name("cpu") or platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_bytes": physical_memory() or None,
        "gpus": gpus,
        "driver": drivers[0] if drivers else None,
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
    }


def versions() -> dict[str, str | None]:
    """List the versions of lfgpu and the packages that compute for it; None where one is not installed."""
    return {name: version_of(name) for name in _PACKAGES}


def commit() -> str | None:
    """Name the commit that is checked out, with "+" if files differ from it; None without git or a repository."""
    head, changes = _said("git", "rev-parse", "HEAD"), _said("git", "status", "--porcelain")
    return None if head is None else head.strip() + ("+" if changes else "")


def load_average() -> float | None:
    """Count the processes that wanted to run in the last minute; None where the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def nvidia_smi(query: str) -> list[str] | None:
    """Ask nvidia-smi, which answers a line for each GPU; None where it is not there or fails."""
    said = _said("nvidia-smi", f"--query-gpu={query}", "--format=csv,noheader,nounits")
    return None if said is None else [line.strip() for line in said.splitlines() if line.strip()]


def _said(*command: str) -> str | None:
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
