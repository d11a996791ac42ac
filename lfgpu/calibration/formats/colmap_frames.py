"""Frames of COLMAP 3.12 and later: poses of a rig, with which the poses of its images have to agree."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from lfgpu.calibration.cameras import of_quaternion
from lfgpu.contract import Float64Array
from lfgpu.errors import LightFieldError
from lfgpu.io.texts import read_text

_IS_CAMERA = 0  # among COLMAP's kinds of sensors
_APART = 1e-3  # share of the extent of the cameras, and radians, by which two poses of an image may differ
_LARGEST_TEXT = 1 << 28  # bytes

Pose = tuple[float, ...]
"""Quaternion and translation, world to camera."""


def check_frames(folder: Path, images: Mapping[int, tuple[int, Pose, str]], rig: Mapping[int, Pose]) -> None:
    """Raise LightFieldError if frames put images elsewhere than their own poses do: one of the two files is stale.

    Parameters
    ----------
    folder
        The model.
    images
        Number of the camera, pose and name of each image by its number.
    rig
        Poses of the cameras of all rigs, rig to camera, by the number of the camera.
    """
    centres = {key: _centre(pose) for key, (_, pose, _) in images.items()}
    extent = float(np.ptp(np.array(list(centres.values())), axis=0).max()) if centres else 0.0
    for frame, number in _frames(folder):
        if number not in images or images[number][0] not in rig:
            continue
        key, own, name = images[number]
        turn, shift = _matrix(rig[key])
        outer, away = _matrix(frame)
        rotation, translation = turn @ outer, turn @ away + shift
        angle = float(np.linalg.norm(rotation - _matrix(own)[0])) / np.sqrt(2)
        apart = float(np.linalg.norm(-rotation.T @ translation - centres[number]))
        if angle > _APART or apart > _APART * max(extent, 1e-12):
            raise LightFieldError(
                f"images put {name} elsewhere than frames and rigs do (by {apart:.3g} units, {np.degrees(angle):.3g} "
                "degrees): one of these files is of an older model; write the model anew with colmap model_converter."
            )


def _frames(folder: Path) -> Iterator[tuple[Pose, int]]:
    """Yield the pose of the rig (world to rig) and the number of each image that was taken from there."""
    if (folder / "frames.bin").is_file():
        yield from _binary((folder / "frames.bin").read_bytes())
    elif (folder / "frames.txt").is_file():
        for line in read_text(folder / "frames.txt", largest=_LARGEST_TEXT).splitlines():
            parts = line.split()
            if len(parts) < 10 or line.startswith("#"):
                continue
            for at in range(10, 10 + 3 * int(parts[9]), 3):
                if parts[at] == "CAMERA":
                    yield tuple(map(float, parts[2:9])), int(parts[at + 2])


def _binary(data: bytes) -> Iterator[tuple[Pose, int]]:
    try:
        (count,), at = struct.unpack_from("<Q", data), 8
        for _ in range(count):
            _, _, *pose, sensors = struct.unpack_from("<II7dI", data, at)
            at += struct.calcsize("<II7dI")
            for _ in range(sensors):
                kind, _, number = struct.unpack_from("<iIQ", data, at)
                at += struct.calcsize("<iIQ")
                if kind == _IS_CAMERA:
                    yield tuple(pose), number
    except struct.error as error:
        raise ValueError("its frames end too early") from error


def _matrix(pose: Pose) -> tuple[Float64Array, Float64Array]:
    return of_quaternion(*pose[:4]), np.array(pose[4:], np.float64)


def _centre(pose: Pose) -> Float64Array:
    rotation, translation = _matrix(pose)
    return np.asarray(-rotation.T @ translation)
