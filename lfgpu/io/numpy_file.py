"""NumPy files: one array of views, or an archive of views, positions and validity. Pickles are refused."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import arranged, field_of, grid_field, storable
from lfgpu.io.folders import head
from lfgpu.io.limits import check_claim
from lfgpu.lightfield import LightField

_MAGIC, _ZIP = b"\x93NUMPY", b"PK\x03\x04"


def recognise(path: Path) -> str | None:
    """Why a path is taken for a NumPy file; None if it is not."""
    start = head(path, 6)
    if start == _MAGIC:
        return "it begins as .npy files do"
    return "it is an .npz archive" if start[:4] == _ZIP and path.suffix.lower() == ".npz" else None


def read_numpy(path: Path, *, allow_missing: bool = False, grid: tuple[int, int] | None = None) -> LightField:
    """Read a .npy file, or an .npz archive with an array `views` or one array only.

    Views are [v, u, y, x, c], [v, u, y, x], [n, y, x, c] or [n, y, x]; n views without positions stand in a grid row by
    row. An archive may also have `positions` [n, 2] in view steps, with views [n, y, x, c], and `valid` of the shape of
    the views without c.

    Parameters
    ----------
    path
        The file.
    allow_missing
        Not needed.
    grid
        (rows, columns) of n views; None takes a square.

    Raises
    ------
    LightFieldError
        If the file is damaged, holds Python objects, or claims more than it can hold.
    """
    if recognise(path) is None:
        raise LightFieldError(f"{path} is not a NumPy file; give an .npy or .npz file of views.")
    try:
        arrays = _archive(path) if head(path, 4) == _ZIP else {"views": _file(path)}
    except LightFieldError:
        raise
    except Exception as error:  # NumPy and zipfile raise whatever comes to them when a file is damaged
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise LightFieldError(f"{path} cannot be read as NumPy data: {reason}.") from error
    views, positions, valid = (arrays.get(name) for name in ("views", "positions", "valid"))
    if views is None:
        raise LightFieldError(f"{path} has no array 'views'; it holds {', '.join(arrays) or 'nothing'}.")
    if valid is not None and valid.dtype != np.bool_:
        raise LightFieldError(f"{path}: 'valid' must be bool, found {valid.dtype}.")
    if positions is not None:
        if views.ndim == 3:
            views = views[..., None]
        if views.ndim != 4 or positions.dtype.kind not in "fiu":
            raise LightFieldError(
                f"{path}: with 'positions', 'views' must be [n, y, x, c] and positions numbers [n, 2]."
            )
        views, notes = storable(path, views)
        return field_of(path, views, positions, valid=_shaped(path, valid, views.shape[:3]), notes=tuple(notes))
    arrangement, guessed = arranged(path, views, grid)
    return grid_field(path, arrangement, valid=_shaped(path, valid, arrangement.shape[:4]), notes=guessed)


def _shaped(path: Path, valid: NDArray[Any] | None, shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    if valid is None:
        return None
    if valid.size != np.prod(shape) or valid.shape[-2:] != shape[-2:]:
        raise LightFieldError(f"{path}: 'valid' must be of the views' shape {shape}, found {valid.shape}.")
    return np.asarray(valid.reshape(shape))


def _file(path: Path) -> NDArray[Any]:
    with path.open("rb") as file:
        shape, dtype = _header(path, file)
        check_claim(path, shape, dtype)
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _archive(path: Path) -> dict[str, NDArray[Any]]:
    wanted: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if "views" not in members and len(members) == 1:
            members = {"views": next(iter(members.values()))}
        for name in ("views", "positions", "valid"):
            if name not in members:
                continue
            if members[name].compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise LightFieldError(f"{path} is packed in a way that NumPy does not use; write it with np.savez.")
            with archive.open(members[name]) as file:
                check_claim(path, *_header(path, file))
            with archive.open(members[name]) as file:
                wanted[name] = np.asarray(np.lib.format.read_array(file, allow_pickle=False))
        return wanted or dict.fromkeys(members, np.empty(0))


def _header(path: Path, file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise LightFieldError(
            f"{path} holds Python objects; such files can run code when they are read, and are refused."
        )
    if dtype.names is not None or dtype.subdtype is not None:
        raise LightFieldError(f"{path} holds records, not an array of numbers.")
    return shape, dtype
