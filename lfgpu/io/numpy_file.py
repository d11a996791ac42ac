"""NumPy files: arrays whose headers are judged before memory is taken, and light fields in them. No pickles."""

import math
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField, Reading
from lfgpu.data.mapping import mapped
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import arranged, field_of, grid_field, storable
from lfgpu.io.damage import check_claim, check_memory, read_as, reason_of
from lfgpu.io.disk import wanted_on_disk
from lfgpu.io.folders import head
from lfgpu.io.grid import reads_in_part

_ALWAYS_FINE = 1 << 28  # bytes: so much any archive may take unpacked
_PACKED = 50  # times smaller than the arrays in it is an archive of maps at most; ours are not packed at all
_MOST_ARRAYS = 1000

MAGIC, ZIP = b"\x93NUMPY", b"PK\x03\x04"


def load_arrays(path: Path, names: Sequence[str] = (), *, of_maps: bool = False) -> dict[str, NDArray[Any]]:
    """Load the arrays of these names, those that are there; without names all of an archive.

    An .npy file holds the first one. `of_maps` says that the file is one of maps (`check_archive`).

    LightFieldError if the file is damaged, holds Python objects, claims more than it can hold, or lacks the first one.
    """
    with read_as(path, "NumPy data"), _told(path):
        if of_maps:
            check_archive(path)
        return _archive(path, names) if not names or head(path, 4) == ZIP else {names[0]: _file(path)}


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Say what is wrong with a file that zipfile or NumPy cannot read."""
    try:
        yield
    except (LightFieldError, OSError):
        raise
    except Exception as error:
        start = head(path, len(MAGIC))
        if start != MAGIC and start[:4] != ZIP:
            reason = "it does not begin as .npy and .npz files do"
        elif isinstance(error, EOFError) or (start != MAGIC and not zipfile.is_zipfile(path)):
            reason = "it ends too early"  # as a ZIP file does whose list of files, at its end, is missing
        else:
            reason = f"it is damaged ({reason_of(error)})"
        raise ValueError(reason) from error


def _file(path: Path) -> NDArray[Any]:
    with path.open("rb") as file:
        shape, dtype, fortran = header(path, file)
        size = dtype.itemsize * math.prod(int(side) for side in shape)
        check_claim(path, shape, dtype, in_memory=not wanted_on_disk())
        if size > path.stat().st_size - file.tell():
            raise EOFError
        if size > 0 and (wanted_on_disk() or reads_in_part()):
            return mapped(file, shape, dtype, offset=file.tell(), fortran=fortran)
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
    """Raise LightFieldError if the arrays of an .npz claim more than one of ours can hold, or than the memory."""
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


_AXES = (4, 5)  # of views, unless they are grey and in a row, as stacks of anything else may be


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a NumPy file; None if it is not."""
    start = head(path, 6)
    if start == MAGIC:
        return "it begins as .npy files do"
    return "it is an .npz archive" if start[:4] == ZIP and path.suffix.lower() == ".npz" else None


def holds_views(path: Path) -> bool:
    """Tell whether a file that nobody named may be one of views: False for NumPy files of other things."""
    start = head(path, 6)
    try:
        if start[:4] == ZIP:
            with zipfile.ZipFile(path) as archive:
                return "views.npy" in archive.namelist()
        if start == MAGIC:
            with path.open("rb") as file:
                return len(header(path, file)[0]) in _AXES
    except Exception:  # damaged, which whoever reads it will say
        return True
    return True


def read_numpy(path: Path, *, grid: tuple[int, int] | None = None, axes: str | None = None) -> LightField:
    """Read a .npy file, or an .npz archive with an array `views`.

    Views are [v, u, y, x, c], [v, u, y, x], [n, y, x, c] or [n, y, x]; n views without positions stand row by row in
    the `grid` that is given, or in a square; `axes` is another order of the axes, such as "yxvuc". An archive may also
    have `positions` [n, 2] in view steps, with views [n, y, x, c], and `valid` of the shape of the views without c.
    Files of Python objects are refused.
    """
    if recognise(path) is None:
        raise LightFieldError(f"{path} is not a NumPy file; give an .npy or .npz file of views.")
    arrays = load_arrays(path, ("views", "positions", "valid"))
    views, positions, valid = (arrays.get(name) for name in ("views", "positions", "valid"))
    assert views is not None
    if valid is not None and valid.dtype != np.bool_:
        raise LightFieldError(f"{path}: 'valid' must be bool, found {valid.dtype}.")
    if positions is not None:
        if views.ndim == 3:
            views = views[..., None]
        if views.ndim != 4 or positions.dtype.kind not in "fiu":
            raise LightFieldError(
                f"{path}: with 'positions', 'views' must be [n, y, x, c] and positions numbers [n, 2]."
            )
        views, seen, notes = storable(path, views)
        mask = _shaped(path, valid, views.shape[:3])
        mask = seen if mask is None else mask if seen is None else mask & seen
        return field_of(
            path, views, positions, valid=mask, notes=tuple(notes), reading=Reading("positions of the file")
        )
    views, why = arranged(path, views, grid, axes)
    return grid_field(path, views, valid=_shaped(path, valid, views.shape[:4]), reading=Reading(why))


def _shaped(path: Path, valid: NDArray[Any] | None, shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    if valid is None:
        return None
    if valid.size != np.prod(shape) or valid.shape[-2:] != shape[-2:]:
        raise LightFieldError(f"{path}: 'valid' must be of the views' shape {shape}, found {valid.shape}.")
    return np.asarray(valid.reshape(shape))
