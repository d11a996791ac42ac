"""Calibrations of devices and data sets, written as these do, and units of lengths."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lfgpu.calibration import Camera, read_calibration, rectify
from lfgpu.calibration.cameras import turned
from lfgpu.errors import LightFieldError
from tests.calibration.rigs import rig


def _vector(camera: Camera) -> list[float]:
    from scipy.spatial.transform import Rotation

    return list(map(float, Rotation.from_matrix(np.asarray(camera.rotation)).as_rotvec()))


def _same(found: Camera, camera: Camera) -> None:
    pixels = np.array([[10.0, 20.0], [300.0, 200.0]])
    np.testing.assert_allclose(found.rays(pixels), camera.rays(pixels), atol=1e-9)
    np.testing.assert_allclose(found.rotation, camera.rotation, atol=1e-9)
    np.testing.assert_allclose(found.centre, camera.centre, atol=1e-9)
    assert found.size == camera.size


def test_models_of_google(tmp_path: Path) -> None:
    cameras = rig()
    entries = [
        {
            "relative_path": f"cam_{n:02d}/image_000.JPG",
            "width": c.size[1],
            "height": c.size[0],
            "focal_length": c.focal_length[0],
            "pixel_aspect_ratio": c.focal_length[1] / c.focal_length[0],
            "principal_point": [x + 0.5 for x in c.principal_point],
            "orientation": _vector(c),
            "position": c.centre.tolist(),
        }
        for n, c in enumerate(cameras)
    ]
    (tmp_path / "models.json").write_text(json.dumps([entries]))
    found = read_calibration(tmp_path / "models.json")
    assert (found.format, found.cameras[1].name) == ("Google", "cam_01/image_000.JPG")
    for one, c in zip(found.cameras, cameras, strict=True):
        np.testing.assert_allclose(one.centre, c.centre, atol=1e-9)
        np.testing.assert_allclose(one.rotation, c.rotation, atol=1e-9)
        np.testing.assert_allclose(one.principal_point, c.principal_point)
    del entries[0]["height"]
    (tmp_path / "models.json").write_text(json.dumps(entries))
    with pytest.raises(LightFieldError, match=r"models.json has no height\."):
        read_calibration(tmp_path / "models.json")


def _oak(to: int, shift: tuple[float, float, float], turn: Any) -> dict[str, Any]:
    return {
        "cameraType": 0,
        "width": 640,
        "height": 400,
        "intrinsicMatrix": [[450.0, 0, 320.0], [0, 450.0, 200.0], [0, 0, 1]],
        "distortionCoeff": [0.1, -0.05, 0, 0, 0.01, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        "extrinsics": {
            "rotationMatrix": np.asarray(turn).tolist(),
            "translation": dict(zip("xyz", shift, strict=True)),
            "toCameraSocket": to,
        },
    }


def test_depthai(tmp_path: Path) -> None:
    turn = turned([0.01, 0.02, -0.03])
    data = [
        [0, _oak(-1, (0, 0, 0), np.eye(3))],
        [1, _oak(2, (7.5, 0, 0), np.eye(3))],
        [2, _oak(0, (-3.75, 0, 0.1), turn)],
    ]
    (tmp_path / "calib.json").write_text(json.dumps({"boardName": "OAK-D", "cameraData": data}))
    found = read_calibration(tmp_path / "calib.json")
    assert found.format == "depthai"
    centres = [camera.centre for camera in found.cameras]
    np.testing.assert_allclose(centres[0], 0, atol=1e-12)
    np.testing.assert_allclose(centres[2], [-0.0375, 0, 0.001], atol=1e-9)
    np.testing.assert_allclose(centres[1], turn @ [0.075, 0, 0] + centres[2], atol=1e-9)
    assert found.cameras[0].distortion == (0.1, -0.05, 0, 0, 0.01, 0, 0, 0)
    np.testing.assert_allclose(
        read_calibration(tmp_path / "calib.json", unit="cm").cameras[2].centre, centres[2], atol=1e-12
    )
    data[2][1]["extrinsics"]["toCameraSocket"] = 1
    (tmp_path / "calib.json").write_text(json.dumps({"cameraData": data}))
    with pytest.raises(LightFieldError, match="socket 1 lead to no camera"):
        read_calibration(tmp_path / "calib.json")


@pytest.mark.parametrize(("m", "d"), [("M", "D"), ("cameraMatrix", "distCoeffs")])
def test_stereo_of_opencv(m: str, d: str, tmp_path: Path) -> None:
    turn = turned([0.0, 0.02, 0.0])
    table = {
        f"{m}1": [[500, 0, 320], [0, 500, 240], [0, 0, 1]],
        f"{d}1": [-0.1, 0.02, 0, 0, 0],
        f"{m}2": [[510, 0, 321], [0, 510, 239], [0, 0, 1]],
        f"{d}2": [0, 0, 0, 0, 0],
        "R": turn.tolist(),
        "T": [[-60.0], [0.0], [0.0]],
    }
    (tmp_path / "stereo.json").write_text(json.dumps(table))
    with pytest.raises(LightFieldError, match="add image_width and image_height"):
        read_calibration(tmp_path / "stereo.json")
    (tmp_path / "stereo.json").write_text(json.dumps({**table, "image_width": 640, "image_height": 480}))
    left, right = read_calibration(tmp_path / "stereo.json", unit="mm").cameras
    assert (left.size, right.focal_length, right.distortion) == ((480, 640), (510.0, 510.0), ())
    np.testing.assert_allclose(right.centre, turn.T @ [0.06, 0, 0], atol=1e-12)


def test_transforms_of_nerf_have_an_angle_and_no_size(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    Image.fromarray(np.zeros((60, 80, 3), np.uint8)).save(tmp_path / "train" / "r_0.png")
    frame = {"file_path": "./train/r_0", "rotation": 0.01, "transform_matrix": np.eye(4).tolist()}
    table = {"camera_angle_x": 0.8, "frames": [frame]}
    (tmp_path / "transforms_train.json").write_text(json.dumps(table))
    (camera,) = read_calibration(tmp_path / "transforms_train.json").cameras
    assert camera.size == (60, 80)
    assert camera.name == "./train/r_0.png"
    assert camera.focal_length[0] == pytest.approx(40 / math.tan(0.4))
    frame["file_path"] = "./train/r_1"
    (tmp_path / "transforms_train.json").write_text(json.dumps(table))
    with pytest.raises(LightFieldError, match="no w and h"):
        read_calibration(tmp_path / "transforms_train.json")


def test_units_of_lengths(tmp_path: Path) -> None:
    test_stereo_of_opencv("M", "D", tmp_path)
    metres = read_calibration(tmp_path / "stereo.json", unit="m").cameras[1].centre
    np.testing.assert_allclose(read_calibration(tmp_path / "stereo.json", unit="cm").cameras[1].centre, metres / 100)
    with pytest.raises(LightFieldError, match="unit must be one of mm, cm, m, not 'inch'"):
        read_calibration(tmp_path / "stereo.json", unit="inch")


def test_a_calibration_in_millimetres(tmp_path: Path) -> None:
    """Lengths that are no metres are doubted; with their unit, depths come out in metres."""
    cameras = rig()
    steps = [camera.centre for camera in cameras]
    scale = 1000 * 0.05 / float(np.linalg.norm(steps[1] - steps[0]))
    lines = []
    for number, camera in enumerate(cameras):
        Image.fromarray(np.full((*camera.size, 3), 9 * number, np.uint8)).save(tmp_path / f"{camera.name}.png")
        lines += [
            f'[[cameras]]\nname = "{camera.name}.png"\nsize = {list(camera.size)}\n'
            f"focal_length = {list(camera.focal_length)}\nprincipal_point = {list(camera.principal_point)}\n"
            f"distortion = {list(camera.distortion)}\nrotation = {np.asarray(camera.rotation).tolist()}\n"
            f"translation = {(scale * np.asarray(camera.translation)).tolist()}"
        ]
    (tmp_path / "cameras.toml").write_text("\n".join(lines))
    wrong = rectify(tmp_path)
    assert "probably no metres" in " ".join(wrong.light_field.notes)
    right = rectify(tmp_path, unit="mm")
    assert "probably no metres" not in " ".join(right.light_field.notes)
    assert right.light_field.geometry is not None
    assert wrong.light_field.geometry is not None
    assert wrong.light_field.geometry.baseline_m == pytest.approx(1000 * right.light_field.geometry.baseline_m)
