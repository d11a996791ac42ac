"""Light fields that the Light Field Toolbox for MATLAB decoded: .mat files with LF [t, s, v, u, c]."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField, Reading
from lfgpu.errors import LightFieldError
from lfgpu.io import hdf5, matlab5
from lfgpu.io.arrays import arranged, grid_field
from lfgpu.io.brightness import without_dark_parts
from lfgpu.io.damage import read_as
from lfgpu.io.folders import head

_MAGIC_5, _MAGIC_7 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_LEAST_WEIGHT = 0.25  # of the largest: what the white image says of pixels at the rim of the main lens


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a MATLAB file; None if it is not."""
    return "it begins as MATLAB files do" if head(path, 19) in (_MAGIC_5, _MAGIC_7) else None


def read_lftoolbox(path: Path, *, axes: str | None = None) -> LightField:
    """Read a .mat file of version 5 to 7, or of 7.3 (extra `hdf5`).

    The variable LF, or the only one with five axes, is [t, s, v, u, c]: rows of views, columns of views, y, x, colour.
    A fourth colour is the weight of each pixel: what has less than a quarter of the largest is marked as not valid.
    Without weights, what is less than half as bright as the middle view is. Views of which nothing is valid are left
    out. `axes` is another order of the axes, such as "yxvuc"; None takes "vuyxc" where that makes sense.
    """
    if recognise(path) is None:
        raise LightFieldError(f"{path} is not a MATLAB file; give the .mat file that the Light Field Toolbox wrote.")
    array = _load_5(path, axes) if head(path, 19) == _MAGIC_5 else _load_7(path, axes)
    grid, why = arranged(path, array, None, axes)
    weight = None
    if grid.shape[4] in (2, 4):
        grid, weight = grid[..., :-1], grid[..., -1]
        if not np.isfinite(weight).all():
            raise LightFieldError(f"{path} has NaN or infinite weights.")
    light_field = grid_field(path, grid, reading=Reading(why))
    valid = None if weight is None else weight > _LEAST_WEIGHT * weight.max()
    return without_dark_parts(path, light_field, valid)


def _load_5(path: Path, axes: str | None) -> NDArray[Any]:
    with read_as(path):
        found = {variable.name: variable for variable in matlab5.variables(path)}
        for variable in found.values():
            if variable.name == "LF" and variable.kind.startswith(("a struct", "cells", "an object")):
                raise LightFieldError(
                    f"{path}: LF is {variable.kind}, not an array; in MATLAB, save the array in it by itself, such as "
                    "LF = LF.data; save('LF.mat', 'LF')."
                )
        shapes = {name: v.shape for name, v in found.items() if v.kind[0].islower() and " " not in v.kind}
        return matlab5.load(path, found[_chosen(path, shapes, axes)])


def _load_7(path: Path, axes: str | None) -> NDArray[Any]:
    with hdf5.opened(path) as root:
        arrays = hdf5.datasets(root)
        name = _chosen(path, {name: dataset.shape[::-1] for name, dataset in arrays.items() if dataset.shape}, axes)
        return np.ascontiguousarray(hdf5.load(path, arrays[name]).T)  # MATLAB counts the axes from the other end


def _chosen(path: Path, shapes: dict[str, tuple[int, ...]], axes: str | None) -> str:
    counts = (len(axes),) if axes else (5,)
    fitting = [name for name, shape in shapes.items() if len(shape) in counts and 0 not in shape]
    if "LF" in fitting:
        return "LF"
    if len(fitting) == 1:
        return fitting[0]
    other = [shape for name, shape in shapes.items() if name == "LF"]
    if other and len(other[0]) == 4 and axes is None:
        raise LightFieldError(
            f"{path}: LF has the shape {other[0]}, four axes instead of [t, s, v, u, c]; say which, with --axes vuyx "
            "for grey views, or nyxc (axes= in Python)."
        )
    held = ", ".join(f"{name} {shape}" for name, shape in list(shapes.items())[:5]) or "no array"
    raise LightFieldError(
        f"{path} has no variable LF [t, s, v, u, c] of 1 to 4 colours; it holds {held}; other orders of "
        "axes are told by --axes (axes= in Python)."
    )
