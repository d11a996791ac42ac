"""Models of COLMAP: cameras and images, as text or binary. Its first pixel has its centre at (0.5, 0.5)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

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


def read_rig(folder: Path) -> list[Camera]:
    """The cameras of a model's rig in the rig's frame, named after the folders of their images; [] without a rig.

    Of several rigs it is the one with the most cameras. Rigs are those of COLMAP 3.12 and later (rigs.bin, rigs.txt).
    """
    try:
        if (folder / "rigs.bin").is_file():
            rigs = list(_binary_rigs((folder / "rigs.bin").read_bytes()))
            lenses = dict(_binary_cameras((folder / "cameras.bin").read_bytes()))
            poses = list(_binary_images((folder / "images.bin").read_bytes()))
        elif (folder / "rigs.txt").is_file():
            rigs = list(_text_rigs((folder / "rigs.txt").read_text(encoding="utf-8")))
            lenses = dict(_text_cameras((folder / "cameras.txt").read_text(encoding="utf-8")))
            poses = list(_text_images((folder / "images.txt").read_text(encoding="utf-8")))
        else:
            return []
        largest = max(rigs, key=len, default={})
        if len(largest) < 2:
            return []
        names = {key: _folder_of([name for _, _, of, name in poses if of == key], key) for key in largest}
        return [_camera(lenses[key], pose[:4], pose[4:], names[key]) for key, pose in sorted(largest.items())]
    except LightFieldError as error:
        raise LightFieldError(f"{folder}: {error}") from error
    except (KeyError, ValueError, IndexError, struct.error) as error:
        raise LightFieldError(f"{folder} holds a damaged rig of COLMAP ({type(error).__name__}: {error}).") from error


def _folder_of(names: list[str], key: int) -> str:
    """The folder that all images of a camera lie in, else "camera" and its number."""
    folders = {name.replace("\\", "/").rsplit("/", 1)[0] for name in names if "/" in name.replace("\\", "/")}
    return folders.pop().rsplit("/", 1)[-1] if len(folders) == 1 else f"camera {key}"


_STILL = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_IS_CAMERA = 0  # among COLMAP's kinds of sensors


def _text_rigs(text: str) -> Iterator[dict[int, tuple[float, ...]]]:
    """Of each rig the poses of its cameras (quaternion, translation; rig to camera), by the number of the camera."""
    for line in _rows(text):
        parts = line.split()
        if len(parts) < 4:
            continue
        found: dict[int, tuple[float, ...]] = {int(parts[3]): _STILL} if parts[2] == "CAMERA" else {}
        at = 4
        while at < len(parts):
            kind, key, has_pose = parts[at], int(parts[at + 1]), parts[at + 2] == "1"
            if has_pose and kind == "CAMERA":
                found[key] = tuple(map(float, parts[at + 3 : at + 10]))
            at += 10 if has_pose else 3
        yield found


def _binary_rigs(data: bytes) -> Iterator[dict[int, tuple[float, ...]]]:
    (count,), at = struct.unpack_from("<Q", data), 8
    for _ in range(count):
        _, sensors = struct.unpack_from("<II", data, at)
        at += 8
        found: dict[int, tuple[float, ...]] = {}
        for sensor in range(sensors):
            kind, key = struct.unpack_from("<iI", data, at)
            at += 8
            pose = _STILL
            if sensor > 0:  # the first one is the rig's own frame
                (has_pose,) = struct.unpack_from("<B", data, at)
                at += 1
                if not has_pose:
                    continue
                pose = struct.unpack_from("<7d", data, at)
                at += 56
            if kind == _IS_CAMERA:
                found[key] = pose
        yield found


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


def write_colmap(
    folder: Path, cameras: Sequence[Camera], points: NDArray[np.float32], colors: NDArray[np.uint8]
) -> None:
    """Write a model, binary and as text: a lens and an image for each camera, and points without tracks.

    Parameters
    ----------
    folder
        An existing folder.
    cameras
        Their names are those of the images.
    points, colors
        [n, 3], in the world of the cameras, and red, green, blue.
    """
    _write_text(folder, cameras, points, colors)
    _write_binary(folder, cameras, points, colors)


def _lens_of(camera: Camera) -> tuple[str, tuple[float, ...]]:
    """The name of COLMAP's model and its parameters."""
    pinhole = (*camera.focal_length, *(place + 0.5 for place in camera.principal_point))
    k = camera.distortion
    if camera.model == "fisheye":
        return "OPENCV_FISHEYE", (*pinhole, *(k or (0.0,) * 4))
    if not any(k):
        return "PINHOLE", pinhole
    return ("OPENCV", (*pinhole, *k)) if len(k) == 4 else ("FULL_OPENCV", (*pinhole, *k, *(0.0,) * (8 - len(k))))


def _pose_of(camera: Camera) -> tuple[float, ...]:
    """Quaternion w, x, y, z and translation, world to camera."""
    w_last = Rotation.from_matrix(np.asarray(camera.rotation)).as_quat()
    return (*map(float, np.roll(w_last, 1)), *map(float, np.asarray(camera.translation)))


def _write_text(
    folder: Path, cameras: Sequence[Camera], points: NDArray[np.float32], colors: NDArray[np.uint8]
) -> None:
    lenses, images = [], []
    for n, camera in enumerate(cameras, 1):
        model, values = _lens_of(camera)
        height, width = camera.size
        lenses.append(f"{n} {model} {width} {height} {' '.join(map(repr, values))}\n")
        images.append(f"{n} {' '.join(map(repr, _pose_of(camera)))} {n} {camera.name}\n\n")
    (folder / "cameras.txt").write_text("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n" + "".join(lenses), encoding="utf-8")
    head = "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of POINTS2D[]\n"
    (folder / "images.txt").write_text(head + "".join(images), encoding="utf-8")
    rows = (
        f"{n} {x:.7g} {y:.7g} {z:.7g} {r} {g} {b} -1\n"
        for n, ((x, y, z), (r, g, b)) in enumerate(zip(points.tolist(), colors.tolist(), strict=True), 1)
    )
    head = "# POINT3D_ID X Y Z R G B ERROR TRACK[]\n"
    (folder / "points3D.txt").write_text(head + "".join(rows), encoding="utf-8")


def _write_binary(
    folder: Path, cameras: Sequence[Camera], points: NDArray[np.float32], colors: NDArray[np.uint8]
) -> None:
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
    """Write a depth map [y, x] as COLMAP stores those of its stereo: float32, 0 where it is not known."""
    known = np.where(np.isfinite(depth), depth, 0).astype("<f4")
    path.write_bytes(f"{depth.shape[1]}&{depth.shape[0]}&1&".encode() + known.tobytes())
