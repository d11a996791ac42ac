"""Light fields and maps as xarray datasets: arrays with named axes, coordinates and units."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from lfgpu.data import DepthResult, DisparityMap, LightField, ViewsResult
from lfgpu.data.summary import UNIT
from lfgpu.errors import LightFieldError
from lfgpu.io.about import CONVENTION
from lfgpu.io.damage import require

if TYPE_CHECKING:
    import xarray
    from numpy.typing import NDArray

    from lfgpu.data import Geometry

_STEPS = {"units": "view steps"}
_COLOURS = {1: ["grey"], 3: ["red", "green", "blue"]}


def to_xarray(shown: LightField | DepthResult | DisparityMap | ViewsResult) -> xarray.Dataset:
    """Convert a light field, a result or a map to an xarray dataset with named axes, coordinates and units.

    Parameters
    ----------
    shown
        A light field gives the variable `views` with the axes (v, u, y, x, channel) if all places of its grid have a
        view, else (view, y, x, channel), and `valid` if it has masks. A result or a map gives `disparity` and, if they
        are known, `confidence`, `uncertainty` and `depth`, with the axes (y, x); maps of all views have the axes
        (view, y, x). Arrays are not copied if their layout allows it.

    Returns
    -------
    xarray.Dataset
        Each variable has `units`. The coordinates u and v are positions in view steps, x and y are pixels. Attributes
        hold the name, the sign of disparities and the geometry, so that `to_netcdf` keeps them.

    Raises
    ------
    LightFieldError
        If xarray is not installed, or `shown` is something else.

    Examples
    --------
    >>> lf = lfgpu.scenes.make("boxes", grid=(3, 3), size=(48, 64))
    >>> dict(lfgpu.to_xarray(lf).sizes)
    {'v': 3, 'u': 3, 'y': 48, 'x': 64, 'channel': 3}
    >>> lfgpu.to_xarray(lfgpu.estimate_depth(lf)).depth.attrs["units"]
    'm'
    """
    xarray = require("xarray", "xarray", "to_xarray")
    match shown:
        case LightField():
            variables, coordinates, about = _views(shown)
        case DepthResult():
            variables, coordinates, about = _map(shown.map)
            about |= {"method": shown.config.method, "backend": shown.backend, "device": shown.device}
            about |= {"notes": list(shown.notes + shown.remarks)}
        case DisparityMap():
            variables, coordinates, about = _map(shown)
        case ViewsResult():
            variables, coordinates, about = _maps(shown)
        case _:
            raise LightFieldError(
                f"to_xarray takes a LightField, DepthResult, DisparityMap or ViewsResult, not {type(shown).__name__}."
            )
    axes, values, _ = next(iter(variables.values()))
    height, width = (values.shape[axes.index(axis)] for axis in ("y", "x"))
    coordinates |= {"y": ("y", np.arange(height), {"units": "px"}), "x": ("x", np.arange(width), {"units": "px"})}
    return xarray.Dataset(variables, coordinates, {**about, "convention": CONVENTION})


_Parts = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]
"""Variables, coordinates and attributes."""


def _views(lf: LightField) -> _Parts:
    grid, about = lf.grid_shape, {"name": lf.name, "reference": list(map(float, lf.positions[lf.reference_index]))}
    values = {"views": (lf.views, ["y", "x", "channel"], {"units": "1", "scale_factor_to_unit_intensity": lf.scale})}
    if lf.valid is not None:
        values["valid"] = (lf.valid, ["y", "x"], {"units": "1"})
    coordinates: dict[str, Any] = {"channel": _COLOURS[lf.channels]}
    if grid is not None and not lf.missing and _row_by_row(lf.positions, grid):
        first = lf.positions.reshape(*grid, 2)
        coordinates |= {"v": ("v", first[:, 0, 1], _STEPS), "u": ("u", first[0, :, 0], _STEPS)}
        variables = {
            n: (["v", "u", *axes], a.reshape(*grid, *a.shape[1:]), say) for n, (a, axes, say) in values.items()
        }
    else:
        coordinates |= _positions(lf.positions)
        variables = {n: (["view", *axes], a, say) for n, (a, axes, say) in values.items()}
    return variables, coordinates, about | _geometry(lf.geometry)


def _row_by_row(positions: NDArray[np.float64], grid: tuple[int, int]) -> bool:
    places = positions.reshape(*grid, 2)
    return bool((places[..., 0] == places[:1, :, 0]).all() and (places[..., 1] == places[:, :1, 1]).all())


def _map(map_: DisparityMap) -> _Parts:
    units = {"disparity": UNIT, "confidence": "1", "uncertainty": UNIT, "depth": "m"}
    variables = {name: (["y", "x"], a, {"units": units[name]}) for name, a in map_.known_maps.items()}
    about = {} if map_.position is None else {"position": list(map(float, map_.position))}
    return variables, {}, {"name": map_.name, **about, **_geometry(map_.geometry)}


def _maps(maps: ViewsResult) -> _Parts:
    axes = ["view", "y", "x"]
    variables = {
        "disparity": (axes, maps.disparities, {"units": UNIT}),
        "confidence": (axes, maps.confidences, {"units": "1"}),
    }
    return variables, _positions(maps.positions), {"name": maps.reference.name, **_geometry(maps.reference.geometry)}


def _positions(positions: NDArray[np.float64]) -> dict[str, Any]:
    return {"u": ("view", positions[:, 0], _STEPS), "v": ("view", positions[:, 1], _STEPS)}


def _geometry(geometry: Geometry | None) -> dict[str, Any]:
    values = {} if geometry is None else asdict(geometry)
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in values.items() if value is not None
    }
