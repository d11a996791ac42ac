"""Calibrations written as others write them and read back: the same rays from the same places."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfgpu.calibration import Camera, read_calibration, write_cameras
from lfgpu.calibration.cameras import turned
from lfgpu.calibration.rig import matched
from lfgpu.errors import LightFieldError

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


def as_opencv(cameras: list[Camera], folder: Path) -> Path:
    text = ["%YAML:1.0", "---", "cameras:"]
    for camera in cameras:
        text += [f"  - name: {camera.name}", "    image_width: 640", "    image_height: 480"]
        for key, matrix in (
            ("camera_matrix", camera.matrix),
            ("distortion_coefficients", np.array([camera.distortion])),
            ("R", np.asarray(camera.rotation)),
            ("T", np.asarray(camera.translation)[:, None]),
        ):
            text += [f"    {key}: !!opencv-matrix", f"      rows: {len(matrix)}", f"      cols: {matrix.shape[1]}"]
            text += ["      dt: d", f"      data: {[float(value) for value in matrix.ravel()]}"]
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
    """What OpenCV's multiview_calibration.py writes, by OpenCV itself."""
    cv2 = pytest.importorskip("cv2")
    storage = cv2.FileStorage(str(folder / "multi.yaml"), cv2.FILE_STORAGE_WRITE)
    storage.write("Ks", np.stack([camera.matrix for camera in cameras]))
    storage.write("distortions", np.concatenate([camera.distortion for camera in cameras]))
    storage.write("Rs", np.stack([np.asarray(camera.rotation) for camera in cameras]))
    storage.write("Ts", np.stack([np.asarray(camera.translation) for camera in cameras]))
    storage.write("image_sizes", np.array([(640, 480)] * len(cameras), np.int32))
    storage.write("models", np.array([camera.model == "fisheye" for camera in cameras], np.int32))
    storage.write("cam_ids", ",".join(camera.name for camera in cameras))
    storage.release()
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


def as_colmap_text(cameras: list[Camera], folder: Path) -> Path:
    lenses, poses = ["# Camera list"], ["# Image list"]
    for n, camera in enumerate(cameras):
        name, _, values = colmap_values(camera)
        lenses.append(f"{n + 1} {name} 640 480 {' '.join(map(repr, values))}")
        numbers = [*quaternion(np.asarray(camera.rotation)), *np.asarray(camera.translation)]
        poses += [f"{n + 7} {' '.join(repr(float(v)) for v in numbers)} {n + 1} {camera.name}", "1.0 2.0 -1"]
    (folder / "cameras.txt").write_text("\n".join(lenses) + "\n")
    (folder / "images.txt").write_text("\n".join(poses) + "\n")
    return folder


def as_colmap_binary(cameras: list[Camera], folder: Path) -> Path:
    lenses, poses = [struct.pack("<Q", len(cameras))], [struct.pack("<Q", len(cameras))]
    for n, camera in enumerate(cameras):
        _, number, values = colmap_values(camera)
        lenses.append(struct.pack(f"<iiQQ{len(values)}d", n + 1, number, 640, 480, *values))
        numbers = [*quaternion(np.asarray(camera.rotation)), *np.asarray(camera.translation)]
        poses.append(struct.pack("<I7dI", n + 7, *numbers, n + 1) + camera.name.encode() + b"\0")
        poses.append(struct.pack("<Qddq", 1, 1.0, 2.0, -1))
    (folder / "cameras.bin").write_bytes(b"".join(lenses))
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


WRITERS = [
    as_toml,
    as_opencv,
    as_opencv_json,
    as_multiview,
    as_kalibr,
    as_colmap_text,
    as_colmap_binary,
    as_nerfstudio,
]


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
@pytest.mark.parametrize("write", WRITERS)
def test_rays_come_back(write: Callable[[list[Camera], Path], Path], model: str, tmp_path: Path) -> None:
    cameras = rig(model=model)
    _same(cameras, read_calibration(write(cameras, tmp_path)).cameras, of_first=write is as_kalibr)


def moved(camera: Camera, rotation: np.ndarray, translation: np.ndarray, name: str) -> Camera:
    """A camera after the rig, whose world was the camera's, has gone to a pose (world to rig)."""
    turn = np.asarray(camera.rotation)
    return replace(camera, rotation=turn @ rotation, translation=turn @ translation + camera.translation, name=name)


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
def test_the_rig_of_a_colmap_model(binary: bool, tmp_path: Path) -> None:
    """Images that a rig took from two places calibrate pictures of other names, by folder or by order."""
    cameras = rig()
    first = cameras[0]
    turn, shift = np.asarray(first.rotation), np.asarray(first.translation)
    # In the frame of the first camera, as COLMAP has rigs.
    own = [moved(camera, turn.T, -turn.T @ shift, f"left{n}") for n, camera in enumerate(cameras)]
    poses = [(turned(np.array([0.1, 0.2, 0.3]) * k), np.array([1.0, 2.0, 3.0]) * k) for k in (0, 1)]
    images = [moved(camera, *pose, f"rig/{camera.name}/shot{k}.png") for k, pose in enumerate(poses) for camera in own]
    write = as_colmap_binary if binary else as_colmap_text
    write(images, tmp_path)
    write_lenses = as_colmap_binary if binary else as_colmap_text
    (tmp_path / "lenses").mkdir()
    write_lenses(own, tmp_path / "lenses")
    # Two images share a lens: the model has four of them.
    for name in ("cameras.bin", "cameras.txt"):
        if (tmp_path / "lenses" / name).is_file():
            (tmp_path / "lenses" / name).replace(tmp_path / name)
    numbers = [[*quaternion(np.asarray(camera.rotation)), *np.asarray(camera.translation)] for camera in own]
    if binary:
        data = bytearray((tmp_path / "images.bin").read_bytes())
        at = 8
        for n in range(len(images)):
            struct.pack_into("<I", data, at + 60, n % 4 + 1)
            at = data.index(b"\0", at + 64) + 1 + 8 + 24
        (tmp_path / "images.bin").write_bytes(data)
        parts = [struct.pack("<QIIiI", 1, 1, 5, 0, 1)]
        parts += [struct.pack("<iIB7d", 0, n + 1, 1, *numbers[n]) for n in (1, 2, 3)]
        (tmp_path / "rigs.bin").write_bytes(b"".join(parts) + struct.pack("<iIB", 1, 9, 0))
    else:
        lines = (tmp_path / "images.txt").read_text().splitlines()
        for n in range(len(images)):
            parts = lines[1 + 2 * n].split(maxsplit=9)
            lines[1 + 2 * n] = " ".join([*parts[:8], str(n % 4 + 1), parts[9]])
        (tmp_path / "images.txt").write_text("\n".join(lines))
        rows = [f"CAMERA {n + 1} 1 {' '.join(repr(float(v)) for v in numbers[n])}" for n in (1, 2, 3)]
        (tmp_path / "rigs.txt").write_text(f"# rigs\n1 5 CAMERA 1 {' '.join(rows)} IMU 9 0\n")
    found = read_calibration(tmp_path)
    assert len(found.cameras) == 8
    _same(own, found.rig)
    assert [camera.name for camera in found.rig] == ["left0", "left1", "left2", "left3"]
    size = (480, 640)
    by_image = matched(found.cameras, ["shot0.png"], size, "rig", rig=found.rig)
    assert by_image[0] is not found.rig[0]
    by_folder = matched(found.cameras, ["left2.jpg", "left0.jpg"], size, "rig", rig=found.rig)
    assert [camera.name for camera in by_folder] == ["left2", "left0"]
    by_order = matched(found.cameras, ["a.png", "b.png", "c.png", "d.png"], size, "rig", rig=found.rig)
    assert by_order == list(found.rig)
    (tmp_path / ("rigs.bin" if binary else "rigs.txt")).write_bytes(struct.pack("<Q", 4) if binary else b"1 2 CAMERA x")
    with pytest.raises(LightFieldError, match="damaged rig"):
        read_calibration(tmp_path)


def test_llff_rays_come_back_with_depths(tmp_path: Path) -> None:
    cameras = rig(lens=(), alike=True)
    found = read_calibration(as_llff(cameras, tmp_path))
    assert found.depths == (2.0, 9.0)
    _same(cameras, found.cameras)


def _same(cameras: list[Camera], found: tuple[Camera, ...], *, of_first: bool = False) -> None:
    """All rays within 1e-6; `of_first`, in the frame of the first camera, which is Kalibr's world."""
    pixels = np.stack(np.meshgrid([0.0, 200, 639], [0.0, 300, 479]), axis=-1)
    first = cameras[0]
    assert len(found) == len(cameras)
    for before, after in zip(cameras, found, strict=True):
        ray, centre = before.rays(pixels) @ np.asarray(before.rotation), before.centre
        if of_first:
            ray = ray @ np.asarray(first.rotation).T
            centre = np.asarray(first.rotation) @ centre + first.translation
        np.testing.assert_allclose(after.rays(pixels) @ np.asarray(after.rotation), ray, atol=1e-6)
        np.testing.assert_allclose(after.centre, centre, atol=1e-6)


def test_what_is_no_calibration_is_refused(tmp_path: Path) -> None:
    """Each with one sentence that names the file."""
    cases: dict[str, tuple[str | bytes, str]] = {
        "a.toml": ("[[cameras]]\nname = 'x'\n", "has no size"),
        "b.toml": ("[[cameras", "not valid TOML"),
        "c.json": ("{", "not valid JSON"),
        "d.json": ('{"frames": [{}]}', "has no w"),
        "e.yaml": ("cam0:\n  camera_model: omni\n  intrinsics: []\n  distortion_model: none\n", "omni"),
        "f.npy": (b"nothing", "cannot be read"),
        "g.txt": ("", "no calibration that is known"),
        "h.yaml": ("a: 1", "has no cameras"),
        "i.yaml": ("x: {image_width: 4, image_height: 4}", "has no K"),
    }
    for name, (content, words) in cases.items():
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(LightFieldError, match=words) as error:
            read_calibration(path)
        assert name in str(error.value)
    with pytest.raises(LightFieldError, match="does not exist"):
        read_calibration(tmp_path / "nothing.toml")
    with pytest.raises(LightFieldError, match="no model of COLMAP"):
        read_calibration(tmp_path)
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<Q", 3))
    (tmp_path / "images.bin").write_bytes(struct.pack("<Q", 3))
    with pytest.raises(LightFieldError, match="damaged"):
        read_calibration(tmp_path)
    mirrored = np.diag([1.0, 1.0, -1.0])
    (tmp_path / "m.json").write_text(
        json.dumps({"left": {"K": np.eye(3).tolist(), "R": mirrored.tolist(), "image_size": [4, 4]}})
    )
    with pytest.raises(LightFieldError, match="left: the rotation mirrors"):
        read_calibration(tmp_path / "m.json")
