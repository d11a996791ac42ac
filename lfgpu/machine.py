"""The product names of devices that backends call "cpu" and "cuda:0"."""

from __future__ import annotations

import ctypes
import platform
import sys
from pathlib import Path

_LONGEST = 256  # bytes of a name, with its terminating zero


def device_name(device: str) -> str | None:
    """The product name of a device, such as "NVIDIA H200" for "cuda:0"; None if unknown."""
    if device == "cpu":
        return _cpu()
    kind, _, index = device.partition(":")
    return _gpu(int(index)) if kind == "cuda" and index.isdigit() else None


def _cpu() -> str | None:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            label, _, value = line.partition(":")
            if label.strip() == "model name":
                return value.strip()
    return platform.processor() or None


def _gpu(index: int) -> str | None:
    """The name of a GPU from the CUDA driver, which numbers GPUs as the backends do."""
    try:
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None
    device, name = ctypes.c_int(), ctypes.create_string_buffer(_LONGEST)
    if driver.cuInit(0) or driver.cuDeviceGet(ctypes.byref(device), index):
        return None
    return None if driver.cuDeviceGetName(name, _LONGEST, device) else name.value.decode(errors="replace")
