"""Scenes for COLMAP and nerfstudio, calibrations of devices and data sets, and units of lengths."""

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.calibration import camera_info, export_scene, read_calibration, rectify, write_cameras
from lfgpu.calibration.cameras import turned
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.cli import app
from lfgpu.data import DisparityMap, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import write_hci, write_pfm
from tests.calibration.rigs import rig


@cache
def scene() -> LightField:
    return scenes.make("planes", grid=(3, 3), size=(48, 60), seed=1)


def true_map() -> DisparityMap:
    lf = scene()
    known = lf.truth.disparity.copy()
    known[:4] = np.nan
    return DisparityMap(known, np.ones_like(known), position=lf.truth.position, geometry=lf.geometry)


@pytest.mark.parametrize("file", ["transforms.json", "sparse/0"])
def test_cameras_come_back(file: str, tmp_path: Path) -> None:
    export_scene(scene(), true_map(), tmp_path / "out")
    found = read_calibration(tmp_path / "out" / file).cameras
    pixels = np.random.default_rng(0).uniform(0, 40, (20, 2))
    for camera, want in zip(found, ideal_cameras(scene()), strict=True):
        np.testing.assert_allclose(camera.rays(pixels), want.rays(pixels), rtol=0, atol=1e-9)
        np.testing.assert_allclose(camera.centre, want.centre, rtol=0, atol=1e-12)


def test_points_are_seen_where_the_depth_says(tmp_path: Path) -> None:
    """Every point lands on its pixel in the reference, at its depth, with its colour."""
    lf = scene()
    export_scene(lf, true_map(), tmp_path / "out")
    points = trimesh.load(tmp_path / "out" / "points.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    place = np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float64)
    camera = read_calibration(tmp_path / "out" / "transforms.json").cameras[lf.reference_index]
    at = camera.project((place - camera.centre) @ np.asarray(camera.rotation).T)
    x, y = np.rint(at).astype(int).T
    np.testing.assert_allclose(at, np.stack([x, y], 1), rtol=0, atol=1e-3)
    view = np.asarray(Image.open(tmp_path / "out" / "images" / "view_004.png"))
    np.testing.assert_array_equal(view[y, x, 0], points["red"])
    np.testing.assert_array_equal(view, lf.views[4])
    frame = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"][4]
    depth = np.asarray(Image.open(tmp_path / "out" / frame["depth_file_path"])).astype(np.float64) / 1000
    np.testing.assert_allclose(depth[y, x], place[:, 2], rtol=0, atol=6e-4)
    assert (depth[:4] == 0).all()
    head, rest = (tmp_path / "out/stereo/depth_maps/view_004.png.geometric.bin").read_bytes().split(b"&1&", 1)
    assert head == b"60&48"
    np.testing.assert_allclose(np.frombuffer(rest, "<f4").reshape(48, 60)[y, x], place[:, 2], rtol=1e-5)


def test_all_views_have_depth_and_share_a_world(tmp_path: Path) -> None:
    lf = scene()
    maps = lfgpu.estimate_all_views(lf, config="fast", disparity_range=(-2, 2), device="cpu")
    export_scene(lf, maps, tmp_path / "out")
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    assert all((tmp_path / "out" / frame["depth_file_path"]).is_file() for frame in frames)
    # The middle of view 0, by its depth, is a point that view 8 shows at the same depth.
    cameras = read_calibration(tmp_path / "out" / "transforms.json").cameras
    depths = [np.asarray(Image.open(tmp_path / "out" / f["depth_file_path"])).astype(float) / 1000 for f in frames]
    y, x = np.mgrid[12:36, 15:45]
    pixels = np.stack([x, y], -1).reshape(-1, 2)
    world = cameras[0].rays(pixels) * depths[0][pixels[:, 1], pixels[:, 0]][:, None] + cameras[0].centre
    seen = world - cameras[8].centre
    there = np.rint(cameras[8].project(seen)).astype(int)
    inside = ((there >= 0) & (there < (60, 48))).all(1)
    close = np.abs(depths[8][there[inside, 1], there[inside, 0]] / seen[inside, 2] - 1) < 0.05
    assert close.mean() > 0.8


def test_the_camera_in_terms_of_ros_and_opencv() -> None:
    assert scene().geometry is not None
    geometry = replace(scene().geometry, pixel_aspect=1.25)  # type: ignore[type-var]
    lf = replace(scene(), geometry=geometry)
    for index in (lf.reference_index, 0):
        info = camera_info(lf, index)
        assert (info.width, info.height, info.distortion_model, len(info.d)) == (60, 48, "plumb_bob", 5)
        q = np.array(info.q).reshape(4, 4)
        disparity = np.random.default_rng(1).uniform(-1, 1, (48, 60))
        y, x = np.mgrid[:48, :60]
        homogeneous = np.stack([x, y, disparity, np.ones_like(disparity)], -1) @ q.T
        points = homogeneous[..., :3] / homogeneous[..., 3:]
        np.testing.assert_allclose(points[..., 2], geometry.depth(disparity), rtol=1e-9)
        k, p = np.array(info.k).reshape(3, 3), np.array(info.p).reshape(3, 4)
        pixel = points @ k.T
        np.testing.assert_allclose(pixel[..., :2] / pixel[..., 2:], np.stack([x, y], -1), rtol=0, atol=1e-9)
        centre = -p[:2, 3] / (p[0, 0], p[1, 1])
        np.testing.assert_allclose(centre, geometry.centres(lf.offsets[[index]])[0], rtol=0, atol=1e-12)


def test_the_command_and_what_is_refused(tmp_path: Path) -> None:
    lf = scene()
    write_hci(lf, tmp_path / "lf")
    write_pfm(tmp_path / "map.pfm", true_map().disparity)
    command = ["export-scene", str(tmp_path / "lf"), "-o", str(tmp_path / "out"), "--maps", str(tmp_path / "map.pfm")]
    outcome = CliRunner().invoke(app, command)
    assert outcome.exit_code == 0, outcome.output
    assert (tmp_path / "out" / "sparse" / "0" / "cameras.bin").is_file()
    with pytest.raises(LightFieldError, match="has no geometry"):
        export_scene(replace(lf, geometry=None), true_map(), tmp_path / "none")
    with pytest.raises(LightFieldError, match="the map must be 48 x 60"):
        export_scene(lf, DisparityMap(true_map().disparity[:9]), tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(("times", "unit"), [(1000.0, 1.0), (0.001, 1e-6)])
def test_depth_pictures_of_a_unit_that_holds_the_scene(times: float, unit: float, tmp_path: Path) -> None:
    """Millimetres hold depths from about 0.65 to 65 m; another unit is written down and told."""
    lf, one = scene(), true_map()
    focus = lf.geometry.focus_distance_m * times
    geometry = replace(lf.geometry, baseline_m=lf.geometry.baseline_m * times, focus_distance_m=focus)
    one = replace(one, geometry=geometry)
    notes = export_scene(replace(lf, geometry=geometry), one, tmp_path / "out")
    found = json.loads((tmp_path / "out" / "transforms.json").read_text())["depth_unit_scale_factor"]
    assert found == pytest.approx(unit)
    assert any("Depth pictures are in units of" in note for note in notes)
    name = f"view_{lf.reference_index:03d}.png"
    stored = np.asarray(Image.open(tmp_path / "out" / "depths" / name)).astype(float) * found
    known = np.isfinite(one.depth) & (stored > 0)
    assert known.mean() > 0.85
    np.testing.assert_allclose(stored[known], one.depth[known], atol=found)


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
            "orientation": Rotation.from_matrix(np.asarray(c.rotation)).as_rotvec().tolist(),
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
    translation = dict(zip("xyz", shift, strict=True))
    return {
        **{"cameraType": 0, "width": 640, "height": 400},
        "intrinsicMatrix": [[450.0, 0, 320.0], [0, 450.0, 200.0], [0, 0, 1]],
        "distortionCoeff": [0.1, -0.05, 0, 0, 0.01, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        "extrinsics": {"rotationMatrix": np.asarray(turn).tolist(), "translation": translation, "toCameraSocket": to},
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
    again = read_calibration(tmp_path / "calib.json", unit="cm").cameras[2]
    np.testing.assert_allclose(again.centre, centres[2], atol=1e-12)
    data[2][1]["extrinsics"]["toCameraSocket"] = 1
    (tmp_path / "calib.json").write_text(json.dumps({"cameraData": data}))
    with pytest.raises(LightFieldError, match="socket 1 lead to no camera"):
        read_calibration(tmp_path / "calib.json")


@pytest.mark.parametrize(("m", "d"), [("M", "D"), ("cameraMatrix", "distCoeffs")])
def test_stereo_of_opencv_in_each_unit(m: str, d: str, tmp_path: Path) -> None:
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
    for unit, metres in (("mm", 0.001), ("cm", 0.01), ("m", 1)):
        left, right = read_calibration(tmp_path / "stereo.json", unit=unit).cameras
        np.testing.assert_allclose(right.centre, turn.T @ [60 * metres, 0, 0], atol=1e-9)
    assert (left.size, right.focal_length, right.distortion) == ((480, 640), (510.0, 510.0), ())
    with pytest.raises(LightFieldError, match="unit must be one of mm, cm, m, not 'inch'"):
        read_calibration(tmp_path / "stereo.json", unit="inch")


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


def test_a_calibration_in_millimetres(tmp_path: Path) -> None:
    """Lengths that are no metres are doubted; with their unit, depths come out in metres."""
    cameras = [replace(camera, translation=500 * np.asarray(camera.translation)) for camera in rig()]
    for number, camera in enumerate(cameras):
        Image.fromarray(np.full((*camera.size, 3), 9 * number, np.uint8)).save(tmp_path / camera.name)
    write_cameras(cameras, tmp_path / "cameras.toml")
    wrong = rectify(tmp_path)
    assert "probably no metres" in " ".join(wrong.light_field.notes)
    right = rectify(tmp_path, unit="mm")
    assert "probably no metres" not in " ".join(right.light_field.notes)
    assert wrong.light_field.geometry.baseline_m == pytest.approx(1000 * right.light_field.geometry.baseline_m)
