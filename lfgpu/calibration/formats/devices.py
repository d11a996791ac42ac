"""Calibrations of devices and data sets: Google's models.json, depthai's of OAK cameras, stereo pairs, LLFF's poses.

Google (DeepView, Spaces, immersive video): a camera is focal_length, pixel_aspect_ratio, principal_point, orientation
(rotation vector, world to camera), position, and in some files radial_distortion and projection_type. The first pixel
has its centre at (0.5, 0.5). A list of lists has the cameras of each place of the rig.

depthai: cameraData is a list of (socket, camera); a camera's extrinsics lead to the camera of another socket, in
centimetres.

OpenCV's stereo calibration: M1, D1, M2, D2 (or cameraMatrix1, ...) and R, T from the first to the second camera.

LLFF: poses_bounds.npy has a row for each picture, ordered by their names. A row is 3 x 5 numbers and the nearest and
farthest depth. Columns are the camera's axes down, right and backwards in the world, its centre, and (height, width,
focal length).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera, turned
from lfgpu.calibration.formats.entries import camera_of, entries_of, numbers, whole
from lfgpu.contract import Float64Array
from lfgpu.errors import LightFieldError
from lfgpu.io.numpy_file import load_arrays

_CENTIMETRE = 0.01
_PAIRS = (("M", "D"), ("K", "D"), ("cameraMatrix", "distCoeffs"), ("camera_matrix_", "dist_coeffs_"))
_SIZES = ("image_size", "imageSize", "size")


def is_google(table: object) -> bool:
    """Tell whether a JSON file is a models.json."""
    while isinstance(table, list) and table:
        table = table[0]
    return isinstance(table, Mapping) and {"position", "orientation", "focal_length"} <= set(table)


def is_depthai(table: object) -> bool:
    """Tell whether a JSON file is a calibration of depthai."""
    return isinstance(table, Mapping) and isinstance(table.get("cameraData"), list)


def is_stereo(table: object) -> bool:
    """Tell whether a file holds a pair of OpenCV's stereo calibration."""
    return isinstance(table, Mapping) and any({f"{m}1", f"{m}2", "R", "T"} <= set(table) for m, _ in _PAIRS)


def google_cameras(table: list[Any]) -> list[Camera]:
    """Read the cameras of a models.json, at all places of the rig."""
    flat = [entry for part in table for entry in (part if isinstance(part, list) else [part])]
    return [_google(index, entry) for index, entry in enumerate(flat)]


def _google(index: int, entry: Mapping[str, Any]) -> Camera:
    fx = float(numbers(entry["focal_length"], 1)[0])
    cx, cy = (numbers(entry["principal_point"], 2) - 0.5).tolist()
    rotation = turned(numbers(entry["orientation"], 3))
    fisheye = entry.get("projection_type") == "fisheye"
    radial = numbers(entry.get("radial_distortion", ()), -1).tolist()
    lens = (*radial, *(0.0,) * 4)[:4] if fisheye else (*(*radial, 0.0, 0.0)[:2], 0.0, 0.0)
    return Camera(
        size=(whole(entry["height"]), whole(entry["width"])),
        focal_length=(fx, fx * float(numbers(entry.get("pixel_aspect_ratio", 1.0), 1)[0])),
        principal_point=(cx, cy),
        distortion=lens if any(lens) else (),
        model="fisheye" if fisheye else "pinhole",
        rotation=rotation,
        translation=-rotation @ numbers(entry["position"], 3),
        name=str(entry.get("relative_path", entry.get("name", f"camera {index}"))),
    )


def depthai_cameras(table: Mapping[str, Any]) -> list[Camera]:
    """Read the cameras of a calibration of depthai, in metres; the one that all others lead to is the world."""
    entries = {whole(socket): entry for socket, entry in table["cameraData"]}
    return [_depthai(socket, entries) for socket in sorted(entries)]


def _depthai(socket: int, entries: Mapping[int, Any]) -> Camera:
    entry = entries[socket]
    pose, at, seen = np.eye(4), socket, {socket}
    while (next_one := whole(entries[at]["extrinsics"]["toCameraSocket"])) >= 0:
        if next_one in seen or next_one not in entries:
            raise LightFieldError(f"the extrinsics of the camera at socket {socket} lead to no camera.")
        pose = _extrinsics(entries[at]["extrinsics"]) @ pose
        at = next_one
        seen.add(at)
    to_camera = np.asarray(np.linalg.inv(pose), np.float64)
    fisheye = entry.get("cameraType") == 1
    return camera_of(
        numbers(entry["intrinsicMatrix"], 3, 3),
        numbers(entry.get("distortionCoeff", ()), -1)[: 4 if fisheye else 8],
        to_camera[:3, :3],
        to_camera[:3, 3],
        numbers([entry["width"], entry["height"]], 2),
        fisheye,
        f"camera {socket}",
    )


def _extrinsics(entry: Mapping[str, Any]) -> Float64Array:
    pose = np.eye(4)
    pose[:3, :3] = numbers(entry["rotationMatrix"], 3, 3)
    shift = entry["translation"]
    pose[:3, 3] = numbers([shift["x"], shift["y"], shift["z"]], 3) * _CENTIMETRE
    return pose


def stereo_cameras(table: Mapping[str, Any]) -> list[Camera]:
    """Read the two cameras of a stereo calibration; the first one's frame is the world."""
    matrix, lens = next(pair for pair in _PAIRS if {f"{pair[0]}1", f"{pair[0]}2"} <= set(table))
    size = next((table[key] for key in _SIZES if key in table), None)
    if size is None:
        if not {"image_width", "image_height"} <= set(table):
            raise LightFieldError("it has no size of the pictures: add image_width and image_height.")
        size = [table["image_width"], table["image_height"]]
    poses = [(np.eye(3), np.zeros(3)), (numbers(table["R"], -1), numbers(table["T"], 3))]
    return [
        camera_of(
            numbers(table[f"{matrix}{n}"], 3, 3),
            numbers(table.get(f"{lens}{n}", ()), -1),
            turn,
            shift,
            numbers(size, 2),
            False,
            f"camera {n}",
        )
        for n, (turn, shift) in enumerate(poses, 1)
    ]


def read_llff(path: Path) -> tuple[list[Camera], tuple[float, float]]:
    """Read the cameras of a poses_bounds.npy, and the nearest and farthest depth of the scene."""
    rows = load_arrays(path, ("poses",))["poses"]
    if rows.ndim != 2 or rows.shape[1] != 17 or not len(rows):
        raise LightFieldError(f"{path} must hold 17 numbers for each picture, found shape {rows.shape}.")
    cameras = []
    with entries_of(path):
        for index, row in enumerate(rows := numbers(rows)):
            down, right, back, centre, (height, width, focal) = row[:15].reshape(3, 5).T
            rotation = np.stack([right, down, -back])
            cameras.append(
                Camera(
                    size=(round(height), round(width)),
                    focal_length=(float(focal), float(focal)),
                    principal_point=((width - 1) / 2, (height - 1) / 2),
                    rotation=rotation,
                    translation=-rotation @ centre,
                    name=f"picture {index}",
                )
            )
    return cameras, (float(rows[:, 15].min()), float(rows[:, 16].max()))
