"""Depth goes back to the original picture of a camera: a plane that was built in is found there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfgpu.calibration import Camera, rectify, write_cameras
from lfgpu.calibration.cameras import turned
from lfgpu.calibration.formats import Calibration
from lfgpu.calibration.resample import pixels
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError

SIZE = (60, 80)
NORMAL, OFFSET = np.array([0.1, -0.2, 1.0]), 2.0  # the plane of points X with NORMAL X = OFFSET, in the world


def rig(rng: np.random.Generator, *, ahead: float) -> list[Camera]:
    """Nine cameras that are turned a little, with lenses, about a plane."""
    found = []
    for n in range(9):
        rotation = turned(0.02 * rng.normal(size=3))
        centre = np.array([0.05 * (n % 3), 0.05 * (n // 3), ahead * rng.normal()])
        found.append(
            Camera(
                size=SIZE,
                focal_length=(90.0, 91.0),
                principal_point=(40.0, 29.0),
                distortion=(-0.1, 0.02, 0.001, -0.001),
                rotation=rotation,
                translation=-rotation @ centre,
                name=f"camera {n}",
            )
        )
    return found


def depth_of_the_plane(camera: Camera) -> np.ndarray:
    """Return the depth of the plane along the camera's own axis."""
    rays = camera.rays(pixels(*SIZE)) @ np.asarray(camera.rotation)
    return (OFFSET - NORMAL @ camera.centre) / (rays @ NORMAL)


@pytest.mark.parametrize(("ahead", "close"), [(0.0, 0.004), (0.004, 0.006)])
@pytest.mark.parametrize("index", [4, 0])
def test_a_plane_is_found_in_the_picture_as_it_was(ahead: float, close: float, index: int) -> None:
    cameras = rig(np.random.default_rng(0), ahead=ahead)
    views = np.random.default_rng(1).integers(0, 255, (9, *SIZE, 1)).astype(np.uint8)
    pictures = LightField(views, np.stack([np.arange(9), np.zeros(9)], 1), name="rig")
    found = rectify(pictures, calibration=Calibration(tuple(cameras), "rig", "lfgpu"), depths=(1.5, 2.5))
    lf, known = found.light_field, found.rig
    assert known is not None
    # The true map of a rectified view: where its rays meet the plane, seen from the common frame.
    geometry = known.geometry
    assert geometry.principal_point is not None
    place = lf.positions[index]
    shift = place * geometry.baseline_m * geometry.focal_length_px / geometry.focus_distance_m
    plane = (pixels(*SIZE) - geometry.principal_point - shift) / geometry.focal_length_px
    rays = np.concatenate([plane, np.ones((*SIZE, 1))], -1) @ known.rotation
    centre = cameras[index].centre - known.ahead[index] * known.rotation[2]
    true = geometry.disparity((OFFSET - NORMAL @ centre) / (rays @ NORMAL)).astype(np.float32)
    true[:, :5] = np.nan
    result = DisparityMap(true, position=(float(place[0]), float(place[1])))
    depth = found.original_depth(result)
    there = np.isfinite(depth)
    assert 0.6 < there.mean() < 0.97
    np.testing.assert_allclose(depth[there], depth_of_the_plane(cameras[index])[there], rtol=close)
    assert abs(np.median(depth[there] / depth_of_the_plane(cameras[index])[there]) - 1) < 5e-4


def test_depths_are_in_the_unit_of_the_calibration(rng: np.random.Generator, tmp_path: Path) -> None:
    cameras = rig(rng, ahead=0.001)
    views = rng.integers(0, 255, (9, *SIZE, 1)).astype(np.uint8)
    pictures = LightField(views, np.stack([np.arange(9), np.zeros(9)], 1), name="rig")
    far = [replace(camera, translation=1000 * np.asarray(camera.translation)) for camera in cameras]
    write_cameras(far, tmp_path / "cameras.toml")
    found = rectify(pictures, calibration=tmp_path / "cameras.toml", unit="mm", depths=(1500, 2500))
    want = rectify(pictures, calibration=Calibration(tuple(cameras), "rig", "lfgpu"), depths=(1.5, 2.5))
    assert found.disparity_range == pytest.approx(want.disparity_range)
    assert found.rig is not None
    assert want.rig is not None
    assert found.rig.corrected_at == pytest.approx(want.rig.corrected_at)


def test_without_a_calibration_there_is_no_original(rng: np.random.Generator) -> None:
    cameras = rig(rng, ahead=0.0)
    views = rng.integers(0, 255, (9, *SIZE, 1)).astype(np.uint8)
    pictures = LightField(views, np.stack([np.arange(9), np.zeros(9)], 1), name="rig")
    found = rectify(pictures, calibration=Calibration(tuple(cameras), "rig", "lfgpu"))
    map_ = DisparityMap(np.zeros(SIZE, np.float32))
    with pytest.raises(LightFieldError, match="was not rectified"):
        replace(found, rig=None).original_depth(map_)
    with pytest.raises(LightFieldError, match="the map must be of"):
        found.original_depth(replace(map_, disparity=map_.disparity[:3]))
