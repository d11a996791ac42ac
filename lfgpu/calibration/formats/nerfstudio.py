"""transforms.json of nerfstudio and instant-ngp: poses from camera to world, y up and z backwards.

The first pixel has its centre at (0.5, 0.5).
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.entries import entries_of, numbers, whole
from lfgpu.errors import LightFieldError
from lfgpu.io.folders import IMAGE_SUFFIXES
from lfgpu.io.images import image_size

_MILLIMETRE = 1e-3
_LENS = {"pinhole": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4")}


def nerfstudio_cameras(path: Path, table: Mapping[str, Any]) -> list[Camera]:
    """Read the cameras of all frames, in their order."""
    with entries_of(path):
        frames = table["frames"]
        if not isinstance(frames, list) or not all(isinstance(frame, Mapping) for frame in frames):
            raise ValueError("frames must be a list of tables")
        sized = "w" in table and "h" in table
        return [_camera({**table, **(frame if sized else _with_size(path, frame))}) for frame in frames]


def _with_size(path: Path, frame: Mapping[str, Any]) -> Mapping[str, Any]:
    """Add the size of its picture to a frame: NeRF's own form has camera_angle_x alone, and names without suffix."""
    if "w" in frame and "h" in frame:
        return frame
    name = str(frame["file_path"])
    for suffix in ("", *sorted(IMAGE_SUFFIXES)):
        file = path.parent / f"{name}{suffix}"
        if file.is_file() and (size := image_size(file)) is not None:
            return {**frame, "file_path": f"{name}{suffix}", "h": size[0], "w": size[1]}
    raise LightFieldError(f"it has no w and h, and {path.parent / name} is no picture whose size could be taken.")


def _camera(entry: Mapping[str, Any]) -> Camera:
    def number(key: str, default: float | None = None) -> float:
        return float(numbers(entry[key] if default is None else entry.get(key, default), 1)[0])

    width, height = whole(entry["w"]), whole(entry["h"])
    if "fl_x" in entry:
        fx = number("fl_x")
    else:
        half = number("camera_angle_x") / 2
        if not 0 < half < math.pi / 2:
            raise ValueError("camera_angle_x must be an angle between 0 and pi")
        fx = width / 2 / math.tan(half)
    model = "fisheye" if "FISHEYE" in str(entry.get("camera_model", "")) else "pinhole"
    lens = tuple(number(name, 0.0) for name in _LENS[model])
    pose = numbers(entry["transform_matrix"], -1, 4)[:3]
    if len(pose) != 3:
        raise ValueError("transform_matrix must have 3 or 4 rows of 4 numbers")
    rotation = (pose[:, :3] * (1, -1, -1)).T
    return Camera(
        size=(height, width),
        focal_length=(fx, number("fl_y", fx)),
        principal_point=(number("cx", width / 2) - 0.5, number("cy", height / 2) - 0.5),
        distortion=lens if any(lens) else (),
        model=model,
        rotation=rotation,
        translation=-rotation @ pose[:, 3],
        name=str(entry["file_path"]),
    )


def write_nerfstudio(
    path: Path,
    cameras: Sequence[Camera],
    *,
    files: Sequence[Mapping[str, str]],
    points: str | None = None,
    depth_unit: float = _MILLIMETRE,
) -> None:
    """Write a transforms.json; `files` has the "file_path", "depth_file_path" and "mask_path" of each camera."""
    frames = []
    for camera, named in zip(cameras, files, strict=True):
        height, width = camera.size
        pose = np.eye(4)
        pose[:3, :3] = np.asarray(camera.rotation).T * (1, -1, -1)
        pose[:3, 3] = camera.centre
        (fx, fy), (cx, cy) = camera.focal_length, camera.principal_point
        lens = dict(zip(_LENS[camera.model], camera.distortion, strict=False))
        frames.append(
            {
                **named,
                "w": width,
                "h": height,
                "fl_x": fx,
                "fl_y": fy,
                "cx": cx + 0.5,
                "cy": cy + 0.5,
                **lens,
                "transform_matrix": pose.tolist(),
            }
        )
    model = "OPENCV_FISHEYE" if cameras[0].model == "fisheye" else "OPENCV"
    table: dict[str, Any] = {"camera_model": model, **({} if points is None else {"ply_file_path": points})}
    if depth_unit != _MILLIMETRE:
        table["depth_unit_scale_factor"] = depth_unit
    table["frames"] = frames
    path.write_text(json.dumps(table, indent=1, allow_nan=False), encoding="utf-8")
