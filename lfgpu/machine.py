"""The machine: its memory, names and memory of the devices that backends call "cpu" and "cuda:0", packages on it."""

from __future__ import annotations

import ctypes
import importlib.metadata
import platform
import sys
from functools import lru_cache
from pathlib import Path

_MEMINFO = Path("/proc/meminfo")
_LONGEST = 256  # bytes of a name, with its terminating zero


@lru_cache
def version_of(package: str) -> str | None:
    """Return the version of a package; None if it is not installed, as lfgpu is not in a checkout on the path."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def device_name(device: str) -> str | None:
    """Return the product name of a device, such as "NVIDIA H200" for "cuda:0"; None if unknown."""
    if device == "cpu":
        return _cpu()
    kind, _, index = device.partition(":")
    return _gpu(int(index)) if kind == "cuda" and index.isdigit() else None


def device_memory(device: str) -> int | None:
    """Return the memory of a GPU in bytes; None if it is unknown, and of a CPU."""
    kind, _, index = device.partition(":")
    if kind != "cuda" or not index.isdigit() or (found := _cuda(int(index))) is None:
        return None
    driver, number = found
    size = ctypes.c_size_t()
    return None if driver.cuDeviceTotalMem_v2(ctypes.byref(size), number) else size.value


def free_memory() -> int | None:
    """Return the memory of the machine that programs can take, in bytes; None where the system does not say."""
    if not _MEMINFO.is_file():
        return None
    lines = dict(line.split(":", 1) for line in _MEMINFO.read_text().splitlines() if ":" in line)
    kilobytes = lines.get("MemAvailable", "").split()
    return 1024 * int(kilobytes[0]) if kilobytes else None


def _cpu() -> str | None:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            label, _, value = line.partition(":")
            if label.strip() == "model name":
                return value.strip()
    return platform.processor() or None


def _gpu(index: int) -> str | None:
    if (found := _cuda(index)) is None:
        return None
    driver, device = found
    name = ctypes.create_string_buffer(_LONGEST)
    return None if driver.cuDeviceGetName(name, _LONGEST, device) else name.value.decode(errors="replace")


def _cuda(index: int) -> tuple[ctypes.CDLL, ctypes.c_int] | None:
    """Return the CUDA driver and a GPU of it, which it numbers as the backends do; None if there is none."""
    try:
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None
    device = ctypes.c_int()
    return None if driver.cuInit(0) or driver.cuDeviceGet(ctypes.byref(device), index) else (driver, device)
