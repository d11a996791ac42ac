"""Git LFS leaves a small text in place of each file that was not fetched."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from lfgpu.errors import LightFieldError

_START = b"version https://git-lfs.github.com/spec/"


def check_fetched(path: Path) -> None:
    """Raise LightFieldError that says what to do if a regular file is such a text; nothing if it cannot be read."""
    start = b""
    with suppress(OSError):
        if path.is_file():  # opening a pipe would wait for somebody to write into it
            with path.open("rb") as file:
                start = file.read(len(_START))
    if start == _START:
        raise LightFieldError(
            f"{path} was not fetched: Git LFS left a pointer in its place; run 'git lfs pull' in its repository."
        )
