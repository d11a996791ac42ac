"""Calibrations of OpenCV, as YAML or JSON: one node for each camera, or what its multi-view calibration writes.

A camera is K or camera_matrix, D, distortion_coefficients or dist_coeffs, R and T (world to camera; R may be a
rotation vector), image_width and image_height or image_size (width, height), and "fisheye: true" for that lens. They
are a list `cameras`, or entries of their own with their names. OpenCV's `multiview_calibration.py` writes Ks,
distortions, Rs, Ts, image_sizes, models and cam_ids for all cameras together.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.entries import camera_of, entries_of, numbers
from lfgpu.errors import LightFieldError

_MATRIX = ("K", "camera_matrix", "cameraMatrix", "intrinsics")
_LENS = ("D", "distortion_coefficients", "dist_coeffs", "distCoeffs", "distortion")
_TURN = ("R", "rotation", "rvec")
_SHIFT = ("T", "t", "translation", "tvec")


def opencv_cameras(path: Path, table: Any) -> list[Camera]:
    """Read the cameras of a calibration of OpenCV."""
    if not isinstance(table, Mapping):
        raise LightFieldError(f"{path} is no calibration: it must have entries with names.")
    if "Ks" in table:
        with entries_of(path):
            return _multiview(table)
    listed = table.get("cameras", table)
    if isinstance(listed, Mapping):
        listed = [{"name": name, **entry} for name, entry in listed.items() if isinstance(entry, Mapping)]
    if not isinstance(listed, list) or not listed:
        raise LightFieldError(f"{path} has no cameras; give a list `cameras`, or an entry for each.")
    found = []
    for index, entry in enumerate(listed):
        if not isinstance(entry, Mapping):
            raise LightFieldError(f"{path}: camera {index} must have entries with names.")
        name = str(entry.get("name", f"camera {index}"))
        with entries_of(path, name):
            found.append(_camera(entry, name))
    return found


def _multiview(table: Mapping[str, Any]) -> list[Camera]:
    matrices = numbers(table["Ks"], -1, 3, 3)
    count = len(matrices)
    if not count:
        raise ValueError("Ks is empty")
    turns = numbers(table["Rs"], count, -1)
    shifts = numbers(table["Ts"], count, 3)
    lenses = numbers(table["distortions"], count, -1)
    sizes = numbers(table["image_sizes"], count, 2)
    models = numbers(table.get("models", [0] * count), count)
    names = str(table.get("cam_ids", "")).split(",")
    names = names if len(names) == count else [f"camera {n}" for n in range(count)]
    return [
        camera_of(matrices[n], lenses[n], turns[n], shifts[n], sizes[n], bool(models[n]), names[n].strip())
        for n in range(count)
    ]


def _camera(entry: Mapping[str, Any], name: str) -> Camera:
    def one(keys: tuple[str, ...], default: Any = None) -> Any:
        found = next((entry[key] for key in keys if key in entry), default)
        if found is None:
            raise LightFieldError(f"{name} has no {keys[0]} ({' or '.join(keys[1:])}).")
        return found

    size = entry.get("image_size")
    if size is None:
        size = [one(("image_width", "image_size")), one(("image_height", "image_size"))]
    return camera_of(
        numbers(one(_MATRIX), 3, 3),
        numbers(one(_LENS, ()), -1),
        numbers(one(_TURN, np.eye(3)), -1),
        numbers(one(_SHIFT, np.zeros(3)), 3),
        numbers(size, 2),
        bool(entry.get("fisheye", False)),
        name,
    )


_IS_FISHEYE = {"radtan": False, "equidistant": True, "none": False}


def kalibr_cameras(path: Path, table: Mapping[Any, Any]) -> list[Camera]:
    """Read the cameras of a camchain; the first one's frame is the world."""
    names = [name for name in table if isinstance(name, str) and name.startswith("cam")]
    names.sort(key=lambda name: (len(name), name))
    found: list[Camera] = []
    pose = np.eye(4)
    for name in names:
        with entries_of(path, name):
            entry = table[name]
            if entry["camera_model"] != "pinhole" or entry["distortion_model"] not in _IS_FISHEYE:
                raise LightFieldError(
                    f"{name} is {entry['camera_model']} with {entry['distortion_model']}; lenses that are known are "
                    "pinhole with radtan, equidistant or none."
                )
            if found:
                with np.errstate(all="ignore"):  # a camera is asked for numbers that are finite
                    pose = numbers(entry["T_cn_cnm1"], 4, 4) @ pose
            fx, fy, cx, cy = numbers(entry["intrinsics"], 4)
            matrix, lens = np.array([[fx, 0, cx], [0, fy, cy]]), numbers(entry.get("distortion_coeffs", ()), -1)
            size, is_fisheye = numbers(entry["resolution"], 2), _IS_FISHEYE[entry["distortion_model"]]
            found.append(camera_of(matrix, lens, pose[:3, :3], pose[:3, 3], size, is_fisheye, name))
    if not found:
        raise LightFieldError(f"{path} has no cam0, cam1, ...; give a camchain of Kalibr.")
    return found


def is_kalibr(table: object) -> bool:
    """Tell whether a YAML file holds a camchain."""
    return isinstance(table, Mapping) and any(
        isinstance(entry, Mapping) and "camera_model" in entry and "intrinsics" in entry for entry in table.values()
    )
