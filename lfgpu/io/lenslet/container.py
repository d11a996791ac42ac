"""The container of Lytro cameras (.lfp, .lfr): sections of data that are named by their SHA-1, and JSON about them.

The file begins with 16 bytes, `_MAGIC` and a version. A section has a header of 16 bytes: a magic that says what it is,
and the length of its data, big endian. If that is not 0, 80 bytes with the section's name follow, then the data, then
zeros up to a multiple of 16.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from lfgpu.errors import LightFieldError

_MAGIC, _TABLE, _DATA = (b"\x89LF" + kind + b"\r\n\x1a\n" for kind in (b"P", b"M", b"C"))
_HEADER, _NAME = 16, 80  # bytes
_MOST_SECTIONS = 1000
_MOST_JSON = 1 << 24  # bytes
_FRAMES = (("picture", "frameArray"), ("master", "picture", "frameArray"), ("frames",))
"""Where the first Lytro, the Illum's desktop files and the Illum itself list what belongs to a picture."""


@dataclass(frozen=True)
class Section:
    """One section of a container."""

    kind: bytes
    name: str
    start: int
    length: int


@dataclass(frozen=True)
class Contents:
    """The raw picture of a container."""

    metadata: dict[str, Any]
    image: bytes
    notes: tuple[str, ...]


def is_container(path: Path) -> bool:
    """Whether a file begins as a container does."""
    try:
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except OSError:
        return False


def read_container(path: Path) -> Contents:
    """Read the raw picture of a container and what is said about it; LightFieldError if there is none, or damage."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if file.read(_HEADER)[: len(_MAGIC)] != _MAGIC:
                raise LightFieldError(f"{path} is not a Lytro container: it does not begin as one.")
            sections = list(_sections(path, file, size))
            table = _table(path, file, sections)
            frame = _frame(path, table)
            named = {section.name: section for section in sections}
            metadata = _json(path, _read(file, _named(path, named, frame, "metadataRef")), "its metadata")
            chosen = _named(path, named, frame, "imageRef")
            image = _read(file, chosen)
    except OSError as error:
        raise LightFieldError(f"{path} cannot be read: {error.strerror or error}.") from error
    sound = chosen.name == f"sha1-{hashlib.sha1(image, usedforsecurity=False).hexdigest()}"
    notes = () if sound else ("The picture's SHA-1 is not the one that the container names it by; it may be damaged.",)
    return Contents(metadata, image, notes)


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
    return _json(path, _read(file, tables[0]), "its table of contents")


def _frame(path: Path, table: dict[str, Any]) -> dict[str, Any]:
    for keys in _FRAMES:
        frames: Any = table
        for key in keys:
            frames = frames.get(key) if isinstance(frames, dict) else None
        if (
            isinstance(frames, list)
            and frames
            and isinstance(frames[0], dict)
            and isinstance(frames[0].get("frame"), dict)
        ):
            return frames[0]["frame"]
    raise LightFieldError(
        f"{path} has no raw picture: it is a Lytro container with {_keys(table)} only, perhaps one that was already "
        "processed; give the one with the raw picture, as the camera wrote it."
    )


def _named(path: Path, named: dict[str, Section], frame: dict[str, Any], key: str) -> Section:
    name = frame.get(key)
    if not isinstance(name, str) or not name or name not in named:
        raise LightFieldError(f"{path} is incomplete: its {key} names {name!r}, and there is no such section.")
    return named[name]


def _read(file: BinaryIO, section: Section) -> bytes:
    file.seek(section.start)
    return file.read(section.length)


def _json(path: Path, data: bytes, what: str) -> dict[str, Any]:
    try:
        if len(data) > _MOST_JSON:
            raise ValueError("it is too long")
        value = json.loads(data.rstrip(b"\0"))
    except (ValueError, RecursionError) as error:
        raise LightFieldError(f"{path} is damaged: {what} is not JSON ({' '.join(str(error).split())}).") from error
    if not isinstance(value, dict):
        raise LightFieldError(f"{path} is damaged: {what} is a JSON {type(value).__name__}, not an object.")
    return value


def _keys(table: dict[str, Any]) -> str:
    return ", ".join(repr(key) for key in list(table)[:5]) or "nothing"
