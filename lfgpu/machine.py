"""The machine: its memory, packages on it, and names and memory of devices ("cpu", "cuda:0", "vulkan", "metal")."""

import ctypes
import importlib.metadata
import platform
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from lfgpu.errors import BackendError
from lfgpu.vulkan import VulkanDevice, choose

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
    """Return the product name of a device, such as "NVIDIA H200" for "cuda:0"; None if unknown.

    The name of "vulkan" has the driver's behind it. The GPU of "metal" has the name of the chip.
    """
    if device in ("cpu", "metal"):
        return _cpu()
    if device == "vulkan":
        return f"{gpu.name} ({gpu.driver})" if (gpu := _vulkan()) else None
    kind, _, index = device.partition(":")
    return _gpu(int(index)) if kind == "cuda" and index.isdigit() else None


def device_memory(device: str) -> int | None:
    """Return the memory of a GPU in bytes; None if it is unknown, and of a CPU."""
    if device == "vulkan":
        return gpu.memory if (gpu := _vulkan()) else None
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
    if sys.platform == "darwin":
        asked = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
        return subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() or None
    return platform.processor() or None


def _vulkan() -> VulkanDevice | None:
    try:
        return choose()
    except BackendError:
        return None


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
