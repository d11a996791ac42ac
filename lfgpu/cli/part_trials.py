"""Trials of optional parts for `lfgpu doctor`: a small file of each format is written and read again."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfgpu.data.lightfield import LightField

Difference = float
"""The largest difference between what was written and what was read."""


def _exr(lf: LightField, place: Path) -> Difference:
    from lfgpu.data.result import DisparityMap
    from lfgpu.io import read_map, save

    disparity = lf.image(0)[..., 0]
    save(DisparityMap(disparity), place / "map.exr")
    return _apart(read_map(place / "map.exr"), disparity)


def _hdf5(lf: LightField, place: Path) -> Difference:
    import h5py

    from lfgpu.io import read

    views = lf.views.reshape(*(lf.grid_shape or ()), *lf.views.shape[1:])
    with h5py.File(place / "views.h5", "w") as file:
        file["LF"] = views
    return _apart(read(place / "views.h5").views, lf.views)


def _tiff(lf: LightField, place: Path) -> Difference:
    from lfgpu.io.frames import write_image
    from lfgpu.io.images import read_image

    write_image(lf.image(0), place / "view.tif")
    return _apart(read_image(place / "view.tif")[0], lf.image(0))


def _png(lf: LightField, place: Path) -> Difference:
    from lfgpu.io.images import read_image
    from lfgpu.io.png import write_png

    write_png(place / "view.png", lf.views[0])
    return _apart(read_image(place / "view.png")[0], lf.views[0])


def _video(lf: LightField, place: Path) -> Difference:
    from lfgpu.io import read
    from lfgpu.io.frames import write_frames

    write_frames((lf.image(index) for index in range(3)), place / "film.mp4")
    found = read(place / "film.mp4").views / 255
    return max(0.0, float(abs(found - lf.views[:3] * lf.scale).mean()) - _LOSS)


def _calibration(lf: LightField, place: Path) -> Difference:
    from lfgpu.calibration.formats.entries import read_yaml

    (place / "cameras.yml").write_text("%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 1\n   data: [ 1., 2.5 ]\n")
    return _apart(read_yaml(place / "cameras.yml")["K"]["data"], [1, 2.5])


def _viewer(lf: LightField, place: Path) -> Difference:
    from urllib.request import urlopen

    from lfgpu.viewer import Viewer

    _imported("viser")
    with Viewer(port=0) as viewer, urlopen(viewer.url, timeout=_PATIENCE) as answer:
        return float(answer.status != 200)


def _imported(*modules: str) -> Difference:
    for module in modules:
        importlib.import_module(module)
    return 0.0


def _apart(found: Any, expected: NDArray[Any] | list[float]) -> Difference:
    import numpy as np

    return float(np.abs(np.asarray(found, float) - np.asarray(expected, float)).max())


_LOSS = 0.05  # intensity, on average: films are compressed
_PATIENCE = 60  # seconds

TRIALS: dict[str, Callable[[LightField, Path], Difference]] = {
    "batch": lambda *_: _imported("distributed", "cryptography.x509"),
    "calibration": _calibration,
    "exr": _exr,
    "hdf5": _hdf5,
    "opencv": lambda *_: _imported("cv2"),
    "png": _png,
    "tiff": _tiff,
    "video": _video,
    "viewer": _viewer,
    "xarray": lambda *_: _imported("xarray"),
}
"""The trial of each part but those that are backends, of a light field in a folder; it may raise anything."""
