"""Models of COLMAP: cameras and images, as text or binary. Its first pixel has its centre at (0.5, 0.5)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from lfgpu.calibration.cameras import Camera, of_quaternion
from lfgpu.errors import LightFieldError

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
            lenses = dict(_binary_cameras((folder / "cameras.bin").read_bytes()))
            poses = list(_binary_images((folder / "images.bin").read_bytes()))
        else:
            lenses = dict(_text_cameras((folder / "cameras.txt").read_text(encoding="utf-8")))
            poses = list(_text_images((folder / "images.txt").read_text(encoding="utf-8")))
        return sorted((_camera(lenses[key], q, t, name) for q, t, key, name in poses), key=lambda camera: camera.name)
    except LightFieldError as error:
        raise LightFieldError(f"{folder}: {error}") from error
    except (KeyError, ValueError, IndexError, struct.error) as error:
        raise LightFieldError(f"{folder} holds a damaged model of COLMAP ({type(error).__name__}: {error}).") from error


def _camera(lens: Lens, q: tuple[float, ...], t: tuple[float, ...], name: str) -> Camera:
    model, width, height, values = lens
    if model not in _MODELS:
        raise LightFieldError(f"the lens model {model} is not known; known are {', '.join(_MODELS)}.")
    _, count, places, lens_places = _MODELS[model]
    if len(values) != count:
        raise LightFieldError(f"{model} has {count} parameters, found {len(values)}.")
    fx, fy, cx, cy = (values[k] for k in places)
    return Camera(
        size=(height, width),
        focal_length=(fx, fy),
        principal_point=(cx - 0.5, cy - 0.5),
        distortion=tuple(values[k] if k >= 0 else 0.0 for k in lens_places),
        model="fisheye" if "FISHEYE" in model else "pinhole",
        rotation=of_quaternion(*q),
        translation=t,
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
        numbers = tuple(map(float, parts[1:8]))
        yield numbers[:4], numbers[4:], int(parts[8]), parts[9].strip()
        next(rows, "")  # its points


def _binary_cameras(data: bytes) -> Iterator[tuple[int, Lens]]:
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(count):
        key, model, width, height = struct.unpack_from("<iiQQ", data, at)
        at += 24
        name = _NUMBERED.get(model, f"number {model}")
        if name not in _MODELS:
            raise LightFieldError(f"the lens model {name} is not known; known are {', '.join(_MODELS)}.")
        values = struct.unpack_from(f"<{_MODELS[name][1]}d", data, at)
        at += 8 * len(values)
        yield key, (name, width, height, values)


def _binary_images(data: bytes) -> Iterator[Pose]:
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(count):
        _, *numbers, key = struct.unpack_from("<I7dI", data, at)
        at += 64
        end = data.index(b"\0", at)
        name = data[at:end].decode("utf-8", "replace")
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
        yield tuple(numbers[:4]), tuple(numbers[4:]), key, name
