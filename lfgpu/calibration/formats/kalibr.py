"""camchain.yaml of Kalibr: a chain of cameras, each relative to the one before it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.opencv import yaml_or_json
from lfgpu.errors import LightFieldError

_LENSES = {"radtan": "pinhole", "equidistant": "fisheye", "none": "pinhole"}


def read_kalibr(path: Path) -> list[Camera]:
    """The cameras of a camchain; the first one's frame is the world."""
    table = yaml_or_json(path)
    names = sorted((name for name in table if name.startswith("cam")), key=lambda name: (len(name), name))
    found: list[Camera] = []
    pose = np.eye(4)
    for name in names:
        entry = table[name]
        try:
            if entry["camera_model"] != "pinhole" or entry["distortion_model"] not in _LENSES:
                raise LightFieldError(
                    f"{path}: {name} is {entry['camera_model']} with {entry['distortion_model']}; lenses that are "
                    "known are pinhole with radtan, equidistant or none."
                )
            if found:
                pose = np.array(entry["T_cn_cnm1"], np.float64).reshape(4, 4) @ pose
            fx, fy, cx, cy = (float(value) for value in entry["intrinsics"])
            width, height = (int(side) for side in entry["resolution"])
            lens = tuple(float(value) for value in entry.get("distortion_coeffs", ()))
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
        except KeyError as error:
            raise LightFieldError(f"{path}: {name} has no {error.args[0]}.") from error
        except (TypeError, ValueError) as error:
            if isinstance(error, LightFieldError):
                raise
            raise LightFieldError(f"{path}: {name} has wrong entries: {error}.") from error
    if not found:
        raise LightFieldError(f"{path} has no cam0, cam1, ...")
    return found


def is_kalibr(table: object) -> bool:
    """Whether a YAML file holds a camchain."""
    return isinstance(table, Mapping) and any(
        isinstance(entry, Mapping) and "camera_model" in entry and "intrinsics" in entry for entry in table.values()
    )
