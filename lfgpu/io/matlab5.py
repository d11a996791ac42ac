"""Numeric arrays of MATLAB files of version 5 to 7, every length and type checked before it is used.

SciPy's reader looks up types without asking whether they exist, so that one changed byte ends the process. The layout
is in "MAT-File Format" by The MathWorks: a header of 128 bytes, then elements, each a tag (type, length in bytes) and
its data; a variable is an element that holds others (flags, shape, name, numbers), all of it packed by zlib as a rule.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import check_claim

_HEADER = 128
_MATRIX, _PACKED = 14, 15
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_CLASSES = dict(
    enumerate(("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"), 6)
)
_OTHERS = {1: "cells", 2: "a struct", 3: "an object", 4: "text", 5: "a sparse matrix", 17: "an object"}
_LOGICAL, _COMPLEX = 0x02, 0x08
_MOST_AXES, _LONGEST_NAME = 32, 256
_MOST_VARIABLES = 10_000
_PIECE = 1 << 16  # bytes that are unpacked at once

_Read = Callable[[int], bytes]
"""Gives so many bytes, or raises ValueError."""


@dataclass(frozen=True)
class Variable:
    """The name, shape and class of one variable, and its place in the file."""

    name: str
    shape: tuple[int, ...]
    kind: str  # the class in words of MATLAB: "uint8", "double" ...; or what else it is
    position: int


def variables(path: Path) -> list[Variable]:
    """List the variables of a file, in its order; LightFieldError if it is damaged."""
    with path.open("rb") as file:
        order, size = _start(path, file)
        found: list[Variable] = []
        position = _HEADER
        while position < size:
            if len(found) == _MOST_VARIABLES:
                raise LightFieldError(f"{path} has more than {_MOST_VARIABLES} variables; no light field has.")
            read, end = _element(path, file, order, position, size)
            with _damage_said(path):
                found.append(_described(read, order, position))
            position = end
        return found


def load(path: Path, variable: Variable) -> NDArray[Any]:
    """Load the numbers of a variable of class uint8, uint16, single or double.

    They have the type of their class. Doubles that MATLAB stored as unsigned integers, because all are whole, keep that
    type.

    Raises
    ------
    LightFieldError
        If it is of another class, is complex, claims more than the file can hold, or is damaged.
    """
    dtypes = {"uint8": "u1", "uint16": "u2", "single": "f4", "double": "f8"}
    if variable.kind not in dtypes:
        raise LightFieldError(
            f"{path}: {variable.name} holds {variable.kind}; wanted are uint8, uint16, single or double."
        )
    check_claim(path, variable.shape, dtypes[variable.kind])
    with path.open("rb") as file:
        order, size = _start(path, file)
        read, _ = _element(path, file, order, variable.position, size)
        with _damage_said(path):
            _described(read, order, variable.position)
            kind, length = _tag(read, order)
            stored = np.dtype(order + _STORED[kind]) if kind in _STORED else None
            count = int(np.prod(variable.shape, dtype=object))
            if stored is None or length != count * stored.itemsize:
                raise ValueError(f"{variable.name} claims {count} numbers in {length} bytes of type {kind}")
            numbers = np.frombuffer(read(length), stored).reshape(variable.shape, order="F")
    wanted = np.dtype(dtypes[variable.kind])
    if stored.kind == "u" and wanted.kind == "f" and stored.itemsize <= 2:
        wanted = stored
    if wanted.kind == "u" and not np.can_cast(stored, wanted, "safe"):
        raise LightFieldError(f"{path} is damaged: {variable.name} is {variable.kind}, but stored as {stored.name}.")
    return numbers.astype(wanted.newbyteorder("="), copy=False)


def _start(path: Path, file: BinaryIO) -> tuple[str, int]:
    """Return the order of bytes, "<" or ">", and the size of the file."""
    order = {b"IM": "<", b"MI": ">"}.get(file.read(_HEADER)[126:])
    if order is None:
        raise LightFieldError(f"{path} is a damaged MATLAB file: its header does not say the order of bytes.")
    return order, path.stat().st_size


def _element(path: Path, file: BinaryIO, order: str, position: int, size: int) -> tuple[_Read, int]:
    """Return a reader of the contents of the variable at a position, and where the next one begins."""
    file.seek(position)
    with _damage_said(path):
        kind, length = _tag(_plain(file, size - position), order)
        start, end = position + 8, position + 8 + length
        if kind not in (_MATRIX, _PACKED) or end > size:
            raise ValueError(f"at byte {position} it has an element of type {kind} and {length} bytes")
        if kind == _MATRIX:
            return _plain(file, length), start + -(-length // 8) * 8
        read = _unpacked(file, length)
        kind, _ = _tag(read, order)
        if kind != _MATRIX:
            raise ValueError(f"at byte {position} an element of type {kind} is packed")
        return read, end


def _described(read: _Read, order: str, position: int) -> Variable:
    """Read flags, shape and name of a variable, which come before its numbers."""
    flags = _small(read, order, {6}, 8)
    if len(flags) != 8:
        raise ValueError(f"at byte {position} the flags of a variable are missing")
    word = struct.unpack(f"{order}I", flags[:4])[0]
    number, bits = word & 0xFF, word >> 8
    if number not in _CLASSES:
        if number == 17:  # has no shape
            return Variable("an object", (), _OTHERS[17], position)
        kind = _OTHERS.get(number, f"class {number}")
    else:
        kind = "logical" if bits & _LOGICAL else "complex numbers" if bits & _COMPLEX else _CLASSES[number]
    axes = _small(read, order, {5, 6}, 4 * _MOST_AXES)
    shape = tuple(int(side) for side in np.frombuffer(axes[: len(axes) // 4 * 4], f"{order}i4"))
    name = _small(read, order, {1, 2, 16}, _LONGEST_NAME).decode("utf-8", "backslashreplace")
    if any(side < 0 for side in shape) or not shape:
        raise ValueError(f"{name} claims the shape {shape}")
    return Variable(name, shape, kind, position)


@contextmanager
def _damage_said(path: Path) -> Iterator[None]:
    try:
        yield
    except LightFieldError:
        raise
    except ValueError as error:
        raise LightFieldError(f"{path} is a damaged MATLAB file: {error}.") from error


def _tag(read: _Read, order: str) -> tuple[int, int]:
    """Read type and length of an element whose data follow."""
    kind, length = struct.unpack(f"{order}II", read(8))
    return kind, length


def _small(read: _Read, order: str, kinds: set[int], most: int) -> bytes:
    """Read the data of an element of one of these types, of at most so many bytes; they may stand within the tag."""
    tag = read(8)
    kind, length = struct.unpack(f"{order}II", tag)
    if within := kind >> 16:
        kind, length = kind & 0xFFFF, within
    if kind not in kinds or length > (4 if within else most):
        raise ValueError(f"an element of type {kind} and {length} bytes stands where there should be none")
    return tag[4 : 4 + length] if within else read(-(-length // 8) * 8)[:length]


def _plain(file: BinaryIO, most: int) -> _Read:
    left = most

    def read(count: int) -> bytes:
        nonlocal left
        left -= count
        data = file.read(count) if left >= 0 else b""
        if len(data) < count:
            raise ValueError("it ends too early")
        return data

    return read


def _unpacked(file: BinaryIO, length: int) -> _Read:
    """Return a reader that unpacks what is asked for and no more, so that little data cannot become much."""
    inflater, left = zlib.decompressobj(), length

    def read(count: int) -> bytes:
        nonlocal left
        found = bytearray()
        while len(found) < count:
            packed = inflater.unconsumed_tail
            if not packed:
                packed = file.read(min(_PIECE, left))
                left -= len(packed)
            try:
                data = inflater.decompress(packed, count - len(found))
            except zlib.error as error:
                raise ValueError("what is packed in it cannot be unpacked") from error
            if not data and not packed:
                raise ValueError("it ends too early")
            found += data
        return bytes(found)

    return read
