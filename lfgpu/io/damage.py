"""Guards of readers: damage becomes a sentence, and claimed sizes are judged before memory is taken for them."""

import importlib
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.errors import LightFieldError


@contextmanager
def read_as(path: Path, kind: str = "") -> Iterator[None]:
    """Turn errors of the block into a LightFieldError: of the system always, of any library where a kind is given.

    Libraries raise whatever comes to them when a file is damaged, so with a `kind`, such as "HDF5", everything is
    taken for damage.
    """
    try:
        yield
    except LightFieldError:
        raise
    except Exception as error:
        of_system = isinstance(error, OSError) and (error.filename is not None or not kind)
        if of_system:
            raise LightFieldError(f"{path} cannot be read: {reason_of(error)}.") from error
        if not kind:
            raise
        reason = f"{reason_of(error)}; copy it again, or write it anew"
        raise LightFieldError(f"{path} cannot be read as {kind}: {reason}.") from error


@contextmanager
def naming(where: Path | str) -> Iterator[None]:
    """Put a file, or a part of one, before the sentence of a LightFieldError of the block."""
    try:
        yield
    except LightFieldError as error:
        raise LightFieldError(f"{where}: {error}") from error


def reason_of(error: Exception) -> str:
    """Return the reason of an error on one line, without a full stop."""
    said = getattr(error, "strerror", None) or str(error)
    return " ".join(str(said).split()).rstrip(".") or type(error).__name__


_BEST_RATIO = 2000  # deflate reaches 1032; no picture of a scene comes near what the best packers do with black
_ALWAYS_FINE = 1 << 24  # bytes: so much may be claimed by the smallest file


def check_claim(
    path: Path,
    shape: Sequence[int],
    dtype: Any,
    *,
    in_memory: bool = True,
) -> None:
    """Raise LightFieldError if an array that a file claims to hold can neither be in the file nor in the memory."""
    if any(side < 0 for side in shape):
        raise LightFieldError(f"{path} is damaged: it claims an array of shape {tuple(shape)}.")
    claimed = math.prod(int(side) for side in shape) * np.dtype(dtype).itemsize
    stored = path.stat().st_size
    if claimed > max(_ALWAYS_FINE, stored * _BEST_RATIO):
        raise LightFieldError(
            f"{path} is damaged: it claims {claimed} bytes of pixels, which a file of {stored} bytes cannot hold."
        )
    if in_memory:
        check_memory(path, claimed, advice="read fewer or smaller views")


def check_memory(path: Path, needed: int, *, advice: str) -> None:
    """Raise LightFieldError if so many bytes are more than the machine has."""
    memory = physical_memory()
    if memory and needed > memory:
        raise LightFieldError(
            f"{path} does not fit into memory: its views are {needed / 2**30:.1f} GiB, "
            f"this machine has {memory / 2**30:.1f} GiB; {advice}."
        )


def physical_memory() -> int:
    """Return the memory of the machine in bytes; 0 where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # Windows has no sysconf
        return 0


_POINTER = b"version https://git-lfs.github.com/spec/"


def check_fetched(path: Path) -> None:
    """Raise LightFieldError that says what to do if a regular file is such a text; nothing if it cannot be read."""
    start = b""
    with suppress(OSError):
        if path.is_file():  # opening a pipe would wait for somebody to write into it
            with path.open("rb") as file:
                start = file.read(len(_POINTER))
    if start == _POINTER:
        raise LightFieldError(
            f"{path} was not fetched: Git LFS left a pointer in its place; run 'git lfs pull' in its repository."
        )


def require(module: str, extra: str, who: object) -> Any:
    """Import an optional library for `who`; LightFieldError that says how to install it where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise LightFieldError(
            f"{who} needs {module.partition('.')[0]}, which is not installed; {how_to_install(extra)}."
        ) from error


def how_to_install(extra: str) -> str:
    """Say how to install the libraries of an extra beside lfgpu, as the last part of a sentence."""
    return f"install it with: pip install 'lfgpu[{extra}]'"
