"""Export of a light field with its maps as a scene of COLMAP and nerfstudio: cameras, depths, coloured points."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.calibration.formats.colmap import write_colmap, write_depth
from lfgpu.calibration.formats.nerfstudio import write_nerfstudio
from lfgpu.calibration.parallel import ideal_cameras, world_of
from lfgpu.contract import Float32Array
from lfgpu.data import DepthResult, DisparityMap, Geometry, LightField, ViewsResult, point_cloud
from lfgpu.errors import LightFieldError
from lfgpu.io import atomic_folder, check_no_inputs, check_writable
from lfgpu.io.ply import write_vertices
from lfgpu.io.png import quantised, write_png

POINTS = 200_000
"""Largest number of points that are written, about."""

_SURE = 0.5  # confidence from which on a pixel gives a point
_LARGEST = 65535  # units that a depth picture holds at most
_FEWEST = 655  # units of the deepest pixel: less is told too coarsely
_MILLIMETRE = 1e-3
_LEFT_OUT = 0.1  # per cent of the pixels, those that are deepest: a unit need not hold them


def export_scene(
    lf: LightField,
    maps: ViewsResult | DepthResult | DisparityMap,
    folder: str | os.PathLike[str],
) -> tuple[str, ...]:
    """Write a light field and its maps as a folder that COLMAP, nerfstudio and Gaussian splatting take.

    The world is in metres: x to the right, y down, z away from the camera whose frame is not shifted.

    - `images/`: the views.
    - `sparse/0/`: COLMAP's cameras, images and points, binary; a lens for each view, as their frames are shifted.
    - `stereo/depth_maps/NAME.geometric.bin`: COLMAP's depth of each view with a map, float32, 0 where unknown.
    - `transforms.json`: nerfstudio's frames, with `depth_file_path`; OpenGL axes of cameras.
    - `depths/`: its depth of each view with a map, uint16, 0 where unknown or beyond what 16 bits hold; in millimetres,
      as nerfstudio takes them, or where these do not fit the scene, in a power of ten of metres, which
      `transforms.json` has as `depth_unit_scale_factor`.
    - `points.ply`: coloured points, about 200 000 at most, of pixels with a confidence of at least 0.5.

    Parameters
    ----------
    lf
        The light field; its geometry must be known.
    maps
        The maps of all its views, or one map of one of them: then other views have no depth.
    folder
        The folder; an older one is overwritten.

    Returns
    -------
    What a reader has to know of the depth pictures, one sentence each: their unit if it is not the millimetre, and how
    much is beyond what they hold.

    Raises
    ------
    LightFieldError
        If the geometry is not known, the maps do not belong to the views, no pixel has a depth, or a view was read from
        a file that would be replaced.

    Examples
    --------
    >>> notes = lfgpu.calibration.export_scene(lf, result, "scene")
    >>> Path("scene/transforms.json").exists()
    True
    """
    geometry = check_scene(lf, folder)
    found = _maps(lf, maps, geometry)
    cameras = [
        replace(camera, name=name)
        for name, camera in zip(_names(lf), ideal_cameras(replace(lf, geometry=geometry)), strict=True)
    ]
    points, colors = _points(lf, found)
    unit, notes = _unit(found)
    with atomic_folder(folder) as place:
        for name in ("images", "depths", "sparse/0", "stereo/depth_maps"):
            (place / name).mkdir(parents=True)
        files = []
        for n, camera in enumerate(cameras):
            write_png(place / "images" / camera.name, _bytes(lf, n))
            files.append({"file_path": f"images/{camera.name}"})
            if n in found:
                depth = found[n].depth
                assert depth is not None
                write_png(place / "depths" / camera.name, _whole_units(depth, unit))
                write_depth(place / "stereo" / "depth_maps" / f"{camera.name}.geometric.bin", depth)
                files[-1]["depth_file_path"] = f"depths/{camera.name}"
        write_colmap(place / "sparse" / "0", cameras, points, colors)
        write_nerfstudio(place / "transforms.json", cameras, files=files, points="points.ply", depth_unit=unit)
        columns: dict[str, tuple[str, NDArray[Any]]] = {
            name: ("f4", points[:, axis]) for axis, name in enumerate("xyz")
        }
        columns |= {name: ("u1", colors[:, axis]) for axis, name in enumerate(("red", "green", "blue"))}
        write_vertices(place / "points.ply", columns)
    return notes


def check_scene(lf: LightField, folder: str | os.PathLike[str]) -> Geometry:
    """Return the geometry of a light field that can be exported to a folder; LightFieldError if it cannot be."""
    check_writable(folder)
    check_no_inputs((Path(folder, "images", name) for name in _names(lf)), lf.files)
    return world_of(lf)


# --- steps ---


def _names(lf: LightField) -> list[str]:
    return [f"view_{n:03d}.png" for n in range(len(lf.views))]


def _maps(
    lf: LightField, maps: ViewsResult | DepthResult | DisparityMap, geometry: Geometry
) -> dict[int, DisparityMap]:
    """Collect the maps by the index of their view, in the common world."""
    if isinstance(maps, ViewsResult):
        if maps.disparities.shape != lf.views.shape[:3] or not np.allclose(maps.positions, lf.positions, atol=1e-6):
            raise LightFieldError(f"the maps are not those of the {len(lf.views)} views of {lf.name}.")
        return {n: replace(maps.map(n), geometry=geometry) for n in range(len(lf.views))}
    one = maps.map if isinstance(maps, DepthResult) else maps
    u, v = one.position or lf.positions[lf.reference_index]
    if one.disparity.shape != lf.size:
        raise LightFieldError(
            f"the map must be {lf.size[0]} x {lf.size[1]} as the views of {lf.name} are, found {one.disparity.shape}."
        )
    return {lf.index_of(v, u): replace(one, position=(float(u), float(v)), geometry=geometry)}


def _points(lf: LightField, maps: dict[int, DisparityMap]) -> tuple[Float32Array, NDArray[np.uint8]]:
    pixels = len(maps) * lf.size[0] * lf.size[1]
    step = max(1, int(np.ceil(np.sqrt(pixels / POINTS))))
    clouds, problem = [], None
    for n, one in maps.items():
        try:
            clouds.append(point_cloud(one, image=_bytes(lf, n), least_confidence=_SURE, step=step))
        except LightFieldError as error:  # nothing of this view is sure
            problem = error
    if problem is not None and not clouds:
        raise problem
    colors = [cloud.colors for cloud in clouds if cloud.colors is not None]
    return np.concatenate([cloud.points for cloud in clouds]), np.concatenate(colors)


def _bytes(lf: LightField, index: int) -> NDArray[Any]:
    return lf.views[index] if lf.views.dtype == np.uint8 else quantised(lf.image(index), np.uint8)


def _unit(maps: dict[int, DisparityMap]) -> tuple[float, tuple[str, ...]]:
    """Choose the unit of depth pictures in metres, and say what a reader has to know of it."""
    depths = np.concatenate([depth[np.isfinite(depth)] for one in maps.values() if (depth := one.depth) is not None])
    if not depths.size:
        return _MILLIMETRE, ()
    deepest = float(np.percentile(depths, 100 - _LEFT_OUT))
    unit, notes = _MILLIMETRE, []
    if not _FEWEST * unit <= deepest <= _LARGEST * unit:
        unit = 10.0 ** math.ceil(math.log10(deepest / _LARGEST))
        notes.append(
            f"Depth pictures are in units of {unit:g} m, as millimetres do not fit the scene in 16 bits; nerfstudio "
            f"takes it as depth_unit_scale_factor={unit:g}."
        )
    beyond = float((depths > _LARGEST * unit).mean())
    if beyond > 0:
        notes.append(f"Depth pictures have 0 at {100 * beyond:.2g} % of the pixels, beyond {_LARGEST * unit:.4g} m.")
    return unit, tuple(notes)


def _whole_units(depth: NDArray[np.float32], unit: float) -> NDArray[np.uint16]:
    values = np.rint(depth.astype(np.float64) / unit)
    known = np.isfinite(values) & (values <= _LARGEST)
    return np.where(known, values, 0).astype(np.uint16)[..., None]
