"""Errors that come up while a file is read, as one sentence that names the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
        raise LightFieldError(f"{path} cannot be read as {kind}: {reason_of(error)}.") from error


def reason_of(error: Exception) -> str:
    """Return the reason of an error on one line, without a full stop."""
    said = getattr(error, "strerror", None) or str(error)
    return " ".join(str(said).split()).rstrip(".") or type(error).__name__
