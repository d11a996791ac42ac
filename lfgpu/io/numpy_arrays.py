"""Arrays of .npy and .npz files, whose headers are judged before memory is taken; pickles are refused."""

import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.mapping import mapped
from lfgpu.errors import LightFieldError
from lfgpu.io.damage import check_claim, check_memory, read_as
from lfgpu.io.disk import wanted_on_disk
from lfgpu.io.folders import head

_ALWAYS_FINE = 1 << 28  # bytes: so much any archive may take unpacked
_PACKED = 50  # times smaller than the arrays in it is an archive of maps at most; ours are not packed at all
_MOST_ARRAYS = 1000

MAGIC, ZIP = b"\x93NUMPY", b"PK\x03\x04"


def load_arrays(path: Path, names: Sequence[str] = (), *, of_maps: bool = False) -> dict[str, NDArray[Any]]:
    """Load the arrays of these names, those that are there; without names all of an archive.

    An .npy file holds the first one. `of_maps` says that the file is one of maps (`check_archive`).

    LightFieldError if the file is damaged, holds Python objects, claims more than it can hold, or lacks the first one.
    """
    with read_as(path, "NumPy data"):
        if of_maps:
            check_archive(path)
        return _archive(path, names) if not names or head(path, 4) == ZIP else {names[0]: _file(path)}


def _file(path: Path) -> NDArray[Any]:
    with path.open("rb") as file:
        shape, dtype, fortran = header(path, file)
        size = dtype.itemsize * math.prod(int(side) for side in shape)
        if wanted_on_disk() and size > 0:
            check_claim(path, shape, dtype, in_memory=False)
            if size > path.stat().st_size - file.tell():
                raise ValueError("it ends too early")
            return mapped(file, shape, dtype, offset=file.tell(), fortran=fortran)
        check_claim(path, shape, dtype)
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _archive(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        for name in names or members:
            if name not in members:
                continue
            if members[name].compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise LightFieldError(f"{path} is packed in a way that NumPy does not use; write it with np.savez.")
            with archive.open(members[name]) as file:
                check_claim(path, *header(path, file)[:2])
            with archive.open(members[name]) as file:
                found[name] = np.asarray(np.lib.format.read_array(file, allow_pickle=False))
    if names and names[0] not in found:
        raise LightFieldError(f"{path} has no array {names[0]!r}; it holds {', '.join(members) or 'nothing'}.")
    return found


def check_archive(path: Path) -> None:
    """Raise LightFieldError if all arrays of an .npz together claim more than what we write as one can hold, or the
    memory.

    What is damaged otherwise, or is no .npz, passes: who reads it says so.
    """
    if head(path, 4) != ZIP:
        return
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        claimed = 0
        for info in members[:_MOST_ARRAYS]:
            with archive.open(info) as file:
                shape, dtype, _ = header(path, file)
            claimed += dtype.itemsize * math.prod(int(side) for side in shape)
    stored = path.stat().st_size
    if claimed > max(_ALWAYS_FINE, _PACKED * stored) or len(members) > _MOST_ARRAYS:
        raise LightFieldError(
            f"{path} is damaged: its {len(members)} arrays claim {claimed} bytes, more than maps in a file of "
            f"{stored} bytes take."
        )
    check_memory(path, claimed, advice="free some, or read it on a larger machine")


def header(path: Path, file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any], bool]:
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    if dtype.hasobject:
        raise LightFieldError(
            f"{path} cannot be read as NumPy data: it holds Python objects, which can run code when they are read; "
            "save an array of numbers."
        )
    if dtype.names is not None or dtype.subdtype is not None:
        raise LightFieldError(f"{path} holds records, not an array of numbers.")
    return shape, dtype, fortran
