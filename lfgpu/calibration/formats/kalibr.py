"""camchain.yaml of Kalibr: a chain of cameras, each relative to the one before it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.entries import entries_of, numbers, whole
from lfgpu.errors import LightFieldError

_LENSES = {"radtan": "pinhole", "equidistant": "fisheye", "none": "pinhole"}


def kalibr_cameras(path: Path, table: Mapping[Any, Any]) -> list[Camera]:
    """Read the cameras of a camchain; the first one's frame is the world."""
    names = [name for name in table if isinstance(name, str) and name.startswith("cam")]
    names.sort(key=lambda name: (len(name), name))
    found: list[Camera] = []
    pose = np.eye(4)
    for name in names:
        with entries_of(path, name):
            entry = table[name]
            if entry["camera_model"] != "pinhole" or entry["distortion_model"] not in _LENSES:
                raise LightFieldError(
                    f"{name} is {entry['camera_model']} with {entry['distortion_model']}; lenses that are known are "
                    "pinhole with radtan, equidistant or none."
                )
            if found:
                with np.errstate(all="ignore"):  # a camera is asked for numbers that are finite
                    pose = numbers(entry["T_cn_cnm1"], 4, 4) @ pose
            fx, fy, cx, cy = numbers(entry["intrinsics"], 4).tolist()
            width, height = (whole(side) for side in numbers(entry["resolution"], 2))
            lens = tuple(numbers(entry.get("distortion_coeffs", ()), -1).tolist())
            found.append(
                Camera(
                    size=(height, width),
                    focal_length=(fx, fy),
                    principal_point=(cx, cy),
                    distortion=lens if any(lens) else (),
                    model=_LENSES[entry["distortion_model"]],
                    rotation=pose[:3, :3],
                    translation=pose[:3, 3],
                    name=name,
                )
            )
    if not found:
        raise LightFieldError(f"{path} has no cam0, cam1, ...; give a camchain of Kalibr.")
    return found


def is_kalibr(table: object) -> bool:
    """Tell whether a YAML file holds a camchain."""
    return isinstance(table, Mapping) and any(
        isinstance(entry, Mapping) and "camera_model" in entry and "intrinsics" in entry for entry in table.values()
    )
