"""Calibrations of OpenCV, as YAML or JSON: one node for each camera, or what its multi-view calibration writes.

A camera is K or camera_matrix, D, distortion_coefficients or dist_coeffs, R and T (world to camera; R may be a
rotation vector), image_width and image_height or image_size (width, height), and "fisheye: true" for that lens. They
are a list `cameras`, or entries of their own with their names. OpenCV's `multiview_calibration.py` writes Ks,
distortions, Rs, Ts, image_sizes, models and cam_ids for all cameras together.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera, turned
from lfgpu.contract import Float64Array
from lfgpu.errors import LightFieldError

_MATRIX = ("K", "camera_matrix", "cameraMatrix", "intrinsics")
_LENS = ("D", "distortion_coefficients", "dist_coeffs", "distCoeffs", "distortion")
_TURN = ("R", "rotation", "rvec")
_SHIFT = ("T", "t", "translation", "tvec")


def yaml_or_json(path: Path) -> Any:
    """What a YAML or JSON file holds, matrices of OpenCV as arrays; LightFieldError if it is damaged."""
    text = path.read_text(encoding="utf-8", errors="replace")
    if path.suffix.lower() == ".json":
        try:
            return json.loads(text, object_hook=_json_matrix)
        except json.JSONDecodeError as error:
            raise LightFieldError(f"{path} is not valid JSON: {error}.") from error
    try:
        import yaml
    except ImportError:
        raise LightFieldError(f"{path} is YAML, which needs PyYAML: pip install 'lfgpu[calibration]'.") from None

    class Loader(yaml.SafeLoader):  # type: ignore[misc, unused-ignore]
        """YAML with OpenCV's matrices."""

    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(
            f"tag:yaml.org,2002:{tag}", lambda loader, node: _matrix(loader.construct_mapping(node, True))
        )
    lines = text.splitlines()
    if lines and lines[0].startswith("%YAML"):  # OpenCV writes "%YAML:1.0", which YAML does not know
        lines[0] = ""
    try:
        return yaml.load("\n".join(lines), Loader)  # a safe loader: it makes plain values only
    except (yaml.YAMLError, ValueError) as error:
        raise LightFieldError(f"{path} is not valid YAML: {' '.join(str(error).split())}.") from error


def _matrix(node: Mapping[str, Any]) -> Float64Array:
    shape = node.get("sizes") or [node["rows"], node["cols"]]
    values = np.array(node["data"], np.float64)
    channels = values.size // max(1, int(np.prod(shape)))  # "3d" is a matrix of three numbers an element
    return values.reshape([*shape, channels] if channels > 1 else shape)


def _json_matrix(node: dict[str, Any]) -> Any:
    return _matrix(node) if str(node.get("type_id", "")).startswith("opencv-") else node


def read_opencv(path: Path) -> list[Camera]:
    """The cameras of a calibration of OpenCV."""
    table = yaml_or_json(path)
    if not isinstance(table, Mapping):
        raise LightFieldError(f"{path} is no calibration: it must have entries with names.")
    if "Ks" in table:
        return _multiview(path, table)
    listed = table.get("cameras", table)
    if isinstance(listed, Mapping):
        listed = [{"name": name, **entry} for name, entry in listed.items() if isinstance(entry, Mapping)]
    if not isinstance(listed, list) or not listed:
        raise LightFieldError(f"{path} has no cameras; give a list `cameras`, or an entry for each.")
    return [_camera(path, index, entry) for index, entry in enumerate(listed)]


def _multiview(path: Path, table: Mapping[str, Any]) -> list[Camera]:
    try:
        matrices, turns = np.asarray(table["Ks"]), np.asarray(table["Rs"])
        count = len(matrices)
        turns = turns.reshape(count, -1)
        shifts = np.asarray(table["Ts"]).reshape(count, 3)
        lenses = np.asarray(table["distortions"]).reshape(count, -1)
        sizes = np.asarray(table["image_sizes"], int).reshape(count, 2)
        models = np.asarray(table.get("models", np.zeros(count)), int).ravel()
        names = str(table.get("cam_ids", "")).split(",")
        names = names if len(names) == count else [f"camera {n}" for n in range(count)]
        return [
            _made(matrices[n], lenses[n], turns[n], shifts[n], tuple(sizes[n]), bool(models[n]), names[n].strip())
            for n in range(count)
        ]
    except (KeyError, ValueError, TypeError) as error:
        raise LightFieldError(f"{path}: the cameras' entries do not fit together ({error}).") from error


def _camera(path: Path, index: int, entry: Any) -> Camera:
    if not isinstance(entry, Mapping):
        raise LightFieldError(f"{path}: camera {index} must have entries with names.")
    name = str(entry.get("name", f"camera {index}"))

    def one(keys: tuple[str, ...], default: Any = None) -> Any:
        for key in keys:
            if key in entry:
                return entry[key]
        if default is None:
            raise LightFieldError(f"{path}: {name} has no {keys[0]} ({' or '.join(keys[1:])}).")
        return default

    size: Any = entry.get("image_size") or (entry.get("image_width"), entry.get("image_height"))
    try:
        width, height = (int(side) for side in np.ravel(size))
        return _made(
            np.asarray(one(_MATRIX), np.float64),
            np.asarray(one(_LENS, ()), np.float64),
            np.asarray(one(_TURN, np.eye(3)), np.float64),
            np.asarray(one(_SHIFT, np.zeros(3)), np.float64),
            (width, height),
            bool(entry.get("fisheye", False)),
            name,
        )
    except LightFieldError as error:
        raise LightFieldError(f"{path}: {error}") from error
    except (TypeError, ValueError) as error:
        raise LightFieldError(f"{path}: {name} has wrong entries: {error}.") from error


def _made(
    matrix: Float64Array,
    lens: Float64Array,
    turn: Float64Array,
    shift: Float64Array,
    size: Any,
    fisheye: bool,
    name: str,
) -> Camera:
    k = np.asarray(matrix, np.float64).reshape(3, 3)
    coefficients = [float(value) for value in np.ravel(lens)]
    while len(coefficients) > (4 if fisheye else 8) and coefficients[-1] == 0:
        coefficients.pop()  # OpenCV's thin prisms and tilts, not used
    return Camera(
        size=(int(size[1]), int(size[0])),
        focal_length=(float(k[0, 0]), float(k[1, 1])),
        principal_point=(float(k[0, 2]), float(k[1, 2])),
        distortion=tuple(coefficients) if any(coefficients) else (),
        model="fisheye" if fisheye else "pinhole",
        rotation=turned(turn) if turn.size == 3 else np.reshape(turn, (3, 3)),
        translation=np.ravel(shift),
        name=name,
    )
