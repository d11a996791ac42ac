"""Texts in files (descriptions, parameters, attributes), which are small."""

from __future__ import annotations

from pathlib import Path

from lfgpu.errors import LightFieldError

_LARGEST = 1 << 24  # bytes; a description of 100 000 views needs less


def read_text(path: Path, *, errors: str = "strict", largest: int = _LARGEST) -> str:
    """The text of a regular file in UTF-8, with or without a mark at its beginning.

    Raises
    ------
    LightFieldError
        If it cannot be read, is no regular file (a pipe would be waited for), or is longer than `largest` bytes.
    UnicodeDecodeError
        If it is not UTF-8, unless `errors` is "replace".
    """
    try:
        if not path.is_file():
            raise LightFieldError(f"{path} is not a file.")
        size = path.stat().st_size
        if size > largest:
            raise LightFieldError(f"{path} has {size} bytes; a text of its kind has at most {largest}.")
        with path.open("rb") as file:
            return file.read(largest).decode("utf-8-sig", errors)
    except OSError as error:
        raise LightFieldError(f"{path} cannot be read: {error.strerror}.") from error
