"""Arrays of views that come as a whole: which axis is which, and what is kept, converted or refused."""

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.data.mapping import check_unchanged, is_mapped
from lfgpu.errors import LightFieldError
from lfgpu.io import parallax
from lfgpu.io.damage import naming
from lfgpu.io.disk import wanted_on_disk
from lfgpu.io.grid import needed_of
from lfgpu.io.images import FLOAT64_ROUNDED, opaque

ASK_FOR_GRID = "say how they stand: grid=(rows, columns), --grid ROWSxCOLUMNS on the command line"


def grid_shape(path: Path, count: int, grid: tuple[int, int] | None) -> tuple[int, int]:
    """Return (rows, columns) of `count` views, stored row by row: as told, else a square, else LightFieldError."""
    if grid is not None:
        rows, columns = grid
        if rows < 1 or columns < 1 or rows * columns != count:
            raise LightFieldError(f"{path} has {count} views, which is not a grid of {rows} x {columns}.")
        return rows, columns
    side = math.isqrt(count)
    if side * side != count or count < 4:
        raise LightFieldError(f"{path} has {count} views in one row of files or pages; {ASK_FOR_GRID}.")
    return side, side


def positions(shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return [n, 2] (u, v) of the places of a full grid, row by row."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)


_AXES = frozenset("vunyxc")
_COLOURS = (1, 3, 4)
_LOOKED_AT = 64  # views that are compared to see how their cameras stood
_EXTREME = 0.02  # of the largest value: alpha that is so near to an end is at it; of the pixels: so many may be between
_LONGEST = 5.0  # times longer than wide no view is
_OTHERS = {
    3: ("yxn",),
    4: ("nyxc", "vuyx", "ncyx", "yxcn", "yxnc", "cnyx", "yxvu"),
    5: ("yxvuc", "vucyx", "cvuyx", "yxcvu", "yxuvc"),
}
"""Other orders of axes in which arrays are written, by their number."""


def check_axes(axes: object) -> None:
    """Raise LightFieldError unless `axes` names each axis once: y, x, those of views and perhaps c."""
    if (
        isinstance(axes, str)
        and set("yx") <= set(axes) <= _AXES
        and len(set(axes)) == len(axes)
        and len(set("vu") & set(axes)) == (0 if "n" in axes else 2)
    ):
        return
    raise LightFieldError(
        f"axes must be letters such as vuyxc or yxcn, one for each axis of v, u or n, y, x and c; found {axes!r}."
    )


def arranged(
    path: Path, array: NDArray[Any], grid: tuple[int, int] | None, axes: str | None = None
) -> tuple[NDArray[Any], str]:
    """Arrange an array of views as [v, u, y, x, c]; returns it and what was guessed.

    Taken are [v, u, y, x, c], [v, u, y, x], [n, y, x, c] and [n, y, x], c = 1 to 4, unless `axes` says otherwise; n
    views row by row, in the grid that is told or in a square one. A last axis of up to 4 is that of the colours. Where
    that makes no sense, LightFieldError asks for `axes` with an order that does.
    """
    told = axes is not None
    if axes is None:
        colours = array.ndim >= 4 and array.shape[-1] <= 4
        axes = {3: "nyx", 4: "nyxc" if colours else "vuyx", 5: "vuyxc" if colours else ""}.get(array.ndim)
        if axes is None or 0 in array.shape:
            raise LightFieldError(
                f"{path} holds an array of shape {array.shape}; views must be [v, u, y, x, c], [v, u, y, x], "
                "[n, y, x, c] or [n, y, x]."
            )
        _check_sense(path, array.shape, axes, grid)
    elif len(axes) != array.ndim:
        raise LightFieldError(f"{path} holds an array of shape {array.shape}, which axes {axes} do not fit; name each.")
    elif "c" in axes and array.shape[axes.index("c")] > _COLOURS[-1]:
        raise LightFieldError(
            f"{path} holds an array of shape {array.shape}, of which axes {axes} make {array.shape[axes.index('c')]} "
            "colours; give an order with up to 4."
        )
    why = f"the axes of its array of shape {array.shape} are {axes}, {'as told' if told else 'as they fit'}"
    wanted = [axis for axis in "vunyxc" if axis in axes]
    array = array.transpose([axes.index(axis) for axis in wanted])
    if "c" not in axes:
        array = array[..., None]
    elif not told:
        _check_colours(path, array, axes)
    if "n" not in axes:
        if grid is not None and tuple(grid) != array.shape[:2]:
            raise LightFieldError(f"{path} has a grid of {array.shape[0]} x {array.shape[1]} views, not of {grid}.")
        return array, why
    shape = grid_shape(path, len(array), grid)
    how = "as told" if grid else _seen_as_square(path, array, shape)
    return array.reshape(*shape, *array.shape[1:]), f"{why}; its {len(array)} views fill a grid row by row, {how}"


def _seen_as_square(path: Path, array: NDArray[Any], shape: tuple[int, int]) -> str:
    """Say why n views [n, y, x, c] are taken for a square grid; LightFieldError if their pictures contradict that."""
    count = len(array)
    if array.dtype.kind not in "uf":  # which is refused later
        return "which is taken for a square"
    grids = [(rows, count // rows) for rows in range(1, count + 1) if count % rows == 0]
    told = parallax.in_sequence([parallax.grey(view) for view in array[:_LOOKED_AT]])
    found = None if told is None else parallax.best_order(told, grids)
    if found is None:
        return "which is taken for a square"
    if found != f"--grid {shape[0]}x{shape[1]}":
        raise LightFieldError(
            f"{path} has {count} views one after the other, which by their parallax are no square row by row: {found} "
            "fits (grid= and order= in Python); say how they stand with --grid ROWSxCOLUMNS."
        )
    return "a square, as their parallax shows"


def _check_colours(path: Path, array: NDArray[Any], axes: str) -> None:
    """Raise LightFieldError if the colours [..., y, x, c] of a view move against each other, as views do, or the alpha
    channel is none."""
    if array.dtype.kind not in "uf" or array.shape[-1] == 1:
        return
    view = array.reshape(-1, *array.shape[-3:])[len(array) // 2]
    no_alpha = view.shape[-1] in (2, 4) and not _is_mask(view[..., -1])
    if no_alpha or parallax.are_views([parallax.grey(view[..., k : k + 1]) for k in range(view.shape[-1])]):
        raise LightFieldError(
            f"{path}: what are the {view.shape[-1]} colours of each view in the usual order of axes, {axes}, look like "
            f"views; say the order with --axes, such as {axes.replace('n', 'v').replace('c', 'u')} (axes= in Python), "
            f"or --axes {axes} if they are colours."
        )


def _is_mask(alpha: NDArray[Any]) -> bool:
    """Tell whether the values of an alpha channel are a mask's: mostly one end, and elsewhere mostly the other."""
    top = 1.0 if alpha.dtype.kind == "f" else float(np.iinfo(alpha.dtype).max)
    least, most = float((alpha <= _EXTREME * top).mean()), float((alpha >= (1 - _EXTREME) * top).mean())
    between = 1 - least - most
    return between < _EXTREME or between < (1 - max(least, most)) / 2


def _check_sense(path: Path, shape: tuple[int, ...], axes: str, grid: tuple[int, int] | None) -> None:
    """Raise LightFieldError with the orders of axes that fit if the usual one makes no sense."""
    if axes and (_makes_sense(shape, axes) or (grid is not None and tuple(grid) == shape[:2])):
        return
    fitting = [other for other in _OTHERS[len(shape)] if other != axes and _makes_sense(shape, other)]
    size = dict(zip(axes, shape, strict=True)) if axes else {}
    # Views may be long where nothing else fits; but each of their sides is longer than each of the grid's.
    is_large = axes and min(size["y"], size["x"]) > max(size.get(axis, 1) for axis in "nvu")
    if is_large and not fitting and _makes_sense(shape, axes, longest=np.inf):
        return
    usual = f"views of {size['x']} x {size['y']} px" if axes else "no colours last"
    raise LightFieldError(
        f"{path} holds an array of shape {shape}, in the usual order of axes {usual}: say the order with --axes "
        f"{' or '.join(fitting) if fitting else 'ORDER, one letter of v, u (or n), y, x and c for each axis'} "
        f"(axes= in Python){f', or --axes {axes} if it is the usual one' if axes else ''}."
    )


def _makes_sense(shape: tuple[int, ...], axes: str, *, longest: float = _LONGEST) -> bool:
    """Tell whether views are larger than their grid, `longest` times as long as wide at most, and colours 1, 3 or 4."""
    size = dict(zip(axes, shape, strict=True))
    if size.get("c", 1) not in (*_COLOURS, *((2,) if axes[-1] == "c" else ())):
        return False
    if "n" in axes:
        count = size["n"]
        return count <= size["y"] * size["x"] and max(size["y"], size["x"]) <= longest * min(size["y"], size["x"])
    colours_for_views = size.get("c", 1) == 1 and {3, 4} & {size["v"], size["u"]} and size["v"] != size["u"]
    return bool(
        size["v"] <= size["y"]
        and size["u"] <= size["x"]
        and max(size["y"], size["x"]) <= longest * min(size["y"], size["x"])
        and not colours_for_views
    )


def storable(path: Path, array: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_] | None, list[str]]:
    """Convert views [..., c] to native byte order, uint8, uint16 or float32; returns them, their alpha, and notes."""
    notes, valid = [], None
    if array.dtype.kind not in "fu" or array.dtype.itemsize > 8:
        raise LightFieldError(f"{path} has {array.dtype} values; views must be uint8, uint16 or float32: convert them.")
    if array.shape[-1] in (2, 4):
        array, valid = array[..., :-1], opaque(array[..., -1])
        valid = None if valid.all() or not valid.any() else valid
    if array.dtype.itemsize == 8 and array.dtype.kind == "f":
        with np.errstate(over="ignore"):  # what becomes infinite is refused below
            array = array.astype(np.float32)
        notes.append(f"{FLOAT64_ROUNDED.capitalize()}.")
    array = array.astype(array.dtype.newbyteorder("="), copy=False)
    if array.dtype not in (np.uint8, np.uint16, np.float32):
        raise LightFieldError(f"{path} has {array.dtype} values; views must be uint8, uint16 or float32: convert them.")
    return array, valid, notes


def grid_field(
    path: Path, grid: NDArray[Any], *, valid: NDArray[np.bool_] | None = None, notes: Iterable[str] = (), **fields: Any
) -> LightField:
    """Make a light field of a full grid [v, u, y, x, c]; `valid` is [v, u, y, x].

    Views of which nothing is valid are left out, with a note, and those of a mapped array that are not needed.
    """
    if grid.ndim != 5 or 0 in grid.shape:
        raise LightFieldError(f"{path} holds an array of shape {grid.shape}; views must be [v, u, y, x, c].")
    views, seen, converted = storable(path, grid)
    if seen is not None:
        valid = seen if valid is None else valid & seen
    shape = (int(views.shape[0]), int(views.shape[1]))
    where, centre = positions(shape), (shape[0] // 2) * shape[1] + shape[1] // 2
    valid = None if valid is None else valid.reshape(-1, *views.shape[2:4])
    if is_mapped(views) and not wanted_on_disk():
        check_unchanged(views)
        kept = needed_of(where - where[centre])
        views = np.stack([views[divmod(index, shape[1])] for index in kept])
        valid = None if valid is None else valid[kept]
        where, centre = where[kept], list(kept).index(centre)
    else:
        views = np.ascontiguousarray(views).reshape(-1, *views.shape[2:])
    return field_of(
        path,
        views,
        where,
        valid=valid,
        reference=centre,
        grid_shape=shape,
        notes=(*notes, *converted),
        **fields,
    )


def field_of(
    path: Path, views: NDArray[Any], where: NDArray[Any], *, valid: NDArray[np.bool_] | None = None, **fields: Any
) -> LightField:
    """Make a light field of views [n, y, x, c] at positions `where`, its errors with the name of the file."""
    fields.setdefault("name", path.resolve().stem)
    with naming(path):
        light_field = LightField(views, where, valid=valid, **fields)
        return light_field if valid is None else without_dark_views(light_field)


def without_dark_views(light_field: LightField) -> LightField:
    """Leave out the views of which nothing is valid, with notes on what is not; `valid` is None where everything is."""
    valid = light_field.valid
    assert valid is not None
    if valid.all():
        return replace(light_field, valid=None)
    seen: NDArray[np.bool_] = np.asarray(valid.any(axis=(1, 2)))
    if not seen[light_field.reference_index]:
        raise LightFieldError("nothing of the middle view is valid; the views may be stored in another order.")
    notes = list(light_field.notes)
    if not seen.all():
        notes.append(f"Left out {int((~seen).sum())} of {len(seen)} views, which recorded nothing of use.")
        light_field = light_field.subset([int(index) for index in np.flatnonzero(seen)])
        valid = light_field.valid
        assert valid is not None
    notes.append(f"{100 * (1 - valid.mean()):.1f} % of the pixels are marked as not valid.")
    return replace(light_field, notes=tuple(notes))
