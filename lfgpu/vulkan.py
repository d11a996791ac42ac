"""Vulkan devices of this machine: their names, drivers and memory, and whether kernels can run there."""

import ctypes
import os
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from lfgpu.errors import BackendError

_LIBRARY = "vulkan-1.dll" if sys.platform == "win32" else "libvulkan.so.1"
_LEAST = 1 << 22 | 2 << 12  # Vulkan 1.2
_OWN_MEMORY, _SOFTWARE = 2, 4  # the types of devices with memory of their own, and of one that is the CPU
_ORDER = (_OWN_MEMORY, 1, 3, 0, _SOFTWARE)  # of types; the others are integrated, of virtual machines, and any others
_INSTALL = (
    "install it with the driver of your GPU: for AMD and Intel on Debian and Ubuntu `apt-get install libvulkan1 "
    "mesa-vulkan-drivers`, elsewhere the driver of the GPU's maker."
)


@dataclass(frozen=True)
class VulkanDevice:
    """A GPU with a Vulkan driver, or a driver that computes on the CPU."""

    number: int  # its place in the loader's list
    name: str  # of the product
    driver: str  # its name, with the version
    type: int  # Vulkan's number of the type of device
    memory: int  # bytes of its largest heap of near memory
    largest: int  # bytes of the largest array
    lacks: tuple[str, ...]  # features that kernels need and that the driver has not
    has_doubles: bool  # True if it computes in float64

    @property
    def has_own_memory(self) -> bool:
        """True if the device is a GPU with memory of its own, and not a part of the CPU."""
        return self.type == _OWN_MEMORY

    @property
    def is_software(self) -> bool:
        """True if the driver computes on the CPU."""
        return self.type == _SOFTWARE


@cache
def choose() -> VulkanDevice:
    """Choose the best device that has what kernels need, or the one that TI_VISIBLE_DEVICE numbers."""
    devices = tuple(_devices())
    if not devices:
        raise BackendError(f"Vulkan's loader finds no driver of a GPU; {_INSTALL}")
    wanted = os.environ.get("TI_VISIBLE_DEVICE") or str(min(devices, key=lambda one: _ORDER.index(one.type)).number)
    found = next((device for device in devices if str(device.number) == wanted), None)
    if found is None:
        raise BackendError(f"TI_VISIBLE_DEVICE must be a number from 0 to {len(devices) - 1}; found {wanted!r}.")
    if found.lacks:
        raise BackendError(
            f"the Vulkan driver of {found.name} ({found.driver}) lacks {' and '.join(found.lacks)}; install a newer "
            "driver, or use the device 'cpu'."
        )
    return found


# --- Vulkan's structures: numbers at fixed places. Each begins with its type and a pointer to the next one ---

_HEADER = 16  # bytes


def _structure(kind: int, size: int, following: Any = None) -> Any:
    """Return a structure of so many bytes after its header."""
    there = (ctypes.c_uint64 * ((_HEADER + size + 7) // 8))()
    there[0], there[1] = kind, ctypes.addressof(following) if following is not None else 0
    return there


def _numbers(there: Any, place: int, form: str = "I") -> tuple[int, ...]:
    return struct.unpack_from(f"={form}", bytes(there), place)


def _text(there: Any, place: int) -> str:
    return bytes(there)[place : place + 256].partition(b"\0")[0].decode(errors="replace")


def _devices() -> Iterator[VulkanDevice]:
    try:
        vulkan = ctypes.CDLL(_LIBRARY)
    except OSError as error:
        raise BackendError(f"Vulkan's loader ({_LIBRARY}) is not installed; {_INSTALL}") from error
    application, creation = _structure(0, 32), _structure(1, 48)
    application[5] = _LEAST << 32  # its last number
    creation[3] = ctypes.addressof(application)
    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    if vulkan.vkCreateInstance(creation, None, ctypes.byref(instance)):
        return  # there is no driver
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    handles = (ctypes.c_void_p * count.value)()
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
    for number, handle in enumerate(handles):
        yield _describe(vulkan, number, ctypes.c_void_p(handle))
    vulkan.vkDestroyInstance(instance, None)


def _describe(vulkan: ctypes.CDLL, number: int, handle: ctypes.c_void_p) -> VulkanDevice:
    driver, sixteen = _structure(1000196000, 520), _structure(1000083000, 16)
    eight = _structure(1000177000, 12, sixteen)
    small = _structure(1000082000, 8, eight)
    properties, features = _structure(1000059001, 824, driver), _structure(1000059000, 220, small)
    memory = (ctypes.c_uint64 * 65)()
    vulkan.vkGetPhysicalDeviceProperties2(handle, properties)
    vulkan.vkGetPhysicalDeviceFeatures2(handle, features)
    vulkan.vkGetPhysicalDeviceMemoryProperties(handle, memory)
    version, _, _, _, kind = _numbers(properties, _HEADER, "5I")
    half, byte = _numbers(small, _HEADER, "2I")
    heaps = [_numbers(memory, 264 + 16 * k, "QI") for k in range(*_numbers(memory, 260))]
    needed = {
        "Vulkan 1.2": version >= _LEAST,
        "8-bit storage": byte and _numbers(eight, _HEADER)[0],
        "16-bit storage": half and _numbers(sixteen, _HEADER)[0],
    }
    return VulkanDevice(
        number,
        _text(properties, _HEADER + 20),
        f"{_text(driver, _HEADER + 4)} {_text(driver, _HEADER + 260)}".strip(),
        kind,
        max((size for size, near in heaps if near & 1), default=0),
        _numbers(properties, _HEADER + 296 + 4 * 7)[0],
        tuple(name for name, there in needed.items() if not there),
        bool(_numbers(features, _HEADER + 4 * 39)[0]),
    )
