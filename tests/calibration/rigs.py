"""Calibrations of four cameras, written as others write them: what tests and fuzzing start from."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np

from lfgpu.calibration import Camera, write_cameras
from lfgpu.calibration.cameras import turned

LENS = (-0.2, 0.05, 0.001, -0.002)


def rig(*, lens: tuple[float, ...] = LENS, model: str = "pinhole", alike: bool = False) -> list[Camera]:
    """Four cameras that look about the same way; `alike` have square pixels and their axes in the middle."""
    rng = np.random.default_rng(5)
    cameras = []
    for n in range(4):
        rotation = turned(rng.normal(0, 0.05, 3))
        centre = np.array([0.1 * n, 0.02 * (n % 2), 0.0]) + rng.normal(0, 1e-3, 3)
        focal = (500.0, 500.0) if alike else (500.0 + n, 505.0 - n)
        principal = ((640 - 1) / 2, (480 - 1) / 2) if alike else (320.3 + n, 238.8)
        cameras.append(
            Camera((480, 640), focal, principal, lens, model, rotation, -rotation @ centre, name=f"shot_{n}.png")
        )
    return cameras


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation by less than a half turn."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    odd = rotation - rotation.T
    return np.array([w, odd[2, 1] / (4 * w), odd[0, 2] / (4 * w), odd[1, 0] / (4 * w)])


def opencv_array(key: str, array: np.ndarray, indent: str = "") -> list[str]:
    """An array as OpenCV writes it in YAML."""
    about = [f"rows: {len(array)}", f"cols: {array.shape[1]}"] if array.ndim < 3 else [f"sizes: {list(array.shape)}"]
    about += [f"dt: {'d' if array.dtype == np.float64 else 'i'}", f"data: {array.ravel().tolist()}"]
    kind = "matrix" if array.ndim < 3 else "nd-matrix"
    return [f"{indent}{key}: !!opencv-{kind}", *(f"{indent}   {line}" for line in about)]


def as_opencv(cameras: list[Camera], folder: Path) -> Path:
    text = ["%YAML:1.0", "---", "cameras:"]
    for camera in cameras:
        text += [f"  - name: {camera.name}", "    image_width: 640", "    image_height: 480"]
        text += opencv_array("camera_matrix", camera.matrix, "    ")
        text += opencv_array("distortion_coefficients", np.array([camera.distortion]), "    ")
        text += opencv_array("R", np.asarray(camera.rotation), "    ")
        text += opencv_array("T", np.asarray(camera.translation)[:, None], "    ")
        text += ["    fisheye: 1"] if camera.model == "fisheye" else []
    (folder / "rig.yaml").write_text("\n".join(text) + "\n")
    return folder / "rig.yaml"


def as_opencv_json(cameras: list[Camera], folder: Path) -> Path:
    entries = {
        camera.name: {
            "K": camera.matrix.tolist(),
            "D": list(camera.distortion),
            "R": np.asarray(camera.rotation).tolist(),
            "t": np.asarray(camera.translation).tolist(),
            "image_size": [640, 480],
            "fisheye": camera.model == "fisheye",
        }
        for camera in cameras
    }
    (folder / "rig.json").write_text(json.dumps(entries))
    return folder / "rig.json"


def as_multiview(cameras: list[Camera], folder: Path) -> Path:
    """Return the output of OpenCV's multiview_calibration.py: an array for each kind of number, of all cameras."""
    arrays = {
        "Ks": np.stack([camera.matrix for camera in cameras]),
        "distortions": np.stack([camera.distortion for camera in cameras]),
        "Rs": np.stack([np.asarray(camera.rotation) for camera in cameras]),
        "Ts": np.stack([np.asarray(camera.translation)[:, None] for camera in cameras]),
        "image_sizes": np.array([camera.size[::-1] for camera in cameras], np.int32),
        "models": np.array([[camera.model == "fisheye"] for camera in cameras], np.int32),
    }
    text = [line for key, array in arrays.items() for line in opencv_array(key, array)]
    names = ",".join(camera.name for camera in cameras)
    (folder / "multi.yaml").write_text("\n".join(["%YAML:1.0", "---", *text, f'cam_ids: "{names}"']) + "\n")
    return folder / "multi.yaml"


def as_kalibr(cameras: list[Camera], folder: Path) -> Path:
    lines, before = [], np.eye(4)
    for n, camera in enumerate(cameras):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.rotation, camera.translation
        (fx, fy), (cx, cy) = camera.focal_length, camera.principal_point
        lines += [
            f"cam{n}:",
            "  camera_model: pinhole",
            f"  intrinsics: {[fx, fy, cx, cy]}",
            f"  distortion_model: {'equidistant' if camera.model == 'fisheye' else 'radtan'}",
            f"  distortion_coeffs: {list(camera.distortion)}",
            "  resolution: [640, 480]",
        ]
        if n:
            lines += [f"  T_cn_cnm1: {(pose @ np.linalg.inv(before)).tolist()}"]
        before = pose
    (folder / "camchain.yaml").write_text("\n".join(lines) + "\n")
    return folder / "camchain.yaml"


def colmap_values(camera: Camera) -> tuple[str, int, list[float]]:
    (fx, fy), (cx, cy) = camera.focal_length, camera.principal_point
    name, number = ("OPENCV_FISHEYE", 5) if camera.model == "fisheye" else ("OPENCV", 4)
    return name, number, [fx, fy, cx + 0.5, cy + 0.5, *camera.distortion]


def pose_of(camera: Camera) -> list[float]:
    """The quaternion and the translation of a camera, as COLMAP has them."""
    return [*quaternion(np.asarray(camera.rotation)).tolist(), *np.asarray(camera.translation).tolist()]


def as_colmap_text(cameras: list[Camera], folder: Path, lenses: int = 99) -> Path:
    """Images of which each has a lens of its own, as long as there are `lenses`; then they begin anew."""
    listed, poses = ["# Camera list"], ["# Image list"]
    for n, camera in enumerate(cameras):
        name, _, values = colmap_values(camera)
        listed += [f"{n + 1} {name} 640 480 {' '.join(map(repr, values))}"] if n < lenses else []
        poses += [f"{n + 7} {' '.join(map(repr, pose_of(camera)))} {n % lenses + 1} {camera.name}", "1.0 2.0 -1"]
    (folder / "cameras.txt").write_text("\n".join(listed) + "\n")
    (folder / "images.txt").write_text("\n".join(poses) + "\n")
    return folder


def as_colmap_binary(cameras: list[Camera], folder: Path, lenses: int = 99) -> Path:
    listed, poses = [], [struct.pack("<Q", len(cameras))]
    for n, camera in enumerate(cameras):
        _, number, values = colmap_values(camera)
        listed += [struct.pack(f"<iiQQ{len(values)}d", n + 1, number, 640, 480, *values)] if n < lenses else []
        poses.append(struct.pack("<I7dI", n + 7, *pose_of(camera), n % lenses + 1) + camera.name.encode() + b"\0")
        poses.append(struct.pack("<Qddq", 1, 1.0, 2.0, -1))
    (folder / "cameras.bin").write_bytes(struct.pack("<Q", len(listed)) + b"".join(listed))
    (folder / "images.bin").write_bytes(b"".join(poses))
    return folder


def as_nerfstudio(cameras: list[Camera], folder: Path) -> Path:
    frames = []
    for camera in cameras:
        pose = np.eye(4)
        pose[:3, :3] = np.asarray(camera.rotation).T * (1, -1, -1)
        pose[:3, 3] = camera.centre
        (fx, fy), (cx, cy) = camera.focal_length, camera.principal_point
        names = ("k1", "k2", "k3", "k4") if camera.model == "fisheye" else ("k1", "k2", "p1", "p2")
        lens = dict(zip(names, camera.distortion, strict=False))
        frames.append(
            {"file_path": f"images/{camera.name}", "transform_matrix": pose.tolist(), "fl_x": fx, "fl_y": fy}
            | {"cx": cx + 0.5, "cy": cy + 0.5, **lens}
        )
    model = "OPENCV_FISHEYE" if cameras[0].model == "fisheye" else "OPENCV"
    (folder / "transforms.json").write_text(json.dumps({"w": 640, "h": 480, "camera_model": model, "frames": frames}))
    return folder / "transforms.json"


def as_llff(cameras: list[Camera], folder: Path) -> Path:
    rows = []
    for camera in cameras:
        right, down, forward = np.asarray(camera.rotation)
        pose = np.stack([down, right, -forward, camera.centre, np.array([480, 640, camera.focal_length[0]])], axis=1)
        rows.append([*pose.ravel(), 2.0, 9.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))
    return folder / "poses_bounds.npy"


def as_toml(cameras: list[Camera], folder: Path) -> Path:
    write_cameras(cameras, folder / "cameras.toml")
    return folder / "cameras.toml"


Write: TypeAlias = Callable[[list[Camera], Path], Path]

WRITERS: dict[str, Write] = {
    "cameras-toml": as_toml,
    "opencv-yaml": as_opencv,
    "opencv-json": as_opencv_json,
    "opencv-multiview": as_multiview,
    "kalibr": as_kalibr,
    "colmap-text": as_colmap_text,
    "colmap-binary": as_colmap_binary,
    "nerfstudio": as_nerfstudio,
    "llff": as_llff,
}
"""Each format; LLFF has no lenses and one focal length."""
