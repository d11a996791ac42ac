"""Calibrations written as others write them and read back: the same rays from the same places."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfgpu.calibration import Camera, read_calibration
from lfgpu.calibration.cameras import turned
from lfgpu.calibration.rig import fit_rig, matched
from lfgpu.errors import LightFieldError
from lfgpu.printable import printable
from tests.calibration.rigs import (
    WRITERS,
    Write,
    as_colmap_binary,
    as_colmap_text,
    as_kalibr,
    as_llff,
    pose_of,
    quaternion,
    rig,
)


def as_multiview_of_opencv(cameras: list[Camera], folder: Path) -> Path:
    """Write the output of OpenCV's multiview_calibration.py with OpenCV."""
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


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
@pytest.mark.parametrize("write", [*(w for w in WRITERS.values() if w is not as_llff), as_multiview_of_opencv])
def test_rays_come_back(write: Write, model: str, tmp_path: Path) -> None:
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
    turn, shift = np.asarray(cameras[0].rotation), np.asarray(cameras[0].translation)
    # In the frame of the first camera, as COLMAP has rigs.
    own = [moved(camera, turn.T, -turn.T @ shift, f"left{n}") for n, camera in enumerate(cameras)]
    poses = [(turned(np.array([0.1, 0.2, 0.3]) * k), np.array([1.0, 2.0, 3.0]) * k) for k in (0, 1)]
    images = [moved(camera, *pose, f"rig/{camera.name}/shot{k}.png") for k, pose in enumerate(poses) for camera in own]
    if binary:
        as_colmap_binary(images, tmp_path, lenses=4)
        parts = [struct.pack("<QIIiI", 1, 1, 5, 0, 1)]
        parts += [struct.pack("<iIB7d", 0, n + 1, 1, *pose_of(own[n])) for n in (1, 2, 3)]
        (tmp_path / "rigs.bin").write_bytes(b"".join(parts) + struct.pack("<iIB", 1, 9, 0))
    else:
        as_colmap_text(images, tmp_path, lenses=4)
        rows = [f"CAMERA {n + 1} 1 {' '.join(map(repr, pose_of(own[n])))}" for n in (1, 2, 3)]
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


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
def test_images_of_a_colmap_model_that_are_older_than_its_frames(binary: bool, tmp_path: Path) -> None:
    """Frames and rigs say where images were taken; poses of images that say otherwise are stale."""
    cameras = rig()
    as_colmap_binary(cameras, tmp_path) if binary else as_colmap_text(cameras, tmp_path)
    poses = [pose_of(camera) for camera in cameras]
    first = 7  # number of the first image

    def write(moved: float) -> None:
        if binary:
            rigs = [struct.pack("<IIiI", n + 1, 1, 0, n + 1) for n in range(len(cameras))]
            (tmp_path / "rigs.bin").write_bytes(struct.pack("<Q", len(cameras)) + b"".join(rigs))
            frames = [
                struct.pack("<II7dIiIQ", n + 1, n + 1, *pose[:6], pose[6] + moved, 1, 0, n + 1, n + first)
                for n, pose in enumerate(poses)
            ]
            (tmp_path / "frames.bin").write_bytes(struct.pack("<Q", len(cameras)) + b"".join(frames))
            return
        outer, away = np.asarray(cameras[3].rotation), np.asarray(cameras[3].translation)
        sensors = ["1 4 CAMERA 4"]  # one rig, whose frame is that of its last camera
        for n, camera in enumerate(cameras[:3], 1):
            turn = np.asarray(camera.rotation) @ outer.T
            numbers = (*quaternion(turn), *(np.asarray(camera.translation) - turn @ away))
            sensors.append(f"CAMERA {n} 1 {' '.join(repr(float(v)) for v in numbers)}")
        (tmp_path / "rigs.txt").write_text("# rigs\n" + " ".join(sensors))
        numbers = " ".join(repr(float(v)) for v in (*poses[3][:6], poses[3][6] + moved))
        images = " ".join(f"CAMERA {n + 1} {n + first}" for n in range(4))
        (tmp_path / "frames.txt").write_text(f"# frames\n1 1 {numbers} 4 {images}")

    write(0.0)
    _same(cameras, read_calibration(tmp_path).cameras)
    write(0.1)
    with pytest.raises(LightFieldError, match="elsewhere than frames and rigs do"):
        read_calibration(tmp_path)
    if binary:
        (tmp_path / "frames.bin").write_bytes((tmp_path / "frames.bin").read_bytes()[:-5])
        with pytest.raises(LightFieldError, match=r"elsewhere|end too early"):
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
    assert "does not exist" in refused(tmp_path / "nothing.toml")
    assert "no model of COLMAP" in refused(tmp_path)


def refused(path: Path) -> str:
    """The sentence with which a calibration is refused; it names the file."""
    with pytest.raises(LightFieldError) as error:
        read_calibration(path)
    text = str(error.value)
    assert text.count(path.name) == 1
    assert text.endswith(".")
    assert printable(text) == text
    return text


LAUGHS = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9) if n else '1'}]\n" for n in range(12))


@pytest.mark.parametrize(
    ("suffix", "content", "words"),
    [
        ("toml", "[[cameras]]\nname = 'x'\n", "has no size"),
        ("toml", "[[cameras", "not valid TOML"),
        ("npy", "nothing", "cannot be read"),
        ("txt", "", "no calibration that is known"),
        ("yaml", "cam0:\n  camera_model: omni\n  intrinsics: []\n  distortion_model: none\n", "omni"),
        ("yaml", "a: 1", "has no cameras"),
        ("yaml", "x: {image_width: 4, image_height: 4}", "has no K"),
        ("yaml", "x: {K: [1, 0, 1, 0, 1, 1, 0, 0, 1]}", "x has no image_width"),
        ("yaml", LAUGHS + "left: {K: *a11, image_size: [4, 4]}", "unfold to more than any calibration has"),
        ("yaml", "left: &a [*a]", "an alias of something that it is in"),
        ("yaml", "[" * 5000, "not valid YAML"),
        ("yaml", "left: {K: 2001-01-01, image_size: [4, 4]}", "numbers were expected, found datetime"),
        ("yaml", "left: {K: !!opencv-matrix {rows: 3}, image_size: [4, 4]}", "a matrix without data"),
        ("yaml", "left: {K: !!opencv-matrix {rows: 99999999, cols: 9, data: [1]}, image_size: [4, 4]}", "99999999 x 9"),
        ("yaml", "left: {K: [1, 2], image_size: [4, 4]}", "9 numbers were expected, found 2"),
        ("yaml", "left: {K: [" + "1" * 400 + ", 0, 0, 0, 0, 0, 0, 0, 0], image_size: [4, 4]}", "were expected, found"),
        ("yaml", "left: !!python/object/apply:os.getcwd []", "not valid YAML"),
        ("yaml", "Ks: []\nRs: []", "Ks is empty"),
        ("yaml", "Ks: 5", "9 numbers were expected, found 1"),
        ("yaml", "cam0: {camera_model: pinhole, distortion_model: radtan, intrinsics: [1, 1, 1e300, 1]}", "up to"),
        ("yaml", "cam0: {camera_model: pinhole, distortion_model: [], intrinsics: []}", "wrong entries"),
        ("json", "{", "not valid JSON"),
        ("json", "[" * 100_000, "not valid JSON"),
        ("json", '{"frames": [{}]}', "has no file_path"),
        ("json", '{"frames": [{"w": 1e999, "h": 4}]}', "numbers up to 1e+12 were expected, found inf"),
        ("json", '{"frames": [{"w": 4, "h": 4, "camera_angle_x": 0}]}', "angle between 0 and pi"),
        ("json", '{"frames": [{"w": 4, "h": 4, "fl_x": 4, "transform_matrix": [[1, 0, 0, 0]]}]}', "3 or 4 rows"),
        ("json", '{"frames": []}', "has no cameras"),
        ("json", '{"frames": 5}', "frames must be a list of tables"),
        (
            "json",
            '{"left": {"K": {"type_id": "opencv-matrix", "rows": -1, "cols": 3, "data": []}, "image_size": [4, 4]}}',
            "-1",
        ),
        ("json", '{"left": {"K": [[5, 0, 2], [0, 5, 2], [0, 0, 1]], "image_size": [1e9, 4]}}', "no camera has"),
        (
            "json",
            '{"left": {"K": [1, 0, 0, 0, 1, 0, 0, 0, 1], "R": [1, 0, 0, 0, 1, 0, 0, 0, -1], "image_size": [4, 4]}}',
            "left: the rotation mirrors",
        ),
    ],
)
def test_texts_that_are_no_calibration(tmp_path: Path, suffix: str, content: str, words: str) -> None:
    (tmp_path / f"rig.{suffix}").write_text(content)
    assert words in refused(tmp_path / f"rig.{suffix}")


def test_yaml_that_is_small_is_read(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(
        "left: {K: [1e1, 0, 2, 0, 10, 2, 0, 0, 1], D: [1e-5, 0, 0, 0], image_size: [4, 4]}"
    )
    camera = read_calibration(tmp_path / "rig.yaml").cameras[0]
    assert (camera.focal_length, camera.distortion[0]) == ((10.0, 10.0), 1e-5)
    # As programs write them that use one list twice.
    path = as_kalibr(rig(), tmp_path)
    text = path.read_text().replace("resolution: [640, 480]", "resolution: &size [640, 480]", 1)
    path.write_text(text.replace("resolution: [640, 480]", "resolution: *size"))
    assert "*size" in path.read_text()
    assert [camera.size for camera in read_calibration(path).cameras] == [(480, 640)] * 4


def test_arrays_that_are_no_poses(tmp_path: Path) -> None:
    path = tmp_path / "poses_bounds.npy"
    for rows, words in (
        (np.zeros((0, 17)), "found shape (0, 17)"),
        (np.full((2, 17), np.nan), "found nan"),
        (np.full((2, 17), 1e300), "found 1e+300"),
        (np.full((2, 17), "x"), "numbers were expected"),
        (np.zeros((2, 17)), "positive"),
    ):
        np.save(path, rows)
        assert words in refused(path)
    np.save(path, np.array([{}] * 17, object), allow_pickle=True)
    assert "Python objects" in refused(path)
    header = np.lib.format.header_data_from_array_1_0(np.zeros(1)) | {"shape": (1 << 31, 17)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    assert "cannot hold" in refused(path)


def test_models_of_colmap_that_are_damaged(tmp_path: Path) -> None:
    as_colmap_binary(rig(), tmp_path)
    whole = (tmp_path / "images.bin").read_bytes()
    (tmp_path / "images.bin").write_bytes(whole[:-1])
    assert "it ends too early" in refused(tmp_path)
    (tmp_path / "images.bin").write_bytes(whole[:12] + bytes(32) + whole[44:])
    assert "the quaternion of no rotation" in refused(tmp_path)
    (tmp_path / "images.bin").write_bytes(whole[:68] + b"\xff" + whole[69:])
    assert "which is not among the cameras" in refused(tmp_path)
    with (tmp_path / "images.bin").open("wb") as file:  # a name without an end
        file.write(whole[:72])
        file.truncate(1 << 33)
        file.seek(72)
        file.write(b"a" * 10_000)
    assert "does not end" in refused(tmp_path)
    (tmp_path / "images.bin").write_bytes(struct.pack("<Q", 0))
    assert "has no cameras" in refused(tmp_path)


def test_rigs_of_colmap_that_are_damaged(tmp_path: Path) -> None:
    as_colmap_binary(rig(), tmp_path)
    head, still = struct.pack("<QIIiI", 1, 1, 2, 0, 1), struct.pack("<4d3d", 1, 0, 0, 0, 1, 0, 0)
    for data, words in (
        (struct.pack("<Q", 1 << 60), "it ends too early"),
        (struct.pack("<QII", 1, 1, 1 << 31), "it ends too early"),
        (head + struct.pack("<iIB", 0, 2, 1) + still[:-1], "it ends too early"),
        (head + struct.pack("<iIB", 0, 77, 1) + still, "the rig names camera 77, which is not among the cameras"),
        (head + struct.pack("<iIB", 0, 2, 1) + bytes(56), "the quaternion of no rotation"),
    ):
        (tmp_path / "rigs.bin").write_bytes(data)
        assert words in refused(tmp_path)
    (tmp_path / "rigs.bin").unlink()
    for text, words in (
        ("1 2 CAMERA 1 CAMERA 2 1 1 0 0", "4 numbers were expected, found 3"),
        ("1 2 CAMERA 1 CAMERA 2", "damaged rig"),
        ("1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 nan 0 0", "found nan"),
    ):
        (tmp_path / "rigs.txt").write_text(text)
        assert words in refused(tmp_path)


def test_a_lens_that_cannot_be_undone_and_depths_that_are_none() -> None:
    cameras = rig(lens=(0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))  # its picture ends half a focal length from the middle
    assert np.isnan(cameras[0].rays((0.0, 0.0))[:2]).all()
    assert np.isfinite(cameras[0].rays((310.0, 240.0))).all()
    wild = [replace(camera, principal_point=(9e4, 9e4)) for camera in cameras]
    with pytest.raises(LightFieldError, match="its distortion cannot be undone"):
        fit_rig(wild)
    with pytest.raises(LightFieldError, match="0 < near < far"):
        fit_rig(rig(), depths=(0.0, 1.0))
    same = [replace(camera, translation=np.asarray(rig()[n // 2 * 3].translation)) for n, camera in enumerate(rig())]
    straight = [replace(camera, rotation=np.eye(3), name=f"{n}") for n, camera in enumerate(same)]
    with pytest.raises(LightFieldError, match="stand where others do"):
        fit_rig(straight)
