"""Models of COLMAP: cameras and images, as text or binary. Its first pixel has its centre at (0.5, 0.5)."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from lfgpu.calibration.cameras import Camera, of_quaternion
from lfgpu.calibration.formats.entries import numbers
from lfgpu.errors import LightFieldError
from lfgpu.io.texts import read_text

_MODELS = {  # number, count of parameters, indices of fx, fy, cx, cy, then those of the distortion; -1 is 0
    "SIMPLE_PINHOLE": (0, 3, (0, 0, 1, 2), ()),
    "PINHOLE": (1, 4, (0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": (2, 4, (0, 0, 1, 2), (3, -1, -1, -1)),
    "RADIAL": (3, 5, (0, 0, 1, 2), (3, 4, -1, -1)),
    "OPENCV": (4, 8, (0, 1, 2, 3), (4, 5, 6, 7)),
    "OPENCV_FISHEYE": (5, 8, (0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": (6, 12, (0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
    "SIMPLE_RADIAL_FISHEYE": (8, 4, (0, 0, 1, 2), (3, -1, -1, -1)),
    "RADIAL_FISHEYE": (9, 5, (0, 0, 1, 2), (3, 4, -1, -1)),
}
_NUMBERED = {model[0]: name for name, model in _MODELS.items()}

_LARGEST_TEXT = 1 << 30  # bytes: the points that images show stand in it, too
_LONGEST_NAME = 4096  # bytes

Lens = tuple[str, int, int, tuple[float, ...]]
Pose = tuple[tuple[float, ...], tuple[float, ...], int, str]


def holds_colmap(folder: Path) -> bool:
    """Whether a folder holds a model."""
    return any(
        (folder / f"cameras{suffix}").is_file() and (folder / f"images{suffix}").is_file()
        for suffix in (".bin", ".txt")
    )


def read_colmap(folder: Path) -> list[Camera]:
    """The cameras of all images of a model, in the order of their names."""
    try:
        if (folder / "cameras.bin").is_file():
            with (folder / "cameras.bin").open("rb") as file:
                lenses = dict(_binary_cameras(file))
            with (folder / "images.bin").open("rb") as file:
                poses = list(_binary_images(file))
        else:
            lenses = dict(_text_cameras(read_text(folder / "cameras.txt")))
            poses = list(_text_images(read_text(folder / "images.txt", largest=_LARGEST_TEXT)))
        if lost := sorted({key for _, _, key, _ in poses} - set(lenses)):
            raise LightFieldError(f"images name camera {lost[0]}, which is not among the cameras.")
        return sorted((_camera(lenses[key], q, t, name) for q, t, key, name in poses), key=lambda camera: camera.name)
    except OSError as error:
        raise LightFieldError(f"{folder} cannot be read: {error.strerror or error}.") from error
    except LightFieldError as error:
        raise LightFieldError(f"{folder}: {error}") from error
    except (ValueError, IndexError) as error:
        raise LightFieldError(f"{folder} holds a damaged model of COLMAP: {error}.") from error


def _camera(lens: Lens, q: tuple[float, ...], t: tuple[float, ...], name: str) -> Camera:
    model, width, height, values = lens
    if model not in _MODELS:
        raise LightFieldError(f"the lens model {model} is not known; known are {', '.join(_MODELS)}.")
    _, count, places, lens_places = _MODELS[model]
    if len(values) != count:
        raise LightFieldError(f"{model} has {count} parameters, found {len(values)}.")
    values = tuple(numbers(values, count).tolist())
    fx, fy, cx, cy = (values[k] for k in places)
    return Camera(
        size=(height, width),
        focal_length=(fx, fy),
        principal_point=(cx - 0.5, cy - 0.5),
        distortion=tuple(values[k] if k >= 0 else 0.0 for k in lens_places),
        model="fisheye" if "FISHEYE" in model else "pinhole",
        rotation=of_quaternion(*numbers(q, 4).tolist()),
        translation=numbers(t, 3),
        name=name,
    )


def _rows(text: str) -> Iterator[str]:
    return (line for line in text.splitlines() if not line.startswith("#"))


def _text_cameras(text: str) -> Iterator[tuple[int, Lens]]:
    for line in _rows(text):
        if parts := line.split():
            yield int(parts[0]), (parts[1], int(parts[2]), int(parts[3]), tuple(map(float, parts[4:])))


def _text_images(text: str) -> Iterator[Pose]:
    rows = _rows(text)
    for line in rows:
        if not line.strip():
            continue
        parts = line.split(maxsplit=9)
        values = tuple(map(float, parts[1:8]))
        yield values[:4], values[4:], int(parts[8]), parts[9].strip()
        next(rows, "")  # its points


def _binary_cameras(file: BinaryIO) -> Iterator[tuple[int, Lens]]:
    (count,) = _unpacked(file, "<Q")
    for _ in range(count):
        key, model, width, height = _unpacked(file, "<iiQQ")
        name = _NUMBERED.get(model, f"number {model}")
        if name not in _MODELS:
            raise LightFieldError(f"the lens model {name} is not known; known are {', '.join(_MODELS)}.")
        yield key, (name, width, height, _unpacked(file, f"<{_MODELS[name][1]}d"))


def _binary_images(file: BinaryIO) -> Iterator[Pose]:
    (count,) = _unpacked(file, "<Q")
    for _ in range(count):
        _, *values, key = _unpacked(file, "<I7dI")
        name = bytearray()
        while (letter := _unpacked(file, "<c")[0]) != b"\0":
            name += letter
            if len(name) > _LONGEST_NAME:
                raise ValueError("the name of an image does not end")
        (points,) = _unpacked(file, "<Q")
        if 24 * points > os.fstat(file.fileno()).st_size - file.tell():
            raise ValueError("it ends too early")
        file.seek(24 * points, os.SEEK_CUR)
        yield tuple(values[:4]), tuple(values[4:]), key, name.decode("utf-8", "replace")


def _unpacked(file: BinaryIO, form: str) -> tuple[Any, ...]:
    data = file.read(struct.calcsize(form))
    if len(data) < struct.calcsize(form):
        raise ValueError("it ends too early")
    return struct.unpack(form, data)
