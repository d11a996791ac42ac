"""NumPy files: one array of views, or an archive of views, positions and validity. Pickles are refused."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.data.reading import Reading
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import arranged, field_of, grid_field, storable
from lfgpu.io.folders import head
from lfgpu.io.numpy_arrays import MAGIC, ZIP, header, load_arrays

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
