"""Pictures and the 3D view: colours, scales, units, undefined pixels, whole squares; black corners."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image
from walls import SIZE

import lfgpu
from lfgpu import LightField, scenes
from lfgpu.data import DisparityMap, Geometry
from lfgpu.errors import LightFieldError
from lfgpu.io import write_hci
from lfgpu.io.brightness import without_black_corners
from lfgpu.viewer.cloud import Cloud, nearest_to_ray, shown_cloud, surface
from lfgpu.viewer.space import framed
from lfgpu.viz.colours import LOOKS, UNDEFINED, indices, painted, palette, shades
from lfgpu.viz.pictures import beside_scale, draw_map, save_picture, ticks, write_confidence, write_disparity
from lfgpu.viz.sheets import overview

SHAPE = (30, 40)


def ramp(low: float = -1.0, high: float = 2.0) -> np.ndarray:
    return np.linspace(low, high, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)


def greys(picture: Image.Image) -> int:
    return int((np.asarray(picture.convert("RGB")) == UNDEFINED).all(axis=2).sum())


def test_compared_maps_share_a_scale_and_errors_have_zero_in_the_middle() -> None:
    """An error of 0.05 everywhere is 0.05 of 0.07, at which all scales of errors end; the truth has no error."""
    sheet = np.asarray(overview(np.zeros((*SHAPE, 3)), ramp() + 0.05, ramp(), title="a title"))
    wanted = painted(np.full((1, 1), 0.05, np.float32), LOOKS["error"].colours, (-0.07, 0.07))[0, 0]
    size = math.ceil(900 / max(SHAPE))
    assert (sheet == wanted).all(axis=2).sum() >= SHAPE[0] * SHAPE[1] * size**2
    lowest = painted(np.full((1, 1), -1.0, np.float32), "viridis", (-1.0, 2.0))[0, 0]
    assert (sheet == lowest).all(axis=2).any()


def test_errors_outside_the_mask_and_in_the_border_are_grey() -> None:
    mask = np.ones(SHAPE, np.bool_)
    mask[:10] = False
    maps = (np.zeros((*SHAPE, 1)), ramp(), ramp())
    size = math.ceil(900 / max(SHAPE)) ** 2
    drawn = [greys(overview(*maps, title="", **options)) for options in ({}, {"mask": mask}, {"border": 5})]
    assert [n // size for n in drawn] == [0, 10 * SHAPE[1], SHAPE[0] * SHAPE[1] - 20 * 30]


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


@pytest.mark.parametrize("name", ["viridis", "cividis"])
def test_colours_are_those_of_matplotlib(name: str) -> None:
    colours = palette(name)[:239].astype(float)
    wanted = 255 * colormaps[name](np.linspace(0, 1, 239))[:, :3]
    assert np.abs(colours - wanted).max() < 6  # each fifth step is in the tables
    assert palette(name)[239].tolist() == list(UNDEFINED)
    assert palette(name)[240].tolist() == [255] * 3
    assert palette(name)[255].tolist() == [0] * 3


@pytest.mark.parametrize("name", ["magma", "RdBu_r", "viridis_r"])
def test_other_colours_come_from_matplotlib(name: str) -> None:
    np.testing.assert_array_equal(shades(name, 17), (255 * colormaps[name](np.linspace(0, 1, 17))[:, :3] + 0.5) // 1)


def test_scales_end_where_they_are_told() -> None:
    values = np.array([[-9, -1, 0, 1, 9, np.nan, np.inf, -np.inf]], np.float32)
    assert indices(values, (-1, 1)).tolist() == [[0, 0, 119, 238, 238, 239, 239, 239]]
    values = np.linspace(-1, 2, 1200, dtype=np.float32).reshape(30, 40)
    drawn = np.asarray(draw_map(values, title="", label="", colours="magma", limits=(-3, 3)))
    shown = drawn[drawn < 239]
    assert np.isin(indices(values, (-3, 3)), shown).all()
    assert palette("magma", (20, 23, 28))[[240, 255]].tolist() == [[20, 23, 28], [255] * 3]
    assert palette("magma", (200, 200, 180))[255].tolist() == [0] * 3


@pytest.mark.parametrize("shape", [(30, 40), (200, 10), (10, 200), (1, 1), (1000, 950)])
def test_each_pixel_of_a_map_is_a_whole_square(shape: tuple[int, int], tmp_path: Path) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    write_confidence(values, tmp_path / "a.png", name="noise")
    drawn, size = pixels(tmp_path / "a.png"), math.ceil(900 / max(shape))
    wanted = palette("cividis")[indices(values, (0.0, 1.0))].repeat(size, 0).repeat(size, 1)
    left, (height, width) = round(0.025 * size * max(shape)), wanted.shape[:2]
    tops = range(drawn.shape[0] - height + 1)
    assert any((drawn[top : top + height, left : left + width] == wanted).all() for top in tops)


@pytest.mark.parametrize("undefined", [np.nan, np.inf, -np.inf])
def test_undefined_pixels_are_grey(undefined: float, tmp_path: Path) -> None:
    values = np.linspace(-1, 2, 1200, dtype=np.float32).reshape(30, 40)
    write_disparity(values, tmp_path / "known.png", name="ramp")
    values[3, 4] = undefined
    write_disparity(values, tmp_path / "unknown.png", name="ramp")
    grey = [int((pixels(tmp_path / name) == UNDEFINED).all(2).sum()) for name in ("known.png", "unknown.png")]
    assert grey == [0, 23**2]


def test_an_end_of_the_bar_is_pointed_where_values_lie_beyond_it(tmp_path: Path) -> None:
    values = np.full((30, 40), 0.5, np.float32)
    heights = []
    for beyond in (0.5, 2.0, -2.0):
        values[0, 0] = beyond
        write_confidence(values, tmp_path / "a.png", name="flat")
        drawn = pixels(tmp_path / "a.png")
        bar = drawn.shape[1] - np.argmax((drawn[:, ::-1] == palette("cividis")[238]).all(2).any(0)) - 2
        ends = [(drawn[:, bar - 12] == palette("cividis")[index]).all(1).sum() for index in (238, 0)]
        heights.append(ends)
    assert heights[1][0] > heights[0][0] + 5
    assert heights[2][1] > heights[0][1] + 5


@pytest.mark.parametrize("value", [0.0, 2.5, 1e6, np.nan])
def test_a_map_of_one_value_can_be_drawn(value: float, tmp_path: Path) -> None:
    write_disparity(np.full((30, 40), value), tmp_path / "a.png", name="Ελλάδα $x$ \N{SNOWMAN} " + 50 * "long")
    assert min(pixels(tmp_path / "a.png").shape[:2]) > 500


@pytest.mark.parametrize(("low", "high", "wanted"), [(0, 1, 6), (-1.68, 1.48, 6), (-0.003, 0.002, 6), (3, 3.07, 8)])
def test_ticks_are_round_numbers_within_the_scale(low: float, high: float, wanted: int) -> None:
    found = ticks(low, high)
    assert len(found) == wanted
    assert low - 1e-9 <= found[0] < found[-1] <= high + 1e-9
    steps = np.diff(found)
    np.testing.assert_allclose(steps, steps[0])
    digits = steps[0] / 10 ** math.floor(math.log10(steps[0]) + 1e-9)
    assert min(abs(digits - round_one) for round_one in (1, 2, 2.5, 5)) < 1e-6


def test_what_cannot_be_drawn_or_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LightFieldError, match=r"a map must be \[y, x\]"):
        write_disparity(np.zeros((2, 3, 4)), tmp_path / "a.png", name="")
    (tmp_path / "file").write_text("")
    with pytest.raises(LightFieldError, match="cannot be written"):
        write_disparity(np.zeros((2, 3)), tmp_path / "file" / "a.png", name="")
    assert {path.name for path in tmp_path.iterdir()} == {"file"}
    with pytest.raises(LightFieldError, match=r"\[y, x\]"):
        overview(np.zeros((2, 3, 3)), np.zeros((2, 3, 4)), np.zeros((2, 3)), title="")
    with pytest.raises(LightFieldError, match="same size"):
        overview(np.zeros((*SHAPE, 3)), ramp(), ramp()[1:], title="")
    (tmp_path / "file").touch()
    with pytest.raises(LightFieldError, match="cannot be written"):
        save_picture(overview(np.zeros((*SHAPE, 3)), ramp(), ramp(), title=""), tmp_path / "file" / "x.png")


@pytest.mark.parametrize("size", [(29, 31), (480, 640)])
@pytest.mark.parametrize("paper", [(255, 255, 255), (20, 23, 28)])
def test_a_picture_beside_a_scale_keeps_its_pixels(
    size: tuple[int, int], paper: tuple[int, int, int], rng: np.random.Generator
) -> None:
    picture = rng.integers(0, 256, (*size, 3)).astype(np.uint8)
    drawn = beside_scale(picture, label="depth (m)", colours="magma", limits=(1, 2), extent=(1, 3), paper=paper)
    found = np.asarray(drawn)
    assert found.shape[0] == size[0]
    np.testing.assert_array_equal(found[:, : size[1]], picture)
    assert tuple(found[0, -1]) == paper


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


OF_A_VIEW = 64


def round_views(lf: LightField, corners: str = "all") -> tuple[LightField, np.ndarray]:
    """The views as a round lens shows them, and where it shows nothing."""
    y, x = np.mgrid[:OF_A_VIEW, :OF_A_VIEW] - (OF_A_VIEW - 1) / 2
    black = np.hypot(y, x) > 0.6 * OF_A_VIEW
    if corners == "three":
        black &= (y < 0) | (x < 0)
    return replace(lf, views=np.where(black[..., None], np.uint8(2), lf.views)), black


@pytest.fixture(scope="module")
def scene() -> LightField:
    return scenes.make("relief", grid=(5, 5), size=(OF_A_VIEW, OF_A_VIEW))


def test_black_corners_are_left_out_and_said(scene: LightField) -> None:
    lf, black = round_views(scene)
    found = without_black_corners(lf)
    assert not found.valid[:, black].any()
    assert found.valid.mean() > 0.95 * (1 - black.mean())
    assert found.valid[:, 20:-20, 20:-20].all()
    assert "corners are black" in found.notes[-1]


def ratio_beside_them(scene: LightField) -> float:
    """The mean error of the map beside black corners over that of the map of whole views; they are not trusted."""
    lf = without_black_corners(round_views(scene)[0])
    there = lf.valid[lf.reference_index]
    whole, left = (lfgpu.estimate_depth(each, config="accurate", disparity_range=(-1.6, 1.7)) for each in (scene, lf))
    assert (left.confidence[~there] == 0).all()
    errors = [np.abs(result.disparity - scene.truth.disparity)[there].mean() for result in (whole, left)]
    return float(errors[1] / errors[0])


def test_without_them_the_maps_of_four_scenes_are_right_in_the_mean() -> None:
    made = (scenes.make("relief", grid=(5, 5), size=(OF_A_VIEW, OF_A_VIEW), seed=seed) for seed in range(4))
    assert np.mean([ratio_beside_them(scene) for scene in made]) < 1.1


@pytest.mark.parametrize("what", ["nothing black", "three corners", "mask given", "one view not", "all black", "few"])
def test_everything_else_stays_as_it_is(scene: LightField, what: str) -> None:
    lf, _ = round_views(scene, "three" if what == "three corners" else "all")
    views = lf.views.copy()
    if what == "nothing black":
        lf = scene
    elif what == "mask given":
        lf = replace(lf, valid=np.ones(lf.views.shape[:3], bool))
    elif what == "one view not":
        views[3, 0, 0] = 90
        lf = replace(lf, views=views)
    elif what == "all black":
        lf = replace(lf, views=np.zeros_like(views))
    elif what == "few":
        views = np.maximum(scene.views, 9)
        views[:, :: OF_A_VIEW - 1, :: OF_A_VIEW - 1] = 0
        lf = replace(scene, views=np.tile(views, (1, 4, 4, 1))[:, : 4 * OF_A_VIEW, : 4 * OF_A_VIEW], truth=None)
        lf = replace(lf, views=np.maximum(lf.views, 9))
        lf.views[:, [0, 0, -1, -1], [0, -1, 0, -1]] = 0
    assert without_black_corners(lf) is lf


def test_reading_finds_them(scene: LightField, tmp_path: Path) -> None:
    write_hci(round_views(scene)[0], tmp_path / "round")
    lf = lfgpu.read(tmp_path / "round")
    assert lf.valid is not None
    assert any("corners are black" in note for note in lf.notes)
