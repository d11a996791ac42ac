"""The cache of compiled kernels on the disk: no object is loaded from it that is not as it was written."""

import glob
import os
import shutil
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import warp as wp

from lfgpu.errors import BackendError

_SOURCES = (".cpp", ".cu")  # they are compiled, not loaded
_SUM = ".crc32"

_loaded: set[tuple[Any, str, int | None]] = set()  # modules of kernels, for a device and a number of threads in a block


def from_cache(start: Callable[[], object], module: Any, device: Any, block_dim: int | None) -> None:
    """Start what compiles a module or takes it from the cache; what is damaged there is compiled again.

    A crash leaves files that are cut short, which Warp finds; a disk flips bits, which only a processor would find.
    """
    variant = module, str(device), block_dim
    is_new = variant not in _loaded
    if is_new and not all(map(_is_whole, _files(module))):
        _forget(module)
    try:
        start()
    except OSError as error:
        raise cache_is_closed(error) from error
    except Exception:
        if not _forget(module):
            raise
        start()
    if is_new:
        for file in _files(module):
            with suppress(OSError):  # others may use a cache that they may not write to
                _seal(file)
        _loaded.add(variant)


def _forget(module: Any) -> bool:
    """Remove all of a module from the cache; returns whether there was something."""
    places = _places(module)
    for place in places:
        shutil.rmtree(place, ignore_errors=True)
        if place.exists():
            raise cache_is_closed(PermissionError(0, "it is damaged, and cannot be removed", str(place)))
    if places:
        module.unload()
    return bool(places)


def cache_is_closed(error: OSError) -> BackendError:
    """Return the error to raise where Warp cannot write what it compiles."""
    return BackendError(
        f"Warp cannot keep its compiled kernels in {error.filename or wp.config.kernel_cache_dir} "
        f"({error.strerror or error}); set WARP_CACHE_PATH to a folder that may be written to."
    )


def _places(module: Any) -> list[Path]:
    return list(Path(wp.config.kernel_cache_dir).glob(f"wp_{glob.escape(module.name)}_*"))


def _files(module: Any) -> Iterator[Path]:
    """Yield the files that Warp loads of a module."""
    for place in _places(module):
        for file in place.iterdir():
            if file.suffix not in (*_SOURCES, _SUM):
                yield file


def _is_whole(file: Path) -> bool:
    """Tell whether a file is as it was when it was sealed, or was not sealed yet."""
    seal = file.with_name(file.name + _SUM)
    try:
        return not seal.exists() or seal.read_text() == _sum(file)
    except (OSError, ValueError):  # another process compiles it, or the seal is damaged
        return False


def _seal(file: Path) -> None:
    seal = file.with_name(file.name + _SUM)
    if not seal.exists():
        temporary = file.with_name(f"{file.name}.{os.getpid()}{_SUM}")
        temporary.write_text(_sum(file))
        temporary.replace(seal)


def _sum(file: Path) -> str:
    return f"{zlib.crc32(file.read_bytes()):08x}"
