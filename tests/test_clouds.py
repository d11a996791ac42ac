"""The 3D view: where points stand, the surface between them, and what the first eye sees."""

import numpy as np
import pytest
from walls import SIZE

from lfgpu.data.geometry import Geometry
from lfgpu.data.result import DisparityMap
from lfgpu.viewer.cloud import Cloud, nearest_to_ray, shown_cloud, surface
from lfgpu.viewer.space import framed


def test_points_stand_where_the_geometry_says() -> None:
    geometry = Geometry(focal_length_px=50.0, baseline_m=0.1, focus_distance_m=2.0)
    disparity = np.zeros(SIZE, np.float32)
    disparity[4, 7] = 5 * 0.5 - 5 / 2.0 + 5.0 / 1.0 - 5.0 / 2.0  # depth 1 m
    disparity[0, 0] = np.nan
    colours = np.zeros((*SIZE, 3), np.uint8)
    colours[4, 7] = 255
    cloud = shown_cloud(DisparityMap(disparity, geometry=geometry), colours)
    assert cloud.metric
    assert len(cloud.points) == SIZE[0] * SIZE[1] - 1
    (index,) = np.flatnonzero(cloud.colours[:, 0])
    np.testing.assert_allclose(cloud.points[index], [(7 - 15.5) / 50, (4 - 11.5) / 50, 1.0], rtol=1e-5)
    assert nearest_to_ray(cloud, (0, 0, 0), cloud.points[index]) == (7, 4)
    assert nearest_to_ray(cloud, (0, 0, 0), (0, 0, -1)) is None


def test_points_without_a_geometry_keep_the_order_of_disparities() -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    colours = np.zeros((*SIZE, 3), np.uint8)
    sure, unsure = (DisparityMap(disparity, np.full(SIZE, value, np.float32)) for value in (1, 0))
    cloud = shown_cloud(sure, colours, least_confidence=0.5)
    assert not cloud.metric
    assert (np.diff(cloud.points[:, 2]) <= 0).all()  # larger is nearer
    assert np.abs(cloud.points[:, 0]).max() == pytest.approx((SIZE[1] - 1) / 2 / SIZE[1])
    few = shown_cloud(sure, colours, most_points=100)
    assert 0 < len(few.points) <= 100
    assert set(map(tuple, few.pixels)) < set(map(tuple, cloud.pixels))
    assert shown_cloud(unsure, colours, least_confidence=0.5).points.shape == (0, 3)


@pytest.mark.parametrize("most_points", [10_000, 100])
def test_the_points_are_those_of_the_package(most_points: int) -> None:
    """Pixels that are not square, and frames that are shifted against another camera: metres count both."""
    geometry = Geometry(50.0, 0.1, 2.0, pixel_aspect=1.25, unshifted_at=(1.0, 0.0))
    disparity = np.random.default_rng(1).uniform(-1, 1, SIZE).astype(np.float32)
    values = DisparityMap(disparity, position=(4.0, 4.0), geometry=geometry)
    cloud = shown_cloud(values, np.zeros((*SIZE, 3), np.uint8), most_points=most_points)
    points = geometry.points(disparity, position=(4.0, 4.0))
    x, y = cloud.pixels.T
    np.testing.assert_allclose(cloud.points, points[y, x], rtol=1e-6)
    np.testing.assert_allclose(cloud.eye, [0.3, 0.4 / 1.25, 0.0])
    assert cloud.spacing > 0


def test_a_surface_has_no_sheets_across_edges() -> None:
    disparity = np.zeros(SIZE, np.float32)
    disparity[:, 16:] = 2.0
    disparity[5, 5] = np.nan
    cloud = shown_cloud(DisparityMap(disparity), np.zeros((*SIZE, 3), np.uint8))
    triangles = surface(cloud, disparity)
    sides = (cloud.pixels[:, 0] < 16)[triangles]
    assert (sides.all(axis=1) | ~sides.any(axis=1)).all()
    assert len(triangles) == 2 * ((SIZE[0] - 1) * (SIZE[1] - 2) - 4)
    towards = np.cross(*(cloud.points[triangles[:, k]] - cloud.points[triangles[:, 0]] for k in (1, 2)))
    assert (towards[:, 2] < 0).all()  # their fronts face the camera


def in_frame(cloud: Cloud, points: np.ndarray, aspect: float, cameras: np.ndarray | None = None) -> float:
    """How far from the middle of the first picture points are: 1 is the border. All must lie before the eye."""
    eye, target, fov = framed(cloud, aspect, cameras)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross([0, 1, 0], forward)
    right /= np.linalg.norm(right)
    relative = points - eye
    deep = relative @ forward
    assert (deep > 0).all()
    up = np.abs(relative @ np.cross(forward, right)) / deep
    beside = np.abs(relative @ right) / deep / aspect
    return float(max(up.max(), beside.max()) / np.tan(fov / 2))


@pytest.mark.parametrize("aspect", [0.5, 2.0])
@pytest.mark.parametrize(
    ("size", "near", "far", "unit"),
    [
        (SIZE, -1.0, 1.0, 1.0),
        ((30, 160), -1.0, 1.0, 1.0),  # wide
        (SIZE, -1.5, 60.0, 1.0),  # deep
        (SIZE, -1.0, 1.0, 1e-4),  # tiny
    ],
    ids=["ramp", "wide", "deep", "tiny"],
)
def test_the_first_eye_sees_the_whole_cloud(
    size: tuple[int, int], near: float, far: float, unit: float, aspect: float
) -> None:
    disparity = np.linspace(near, 1, size[0] * size[1], dtype=np.float32).reshape(size)
    disparity[-size[0] // 5 :] = far  # what stands in front
    geometry = Geometry(50.0, 0.1 * unit, 2.0 * unit)
    cloud = shown_cloud(DisparityMap(disparity, geometry=geometry), np.zeros((*size, 3), np.uint8))
    assert 0.85 < in_frame(cloud, cloud.points, aspect) < 1.05


@pytest.mark.parametrize("baseline", [0.01, 0.1, 2.0])
def test_the_first_eye_sees_all_cameras(baseline: float) -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    geometry = Geometry(50.0, baseline, 2.0)
    cloud = shown_cloud(DisparityMap(disparity, geometry=geometry), np.zeros((*SIZE, 3), np.uint8))
    cameras = np.array([(baseline * u, baseline * v, 0.0) for u in (-4, 0, 4) for v in (-4, 0, 4)])
    assert in_frame(cloud, cameras, 1.5, cameras) < 1.0
