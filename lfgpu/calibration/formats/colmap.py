"""Models of COLMAP: cameras, images, and since 3.12 rigs and their frames, as text or binary.

Its first pixel has its centre at (0.5, 0.5).
"""

import os
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfgpu.calibration.cameras import Camera, of_quaternion
from lfgpu.calibration.formats.entries import numbers
from lfgpu.contract import Float64Array
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

T = TypeVar("T")

_LARGEST_TABLE = 1 << 24  # bytes of a text of cameras or rigs
_LARGEST_TEXT = 1 << 30  # bytes of others: the points that images show stand in it, too
_LONGEST_NAME = 4096  # bytes
_APART = 1e-3  # share of the extent of the cameras, and radians, by which two poses of an image may differ

Lens = tuple[str, int, int, tuple[float, ...]]
Pose = tuple[tuple[float, ...], tuple[float, ...], int, str, int]
"""Of an image: quaternion, translation, number of its camera, name, number."""
FramePose = tuple[float, ...]
"""Quaternion and translation, world to camera; in a rig, rig to camera."""
RigPoses = dict[int, FramePose]
"""Poses of the cameras of a rig, by the number of the camera."""

_STILL = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_IS_CAMERA = 0  # among COLMAP's kinds of sensors


def holds_colmap(folder: Path) -> bool:
    """Tell whether a folder holds a model."""
    return any(
        all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")) for suffix in (".bin", ".txt")
    )


def read_colmap(folder: Path) -> list[Camera]:
    """Read the cameras of all images of a model, in the order of their names."""
    with _sentences(folder, "model"):
        lenses, poses = _lenses(folder), _poses(folder)
        _check_known({key for _, _, key, _, _ in poses}, lenses, "images name")
        found = [_camera(lenses[key], q, t, name) for q, t, key, name, _ in poses]
    with _sentences(folder, "rig"):
        images = {number: (key, (*q, *t), name) for q, t, key, name, number in poses}
        check_frames(folder, images, {key: pose for rig in _rigs(folder) for key, pose in rig.items()})
    return sorted(found, key=lambda camera: camera.name)


def read_rig(folder: Path) -> list[Camera]:
    """Read the cameras of a model's rig in its frame, named after the folders of their images; [] without a rig.

    Of several rigs it is the one with the most cameras. Rigs are those of COLMAP 3.12 and later (rigs.bin, rigs.txt).
    """
    with _sentences(folder, "rig"):
        largest = max(_rigs(folder), key=len, default={})
        if len(largest) < 2:
            return []
        lenses, names = _lenses(folder), _folders(_poses(folder))
        _check_known(set(largest), lenses, "the rig names")
        return [
            _camera(lenses[key], pose[:4], pose[4:], names.get(key, f"camera {key}"))
            for key, pose in sorted(largest.items())
        ]


@contextmanager
def _sentences(folder: Path, what: str) -> Iterator[None]:
    """Turn errors of reading into sentences about the folder."""
    try:
        yield
    except OSError as error:
        raise LightFieldError(f"{folder} cannot be read: {error.strerror or error}.") from error
    except LightFieldError as error:
        raise LightFieldError(f"{folder}: {error}") from error
    except IndexError as error:
        raise LightFieldError(f"{folder} holds a damaged {what} of COLMAP: a line has too few entries.") from error
    except ValueError as error:
        raise LightFieldError(f"{folder} holds a damaged {what} of COLMAP: {error}.") from error


def _entries(
    folder: Path,
    name: str,
    of_binary: Callable[[BinaryIO], Iterator[T]],
    of_text: Callable[[str], Iterator[T]],
    largest: int = _LARGEST_TABLE,
) -> Iterator[T]:
    """Yield the entries of a file of a model, binary or a text of at most `largest` bytes; none where there is none."""
    if (folder / f"{'cameras' if name == 'images' else name}.bin").is_file():  # both are of one kind
        with (folder / f"{name}.bin").open("rb") as file:
            yield from of_binary(file)
    elif (folder / f"{name}.txt").is_file():
        yield from of_text(read_text(folder / f"{name}.txt", largest=largest))


def _lenses(folder: Path) -> dict[int, Lens]:
    return dict(_entries(folder, "cameras", _binary_cameras, _text_cameras))


def _poses(folder: Path) -> list[Pose]:
    return list(_entries(folder, "images", _binary_images, _text_images, _LARGEST_TEXT))


def _rigs(folder: Path) -> list[RigPoses]:
    """Read the poses of the cameras of each rig; none of models without rigs."""
    return list(_entries(folder, "rigs", _binary_rigs, _text_rigs))


def _check_known(keys: set[int], lenses: Mapping[int, Lens], who: str) -> None:
    if lost := sorted(keys - set(lenses)):
        raise LightFieldError(f"{who} camera {lost[0]}, which is not among the cameras.")


def _folders(poses: list[Pose]) -> dict[int, str]:
    """Folder of all images of a camera, by the number of the camera, where they share one."""
    found: dict[int, set[str]] = {}
    for _, _, key, name, _ in poses:
        parent, slash, _name = name.replace("\\", "/").rpartition("/")
        if slash:
            found.setdefault(key, set()).add(parent)
    return {key: next(iter(parents)).rsplit("/", 1)[-1] for key, parents in found.items() if len(parents) == 1}


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
        yield values[:4], values[4:], int(parts[8]), parts[9].strip(), int(parts[0])
        next(rows, "")  # its points


def _text_rigs(text: str) -> Iterator[RigPoses]:
    for line in _rows(text):
        parts = line.split()
        if len(parts) < 4:  # a rig without sensors
            continue
        key = int(parts[3])
        found: RigPoses = {key: _STILL} if parts[2] == "CAMERA" else {}
        at = 4
        while at < len(parts):
            kind, key, has_pose = parts[at], int(parts[at + 1]), parts[at + 2] == "1"
            if has_pose and kind == "CAMERA":
                found[key] = tuple(map(float, parts[at + 3 : at + 10]))
            at += 10 if has_pose else 3
        yield found


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
        number, *values, key = _unpacked(file, "<I7dI")
        name = bytearray()
        while (letter := _unpacked(file, "<c")[0]) != b"\0":
            name += letter
            if len(name) > _LONGEST_NAME:
                raise ValueError("the name of an image does not end")
        (points,) = _unpacked(file, "<Q")
        if 24 * points > os.fstat(file.fileno()).st_size - file.tell():
            raise ValueError("it ends too early")
        file.seek(24 * points, os.SEEK_CUR)
        yield tuple(values[:4]), tuple(values[4:]), key, name.decode("utf-8", "replace"), number


def _binary_rigs(file: BinaryIO) -> Iterator[RigPoses]:
    (count,) = _unpacked(file, "<Q")
    for _ in range(count):
        _, sensors = _unpacked(file, "<II")
        found: RigPoses = {}
        for sensor in range(sensors):
            kind, key = _unpacked(file, "<iI")
            pose: tuple[float, ...] | None = _STILL  # the first one is the rig's own frame
            if sensor > 0:
                (has_pose,) = _unpacked(file, "<B")
                pose = _unpacked(file, "<7d") if has_pose else None
            if pose is not None and kind == _IS_CAMERA:
                found[key] = pose
        yield found


def _unpacked(file: BinaryIO, form: str) -> tuple[Any, ...]:
    data = file.read(struct.calcsize(form))
    if len(data) < struct.calcsize(form):
        raise ValueError("it ends too early")
    return struct.unpack(form, data)


def _lens_of(camera: Camera) -> tuple[str, tuple[float, ...]]:
    """Choose the model of COLMAP for a lens; returns its name and parameters."""
    pinhole = (*camera.focal_length, *(place + 0.5 for place in camera.principal_point))
    k = camera.distortion
    if camera.model == "fisheye":
        return "OPENCV_FISHEYE", (*pinhole, *(k or (0.0,) * 4))
    if not any(k):
        return "PINHOLE", pinhole
    return ("OPENCV", (*pinhole, *k)) if len(k) == 4 else ("FULL_OPENCV", (*pinhole, *k, *(0.0,) * (8 - len(k))))


def _pose_of(camera: Camera) -> tuple[float, ...]:
    """Quaternion w, x, y, z and translation, world to camera."""
    from scipy.spatial.transform import Rotation  # slow to import, and needed for writing only

    w_last = Rotation.from_matrix(np.asarray(camera.rotation)).as_quat()
    return (*map(float, np.roll(w_last, 1)), *map(float, np.asarray(camera.translation)))


def write_colmap(
    folder: Path, cameras: Sequence[Camera], points: NDArray[np.float32], colors: NDArray[np.uint8]
) -> None:
    """Write a binary model: a lens and an image for each camera, named as it, and points [n, 3] without tracks."""
    lenses, images = [struct.pack("<Q", len(cameras))], [struct.pack("<Q", len(cameras))]
    for n, camera in enumerate(cameras, 1):
        model, values = _lens_of(camera)
        height, width = camera.size
        lenses.append(struct.pack(f"<iiQQ{len(values)}d", n, _MODELS[model][0], width, height, *values))
        name = camera.name.encode() + b"\0"
        images.append(struct.pack("<I7dI", n, *_pose_of(camera), n) + name + struct.pack("<Q", 0))
    (folder / "cameras.bin").write_bytes(b"".join(lenses))
    (folder / "images.bin").write_bytes(b"".join(images))
    kinds = [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
    table = np.zeros(len(points), np.dtype(kinds))
    table["id"], table["xyz"], table["rgb"], table["error"] = np.arange(1, len(points) + 1), points, colors, -1
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", len(points)) + table.tobytes())


def write_depth(path: Path, depth: NDArray[np.float32]) -> None:
    """Write a depth map [y, x] as COLMAP stores those of its stereo: float32, 0 where it is unknown."""
    known = np.where(np.isfinite(depth), depth, 0).astype("<f4")
    path.write_bytes(f"{depth.shape[1]}&{depth.shape[0]}&1&".encode() + known.tobytes())


def check_frames(folder: Path, images: Mapping[int, tuple[int, FramePose, str]], rig: Mapping[int, FramePose]) -> None:
    """Raise LightFieldError if frames put images elsewhere than their own poses do: one of the two files is stale.

    `images` has the number of the camera, pose and name of each image, `rig` the poses of the cameras, rig to camera.
    """
    centres = {key: _centre(pose) for key, (_, pose, _) in images.items()}
    extent = float(np.ptp(np.array(list(centres.values())), axis=0).max()) if centres else 0.0
    for frame, number in _entries(folder, "frames", _binary_frames, _text_frames, _LARGEST_TEXT):
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


def _text_frames(text: str) -> Iterator[tuple[FramePose, int]]:
    """Yield the pose of the rig (world to rig) and the number of each image that was taken from there."""
    for line in _rows(text):
        parts = line.split()
        for at in range(10, 10 + 3 * int(parts[9]), 3) if len(parts) >= 10 else ():
            if parts[at] == "CAMERA":
                yield tuple(map(float, parts[2:9])), int(parts[at + 2])


def _binary_frames(file: BinaryIO) -> Iterator[tuple[FramePose, int]]:
    (count,) = _unpacked(file, "<Q")
    for _ in range(count):
        _, _, *pose, sensors = _unpacked(file, "<II7dI")
        for _ in range(sensors):
            kind, _, number = _unpacked(file, "<iIQ")
            if kind == _IS_CAMERA:
                yield tuple(pose), number


def _matrix(pose: FramePose) -> tuple[Float64Array, Float64Array]:
    return of_quaternion(*pose[:4]), np.array(pose[4:], np.float64)


def _centre(pose: FramePose) -> Float64Array:
    rotation, translation = _matrix(pose)
    return np.asarray(-rotation.T @ translation)
