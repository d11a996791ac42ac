"""The container of Lytro cameras (.lfp, .lfr): sections of data that are named by their SHA-1, and JSON about them.

The file begins with 16 bytes, `_MAGIC` and a version. A section has a header of 16 bytes: a magic that says what it is,
and the length of its data, big endian. If that is not 0, 80 bytes with the section's name follow, then the data, then
zeros up to a multiple of 16. One section is the table of contents; it is JSON and names all others.
"""

import json
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import read_as
from lfgpu.io.folders import head

_MAGIC, _TABLE, _DATA = (b"\x89LF" + kind + b"\r\n\x1a\n" for kind in (b"P", b"M", b"C"))
_HEADER, _NAME = 16, 80  # bytes
_MOST_SECTIONS = 1000
_MOST_JSON = 1 << 24  # bytes


@dataclass(frozen=True)
class Section:
    """One section of a container."""

    kind: bytes
    name: str
    start: int
    length: int


@dataclass(frozen=True)
class Container:
    """A container whose sections were found and whose table of contents was read. Data are read when asked for."""

    path: Path
    table: dict[str, Any]
    sections: dict[str, Section]  # all sections of data by name

    def has(self, name: object) -> bool:
        """Tell whether a section of this name is there; `name` is whatever stood in JSON."""
        return isinstance(name, str) and name in self.sections

    def length(self, name: str) -> int:
        """Return the number of bytes of data of a section."""
        return self.sections[name].length

    def data(self, name: str) -> bytes:
        """Read the data of a section; LightFieldError if the file cannot be read."""
        with read_as(self.path), self.path.open("rb") as file:
            return _read(file, self.sections[name])

    def json(self, name: str, what: str) -> dict[str, Any]:
        """Read the data of a section as a JSON object; LightFieldError, which calls it `what`, if they are none."""
        with read_as(self.path), self.path.open("rb") as file:
            return _json(self.path, file, self.sections[name], what)


def is_container(path: Path) -> bool:
    """Tell whether a file begins as a container does."""
    return head(path, len(_MAGIC)) == _MAGIC


def open_container(path: Path) -> Container:
    """Find the sections of a container and read its table of contents; LightFieldError if it is none, or damaged."""
    with read_as(path), path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(_HEADER)[: len(_MAGIC)] != _MAGIC:
            raise LightFieldError(f"{path} is not a Lytro container: it does not begin as one.")
        sections = list(_sections(path, file, size))
        table = _table(path, file, sections)
    return Container(path, table, {section.name: section for section in sections if section.kind == _DATA})


def _sections(path: Path, file: BinaryIO, size: int) -> Iterator[Section]:
    position = _HEADER
    for _ in range(_MOST_SECTIONS):
        if position >= size:
            return
        file.seek(position)
        header = file.read(_HEADER)
        if len(header) == _HEADER and header[:8] in (_TABLE, _DATA):
            (length,) = struct.unpack(">I", header[12:])
        elif header.strip(b"\0"):
            raise LightFieldError(
                f"{path} is a damaged Lytro container: at byte {position} there is no section where one should begin."
            )
        else:  # padding at the end
            return
        name = file.read(_NAME).split(b"\0")[0].decode("ascii", "replace") if length else ""
        start = position + _HEADER + (_NAME if length else 0)
        if start + length > size:
            raise LightFieldError(
                f"{path} is cut off or damaged: a section at byte {position} claims {length} bytes, "
                f"of which {max(0, size - start)} are there."
            )
        yield Section(header[:8], name, start, length)
        position = -(-(start + length) // 16) * 16
    raise LightFieldError(f"{path} is a damaged Lytro container: it has more than {_MOST_SECTIONS} sections.")


def _table(path: Path, file: BinaryIO, sections: list[Section]) -> dict[str, Any]:
    tables = [section for section in sections if section.kind == _TABLE and section.length]
    if len(tables) != 1:
        raise LightFieldError(
            f"{path} is a damaged Lytro container: it has {len(tables)} tables of contents, where there should be one."
        )
    return _json(path, file, tables[0], "its table of contents")


def _read(file: BinaryIO, section: Section) -> bytes:
    file.seek(section.start)
    return file.read(section.length)


def _json(path: Path, file: BinaryIO, section: Section, what: str) -> dict[str, Any]:
    if section.length > _MOST_JSON:
        raise LightFieldError(f"{path} is damaged: {what} is not JSON (it is too long).")
    try:
        value = json.loads(_read(file, section).rstrip(b"\0"))
    except (ValueError, RecursionError) as error:
        raise LightFieldError(f"{path} is damaged: {what} is not JSON ({' '.join(str(error).split())}).") from error
    if not isinstance(value, dict):
        raise LightFieldError(f"{path} is damaged: {what} is a JSON {type(value).__name__}, not an object.")
    return value
