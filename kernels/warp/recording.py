"""Work as a file that Warp's native libraries replay without Python (`lfgpu/contract/control.py`)."""

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import warp as wp

from .asking import alone
from .threads import MARKS, load, marked_slices

_KINDS = {kernel.key: kind for kernel, kind in zip(MARKS, ("begin", "end"), strict=True)}
_PROBED = 2**24  # bytes: more than a file system gives back when a write fails


def version() -> str:
    """Return the version of Warp, to which files are tied."""
    return str(wp.config.version)


def libraries() -> tuple[Path, Path]:
    """Return the folders of Warp's libraries and of their headers."""
    root = Path(wp.__file__).parent
    return root / "bin", root / "native"


def save(
    work: Callable[[], None], path: Path, *, device: str, inputs: dict[str, Any], outputs: dict[str, Any]
) -> tuple[tuple[str, str, int, str], ...]:
    """Record `work`, which must have run once before, and write it to `path` (.wrp) and a folder of modules beside it.

    On a CPU it must ask for everything from the thread that calls this. What is done in slices is marked.
    """
    if wp.get_device(device).is_cpu:
        load(wp.get_device(device), *MARKS)
    with alone(), marked_slices(), wp.ScopedCapture(device=device, apic=True) as capture:
        work()
    try:
        wp.capture_save(capture.graph, str(path), inputs=inputs, outputs=outputs)
    except RuntimeError:  # Warp does not say why
        _probe(path.with_suffix(".probe"))
        raise
    return tuple(_kernels(capture.graph._apic_capture))


def _probe(path: Path) -> None:
    """Write a file and remove it, for the system's own error where files cannot be written."""
    try:
        path.write_bytes(bytes(_PROBED))
    finally:
        path.unlink(missing_ok=True)


def _kernels(capture: Any) -> list[tuple[str, str, int, str]]:
    found = []
    for info in capture.collected_kernels.values():
        module = capture.collected_modules[info["module_hash"]]
        kernel = wp.get_module(module["module_name"]).kernels[info["kernel_key"]]
        kind = _KINDS.get(info["kernel_key"], "work")
        found.append((module["binary_filename"], info["forward_name"], _argument_bytes(kernel), kind))
    return found


def _argument_bytes(kernel: Any) -> int:
    """Return the size of the structure in which a CPU kernel gets its arguments."""
    fields = [(f"a{k}", _c_type(argument.type)) for k, argument in enumerate(kernel.adj.args)]
    return ctypes.sizeof(type("Arguments", (ctypes.Structure,), {"_fields_": fields}))


def _c_type(kind: Any) -> Any:
    if isinstance(kind, wp.array):
        return type(wp.empty(0, device="cpu").__ctype__())
    return kind if issubclass(kind, ctypes.Array) else kind._type_  # vectors are C types themselves
