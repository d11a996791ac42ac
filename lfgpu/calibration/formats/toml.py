"""cameras.toml: calibrated cameras in lfgpu's own words.

[[cameras]]
name = "left.png"                 # the file of its picture
size = [480, 640]                 # height, width in pixels
focal_length = [500.0, 500.0]     # fx, fy in pixels
principal_point = [319.5, 239.5]  # cx, cy in pixels; the centre of the first pixel is (0, 0)
model = "pinhole"                 # or "fisheye"
distortion = [-0.2, 0.1, 0.0, 0.0]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]   # world to camera
translation = [0.1, 0.0, 0.0]     # world to camera
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.entries import entries_of, numbers, whole
from lfgpu.errors import LightFieldError
from lfgpu.io import atomic_write
from lfgpu.io.texts import read_json_or_toml, to_toml

_KNOWN = {"size", "focal_length", "principal_point", "rotation", "translation", "name", "model", "distortion"}


def read_toml(path: Path) -> list[Camera]:
    """Read the cameras of a cameras.toml; LightFieldError if it is none."""
    listed = read_json_or_toml(path).get("cameras")
    if not isinstance(listed, list) or not listed:
        raise LightFieldError(f"{path} has no cameras; list them as [[cameras]], one table each.")
    found = []
    for index, entry in enumerate(listed):
        with entries_of(path, f"cameras[{index}]"):
            found.append(_camera(index, entry))
    return found


def _camera(index: int, entry: Any) -> Camera:
    if not isinstance(entry, Mapping):
        raise ValueError("a table was expected")
    if unknown := sorted(set(entry) - _KNOWN):
        raise LightFieldError(
            f"cameras[{index}] has an unknown entry {unknown[0]!r}; known are {', '.join(sorted(_KNOWN))}."
        )
    height, width = numbers(entry["size"], 2)
    return Camera(
        size=(whole(height), whole(width)),
        focal_length=tuple(numbers(entry["focal_length"], 2).tolist()),
        principal_point=tuple(numbers(entry["principal_point"], 2).tolist()),
        distortion=tuple(numbers(entry.get("distortion", ()), -1).tolist()),
        model=str(entry.get("model", "pinhole")),
        rotation=numbers(entry["rotation"], 3, 3),
        translation=numbers(entry["translation"], 3),
        name=str(entry.get("name", f"camera {index}")),
    )


def write_cameras(cameras: Sequence[Camera], path: Path) -> None:
    """Write a cameras.toml, whole or not at all."""
    tables = [
        {
            "name": camera.name,
            "size": list(camera.size),
            "focal_length": _numbers(camera.focal_length),
            "principal_point": _numbers(camera.principal_point),
            "model": camera.model,
            "distortion": _numbers(camera.distortion),
            "rotation": _numbers(camera.rotation),
            "translation": _numbers(camera.translation),
        }
        for camera in cameras
    ]
    with atomic_write(path) as temporary:
        temporary.write_text(to_toml({"cameras": tables}), encoding="utf-8")


def _numbers(values: Any) -> Any:
    return np.asarray(values, np.float64).tolist()
