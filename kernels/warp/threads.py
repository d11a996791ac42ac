"""Slices of work for the cores of a CPU: Warp runs each launch on one thread, so every slice is launched from its own.

Modules are loaded before that, from a cache with checksums. How the work is cut does not depend on the number of
threads, so neither do the results.
"""

import ctypes
import itertools
import os
import re
import shutil
import threading
import zlib
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache, lru_cache, partial, wraps
from pathlib import Path
from typing import Any, TypeVar

import warp as wp

from lfgpu.errors import BackendError
from lfgpu.threads import get_threads

_SOURCES = (".cpp", ".cu")  # they are compiled, not loaded
_SUM = ".crc32"
_IS_BEING_MADE = re.compile(r"_p\d+_t\d+$").search  # a folder that Warp renames when all is in it

_loaded: set[tuple[Any, str, int | None]] = set()  # modules of kernels, for a device and a number of threads in a block


def from_cache(module: Any, device: Any, block_dim: int | None) -> None:
    """Compile a module or take it from the cache, once; while this thread prepares work (`prepare`), note it only."""
    variant = module, str(device), block_dim
    if is_preparing():
        _prepared.variants[variant] = None
    elif variant not in _loaded:
        with LOADING:
            if variant not in _loaded:
                _compilers(get_threads()).submit(_load, *variant).result()


def _load(module: Any, device: str, block_dim: int | None) -> None:
    """Load a module; what is damaged in the cache is compiled again.

    A crash leaves files that are cut short, which Warp finds; a disk flips bits, which only a processor would find.
    """
    start = partial(wp.load_module, module, device=device, block_dim=block_dim or 0)  # 0: what launches have
    # For the widest vectors of a CPU: compilers use 256 of 512 bits where nobody says so, as the first CPUs with more
    # were slower with them. All modules have the same flags: for others Warp's headers would be read again.
    flags = f"{wp.config.cpu_compiler_flags or '-march=native'} -mprefer-vector-width=512"
    if wp.get_module_options(module)["cpu_compiler_flags"] != flags:
        wp.set_module_options({"cpu_compiler_flags": flags}, module)
    if not all(map(_is_whole, _files(module))):
        _forget(module)
    try:
        start()
    except OSError as error:
        raise cache_is_closed(error) from error
    except Exception:
        if not _forget(module):
            raise
        start()
    for file in _files(module):
        with suppress(OSError):  # others may use a cache that they may not write to
            _seal(file)
    _loaded.add((module, device, block_dim))


_prepared = threading.local()


def is_preparing() -> bool:
    """Tell whether this thread asks for work that is not done, so that its kernels are known."""
    return getattr(_prepared, "variants", None) is not None


def prepare(work: Callable[[], None], device: str) -> None:
    _prepared.variants = variants = dict[tuple[Any, str, int | None], None]()
    try:
        work()
    finally:
        _prepared.variants = None

    of_modules: dict[Any, list[tuple[str, int | None]]] = {}
    for module, place, block_dim in variants:
        if (module, place, block_dim) not in _loaded:
            of_modules.setdefault(module, []).append((place, block_dim))

    def load_one(module: Any) -> None:
        for place, block_dim in of_modules[module]:
            _load(module, place, block_dim)

    with LOADING:
        list(_compilers(get_threads()).map(load_one, of_modules))


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
    """List the folders of a module in the cache, without those in which a process compiles it at this moment."""
    start = f"wp_{module.name}_"
    try:
        with os.scandir(wp.config.kernel_cache_dir) as entries:
            return [Path(e.path) for e in entries if e.name.startswith(start) and not _IS_BEING_MADE(e.name)]
    except FileNotFoundError:
        return []


def _files(module: Any) -> Iterator[Path]:
    """Yield the files that Warp loads of a module."""
    for place in _places(module):
        with suppress(FileNotFoundError):  # another process has just replaced it
            yield from (file for file in list(place.iterdir()) if file.suffix not in (*_SOURCES, _SUM))


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


_SLICES = 16
_MANY = 2**18  # pixels: to cut light work on fewer of them takes longer than the work
_MOST_THREADS = 2**31 - 1  # of a launch that counts them in 32 bits
LOADING = threading.RLock()
"""Held while something is made that is made once, such as a compiled kernel."""

Result = TypeVar("Result")


def once(function: Callable[..., Result]) -> Callable[..., Result]:
    """Call a function once for each set of arguments and keep what it returned; other threads wait meanwhile."""
    kept: dict[tuple[Hashable, ...], Result] = {}

    @wraps(function)
    def call(*arguments: Hashable) -> Result:
        if arguments not in kept:  # what is there is taken without waiting for others that make something else
            with LOADING:
                if arguments not in kept:
                    kept[arguments] = function(*arguments)
        return kept[arguments]

    return call


def in_slices(device: Any, count: int, work: Callable[[int, int, int], None]) -> None:
    """Call work(slice, first, last) for slices of range(count): one for all on a GPU, several at a time on a CPU.

    On a CPU `work` asks for nothing but launches: what is recorded of it runs them side by side.
    """
    cuts = slices(device, count)
    if len(cuts) == 1 or is_preparing():
        work(0, *cuts[0])
        return
    if (threads := get_threads()) == 1:
        for k, (first, last) in enumerate(cuts):
            if is_recording():
                wp.launch(slice_begins_kernel, 1, device=device)
            work(k, first, last)
        if is_recording():
            wp.launch(slices_end_kernel, 1, device=device)
        return
    for done in [_pool(threads).submit(work, k, first, last) for k, (first, last) in enumerate(cuts)]:
        done.result()


@wp.kernel(module="lfgpu_slices", enable_backward=False)
def slice_begins_kernel():
    pass


@wp.kernel(module="lfgpu_slices", enable_backward=False)
def slices_end_kernel():
    pass


MARKS = slice_begins_kernel, slices_end_kernel
"""Launched before each slice of one call, and after the last, in work that is recorded: slices may run side by side."""

_marking = threading.local()


def is_recording() -> bool:
    """Tell whether what this thread asks for becomes a file."""
    return getattr(_marking, "on", False)


@contextmanager
def marked_slices() -> Iterator[None]:
    """While the block runs, what this thread has done in slices of a CPU is marked."""
    _marking.on = True
    try:
        yield
    finally:
        _marking.on = False


def slices(device: Any, count: int) -> list[tuple[int, int]]:
    """Return the (first, last) of each slice that `in_slices` makes."""
    parts = min(_SLICES, count) if device.is_cpu else 1
    return [(count * k // parts, count * (k + 1) // parts) for k in range(parts)]


def launch_rows(kernel: Any, inputs: list[Any], *outputs: Any, rows: int | None = None, light: bool = False) -> None:
    """Launch kernel(*inputs, row, lanes, *outputs) over rows of outputs [.., y, x], in slices of them from `row` on.

    Thread i has y = row + i / lanes and lane = i % lanes; kernels work that out themselves, in 32 bits, as the 64 bits
    of launches in two dimensions cost a GPU more than what some kernels do. There are y `rows`, or as many as given.
    What is `light` work for each pixel stays on one thread of a CPU unless there are many pixels.
    """
    device, threads = outputs[0].device, lanes(outputs[0])
    height = outputs[0].shape[-2] if rows is None else rows
    check_size(height * threads)
    load(device, kernel)

    def some_rows(_: int, first: int, last: int) -> None:
        launch(kernel, (last - first) * threads, [*inputs, first, threads], list(outputs), device=device)

    if light and outputs[0].shape[-2] * outputs[0].shape[-1] < _MANY:
        some_rows(0, 0, height)
    else:
        in_slices(device, height, some_rows)


class Rooms:
    """Memory that a thread needs while it works on a slice, by slice; a thread uses the same for all its slices.

    It is allocated when a thread of a CPU first needs it. Recorded slices may run side by side: each has its own.
    """

    def __init__(self, device: Any, make: Callable[[], Any]) -> None:
        self._make, self._rooms = make, {} if device.is_cpu else {0: make()}

    def __getitem__(self, part: int) -> Any:
        index = part if is_recording() else getattr(_working, "index", 0)
        if index not in self._rooms:
            self._rooms[index] = self._make()
        return self._rooms[index]


def room_for(device: Any, floats: int) -> Rooms:
    """Return memory for so many floats for each thread that works on slices."""
    return Rooms(device, lambda: wp.empty(floats, dtype=float, device=device))


def launch_slices(kernel: Any, count: int, inputs: list[Any], *outputs: Any, room: Any = None) -> None:
    """Launch kernel(*inputs, first, last, *outputs) for each slice of range(count), on a thread of a CPU.

    Behind `last` a kernel that needs some has the `room` of its slice.
    """
    device = outputs[0].device
    load(device, kernel)

    def some(part: int, first: int, last: int) -> None:
        more = [first, last] if room is None else [first, last, room[part]]
        launch(kernel, 1, [*inputs, *more], list(outputs), device=device)

    in_slices(device, count, some)


def launch(
    kernel: Any,
    dim: Any,
    inputs: Sequence[Any],
    outputs: Sequence[Any] = (),
    *,
    device: Any,
    stream: Any = None,
    block_dim: int | None = None,
) -> None:
    """Launch a kernel; what a crash left of it in the cache of kernels is compiled again."""
    from_cache(kernel.module, device, block_dim)
    if is_preparing():
        return
    if (place := wp.get_device(device)).is_cuda and not is_recording():
        if (command := _command(kernel, dim, (*inputs, *outputs), place, block_dim)) is not None:
            command.launch(stream)
    else:
        wp.launch(kernel, dim, inputs, outputs, device=device, stream=stream, block_dim=block_dim)


_commands: dict[tuple[Hashable, ...], Any] = {}
_COMMANDS = 4096  # launches that are kept, at most: a few kilobytes each


def _command(kernel: Any, dim: Any, arguments: tuple[Any, ...], device: Any, block_dim: int | None) -> Any:
    """Return a launch, the same one for the same memory and numbers; None if it has no threads.

    To pack arguments takes Python several times as long as all else that a launch needs.
    """
    key = (kernel, str(dim), device.alias, block_dim, *map(_packed, arguments))
    if (command := _commands.get(key)) is None:
        if len(_commands) >= _COMMANDS:
            _commands.clear()
        command = wp.launch(kernel, dim, arguments, device=device, block_dim=block_dim, record_cmd=True)
        if command is not None:
            command.fwd_args = None  # they would hold the memory
            _commands[key] = command
    return command


def _packed(argument: Any) -> Hashable:
    """Return all that a kernel gets of an argument; structs of arrays must not change once they were launched with."""
    if hasattr(argument, "__ctype__"):
        return getattr(argument, "dtype", None), bytes(argument.__ctype__())
    return bytes(argument) if isinstance(argument, ctypes.Array) else argument or repr(argument)  # 0.0 equals -0.0


def launch_tiles(
    kernel: Any, dim: list[int], inputs: list[Any], outputs: list[Any], *, device: Any, block_dim: int
) -> None:
    """Launch a kernel whose threads work together on tiles, as `launch` does."""
    from_cache(kernel.module, device, block_dim)
    if not is_preparing():
        wp.launch_tiled(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device, block_dim=block_dim)


def flat(array: Any) -> Any:
    """Return a contiguous array as a row, made once, as it takes as long as to launch a kernel on it."""
    if array.ndim == 1:
        return array
    if not hasattr(array, "lfgpu_flat"):
        array.lfgpu_flat = wp.array(ptr=array.ptr, dtype=array.dtype, shape=array.size, device=array.device, copy=False)
    return array.lfgpu_flat


def scalars(array: Any) -> Any:
    """Return a contiguous array of pixels with their channels as one more dimension, made once."""
    if not hasattr(array, "lfgpu_scalars"):
        stored, shape = array.dtype._wp_scalar_type_, (*array.shape, array.dtype._length_)
        array.lfgpu_scalars = wp.array(ptr=array.ptr, dtype=stored, shape=shape, device=array.device, copy=False)
    return array.lfgpu_scalars


def check_size(*threads: int) -> None:
    """Raise BackendError if a launch would have more threads than its kernel can count."""
    if max(threads) > _MOST_THREADS:
        raise BackendError(
            f"a kernel would need {max(threads)} threads (views x pixels), more than the 2^31 - 1 that it can count: "
            "use fewer or smaller views."
        )


def lanes(array: Any) -> int:
    """Return the number of threads that share a row: one for each pixel on a GPU; one for the whole row on a CPU.

    A CPU runs the threads of a launch one after the other, and a plain loop costs it less than a thread per pixel.
    """
    return 1 if array.device.is_cpu else int(array.shape[-1])


def load(device: Any, *kernels: Any) -> None:
    """Compile and load what threads are about to launch, so that none of them waits for another."""
    for kernel in kernels:
        from_cache(kernel.module, device, None)


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    numbers = itertools.count()

    def begin() -> None:
        _working.index = next(numbers)

    return ThreadPoolExecutor(threads, thread_name_prefix="lfgpu", initializer=begin)


_working = threading.local()


@cache
def _compilers(threads: int) -> ThreadPoolExecutor:
    """Return the threads that compile, always the same ones: each of them has to read Warp's headers once."""
    return ThreadPoolExecutor(threads, thread_name_prefix="lfgpu-compiling")


if hasattr(os, "register_at_fork"):  # the threads of a pool do not live on in a forked process
    os.register_at_fork(after_in_child=_pool.cache_clear)
    os.register_at_fork(after_in_child=_compilers.cache_clear)
