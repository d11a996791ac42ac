"""The test scenes: is what they call true the truth, and are the views what cameras would see of it?"""

import inspect
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lfgpu import scenes
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.scenes import synthesis
from lfgpu.scenes.lamps import Lamps, lit
from lfgpu.scenes.objects import Box, Disc, Ellipsoid, Frustum, Quad, Rays, Relief, Wall
from lfgpu.scenes.render import Frame, Thing
from lfgpu.scenes.texture import Painter, Texture
from tests.made import thorough

SMALL: dict[str, Any] = {"grid": (3, 3), "size": (96, 112)}
SLOPES = [(0.0, 0.0), (0.11, -0.07), (-0.3, 0.2)]


def truth_of(field: LightField) -> np.ndarray:
    truth = field.reference_truth()
    return truth.disparity


def sampled(image: np.ndarray, x: np.ndarray, y: np.ndarray, order: int = 3) -> np.ndarray:
    """`image` [y, x] between its pixels, by splines of that order; NaN outside."""
    return map_coordinates(image.astype(np.float64), [y, x], order=order, mode="constant", cval=np.nan)


# --- shapes: where rays hit them ---

EDGES = np.array([[0.30, 0.05, -0.02], [-0.04, 0.24, 0.06], [0.05, -0.06, 0.21]])
CENTRE = np.array([0.03, -0.02, 0.5])


@pytest.mark.parametrize("slope", SLOPES)
@pytest.mark.parametrize("kind", [Ellipsoid, Box, Frustum])
def test_solids_are_hit_where_marching_along_the_ray_first_gets_inside(kind: Any, slope: tuple[float, float]) -> None:
    line = np.linspace(-0.6, 0.6, 25)
    rays = Rays(line[None], line[:, None], slope)
    hit = (kind(CENTRE, EDGES, 0.2) if kind is Frustum else kind(CENTRE, EDGES)).hit(rays)
    steps = np.linspace(1.2, -0.2, 1401)[:, None, None]
    x, y, t = np.broadcast_arrays(rays.x + steps * slope[0], rays.y + steps * slope[1], steps)
    q = np.einsum("ij,j...->i...", np.linalg.inv(EDGES), np.stack([x, y, t]) - CENTRE[:, None, None, None])
    if kind is Frustum:
        inside = (np.hypot(q[0], q[2]) <= 1 + 0.2 * q[1]) & (np.abs(q[1]) <= 1)
    else:
        inside = ((q**2).sum(0) if kind is Ellipsoid else np.abs(q).max(0)) <= 1
    met = inside.any(0)
    marched = steps.ravel()[inside.argmax(0)]
    assert met.sum() > 50
    assert (~np.isnan(hit) | ~met).all()  # none is missed
    assert np.all((hit - marched)[met] >= -1e-12)
    assert np.all((hit - marched)[met] <= 0.001 + 1e-12)


@pytest.mark.parametrize("slope", SLOPES)
def test_bounds_hold_all_hits_and_are_tight(slope: tuple[float, float]) -> None:
    flat = EDGES.copy()
    flat[:, 2] = (0.0, 0.0, 1.0)
    x, y = np.linspace(-0.9, 0.9, 601)[None], np.linspace(-0.9, 0.9, 601)[:, None]
    for shape in (Ellipsoid(CENTRE, EDGES), Box(CENTRE, EDGES), Quad(CENTRE, flat), Disc(CENTRE, flat)):
        rows, columns = np.nonzero(~np.isnan(shape.hit(Rays(x, y, slope))))
        found = x[0, columns.min()], x[0, columns.max()], y[rows.min(), 0], y[rows.max(), 0]
        slack = (np.array(found) - shape.bounds(slope)) * (1, -1, 1, -1)
        assert slack.min() >= 0
        assert slack.max() < 0.03


@pytest.mark.parametrize("slope", SLOPES)
def test_flat_shapes_lie_in_their_plane(slope: tuple[float, float]) -> None:
    b, c = 0.4, -0.3
    edges = np.array([[0.3, 0.0, 0.0], [0.0, 0.2, 0.0], [0.3 * b, 0.2 * c, 1.0]])
    line = np.linspace(-0.5, 0.5, 41)
    rays = Rays(line[None], line[:, None], slope)
    for kind in (Wall, Quad, Disc):
        t = kind(CENTRE, edges).hit(rays)
        x, y = rays.x + t * slope[0], rays.y + t * slope[1]
        plane = CENTRE[2] + b * (x - CENTRE[0]) + c * (y - CENTRE[1])
        assert np.nanmax(np.abs(t - plane)) < 1e-14
        share = np.mean(~np.isnan(t))
        assert share == 1 if kind is Wall else 0.1 < share < 0.35


@pytest.mark.parametrize("slope", SLOPES)
def test_relief_is_hit_to_machine_precision_and_once(slope: tuple[float, float]) -> None:
    relief = Relief(0.5, np.array([[0.2, 5.0, 2.0, 0.3], [0.1, -4.0, 6.0, 1.0]]))
    assert relief.steepness(slope) < 0.8
    line = np.linspace(-0.6, 0.6, 61)
    rays = Rays(line[None], line[:, None], slope)
    t = relief.hit(rays)
    assert np.abs(t - relief.height(rays.x + t * slope[0], rays.y + t * slope[1])).max() < 1e-12
    steps = np.linspace(0, 1, 201)[:, None, None]
    above = steps - relief.height(rays.x + steps * slope[0], rays.y + steps * slope[1])
    assert np.all(np.diff(above, axis=0) > 0)


@pytest.mark.parametrize("taper", [0.0, -0.3, 0.25])
def test_normals_of_a_frustum_stand_on_its_side_and_its_end(taper: float) -> None:
    shape = Frustum(CENTRE, EDGES, taper)
    turn = np.linspace(0, 2 * np.pi, 9)
    q = np.array([0.0, 0.4, 0.0])[:, None] + (1 + 0.4 * taper) * np.array([np.cos(turn), 0 * turn, np.sin(turn)])
    around, along = (
        np.array([-np.sin(turn), 0 * turn, np.cos(turn)]),
        np.array([taper * np.cos(turn), 1 + 0 * turn, taper * np.sin(turn)]),
    )
    normals = shape.normals(CENTRE[:, None] + EDGES @ q)
    for tangent in (around, along):
        np.testing.assert_allclose((normals * (EDGES @ tangent)).sum(0), 0.0, atol=1e-12)
    assert ((normals * (EDGES @ q - EDGES @ [[0.0], [0.4], [0.0]])).sum(0) > 0).all()
    end = shape.normals(CENTRE[:, None] + EDGES @ [[0.3], [1.0], [0.1]])
    np.testing.assert_allclose(end.T @ EDGES[:, [0, 2]], 0.0, atol=1e-12)
    assert end[:, 0] @ EDGES[:, 1] > 0


def test_a_lamp_lights_a_wall_by_its_angle_and_a_disc_before_it_casts_a_shadow() -> None:
    """The light of each texel is computed by hand: where the line from it to the lamp crosses the disc's plane."""
    wall, disc = Wall(np.zeros(3), np.eye(3)), Disc(np.array([0.0, 0.0, 0.8]), np.diag([0.15, 0.15, 1.0]))
    white = Texture(np.ones((3, 1, 1), np.float32))
    slope = np.array([-0.5, 0.25])
    lamps = Lamps(slope[None], np.array([0.5]), ambient=0.2)
    things = lit([Thing(wall, white), Thing(disc, white)], lamps, 100, np.array([0.6, 0.5]))
    x, y = np.meshgrid(np.arange(-55.0, 56.0), np.arange(-45.0, 46.0))
    found = things[0].texture.sample(x.ravel(), y.ravel()).reshape(3, *x.shape)
    away = np.hypot(x / 100 + 0.8 * slope[0], y / 100 + 0.8 * slope[1]) - 0.15
    light = np.where(away < 0, 0.2, 0.2 + 0.5 / np.sqrt(1 + slope @ slope))
    clear = np.abs(away) > 0.02  # samples are a pixel apart
    np.testing.assert_allclose(found[0][clear], light[clear] ** (1 / 2.2), atol=1e-6)
    assert (away[clear] < 0).sum() > 300


def test_a_ray_along_a_box_face_is_a_miss_or_a_hit_but_no_warning() -> None:
    box = Box(np.array([0.0, 0.0, 0.5]), np.diag([0.2, 0.2, 0.1]))
    t = box.hit(Rays(np.array([[-0.3, -0.1, 0.1, 0.3]]), np.array([[0.0]]), (0.0, 0.0)))
    np.testing.assert_allclose(t, [[np.nan, 0.6, 0.6, np.nan]])


def test_the_rays_of_a_pixel_lie_around_its_centre_and_turn_with_the_offset() -> None:
    frame = Frame(10, 16, -1.0, 2.0)
    centres, fine = frame.rays((0.0, 0.0), 1), frame.rays((0.0, 0.0), 4)
    np.testing.assert_allclose(centres.x[0] * 10, np.arange(16) - 7.5)
    np.testing.assert_allclose(centres.y[:, 0] * 10, np.arange(10) - 4.5)
    np.testing.assert_allclose(fine.x.reshape(16, 4).mean(1), centres.x[0])
    np.testing.assert_allclose(np.diff(fine.y[:, 0]), 0.025)
    for d in (-1.0, 0.0, 2.0):  # x_middle = x + d * du, and so for y
        rays, t = frame.rays((3.0, -2.0), 1), (d + 1) / 3
        np.testing.assert_allclose((rays.x + t * rays.slope[0] - centres.x) * 10, 3 * d, atol=1e-12)
        np.testing.assert_allclose((rays.y + t * rays.slope[1] - centres.y) * 10, -2 * d, atol=1e-12)


# --- truth against pictures ---


def mismatch(field: LightField, sign: float) -> np.ndarray:
    """Reference view minus what the other views show where the truth (times `sign`) says the point is; [n, y, x]."""
    truth = truth_of(field).astype(np.float64) * sign
    y, x = np.mgrid[: field.size[0], : field.size[1]]
    reference = field.image(field.reference_index)[..., 1]
    return np.stack(
        [
            sampled(field.image(index)[..., 1], x - truth * du, y - truth * dv) - reference
            for index, (du, dv) in enumerate(field.offsets)
            if (du, dv) != (0, 0)
        ]
    )


def test_relief_has_no_occlusion_and_looks_the_same_from_everywhere() -> None:
    field = scenes.make("relief", grid=(3, 5), size=(128, 128), dtype=np.float32)
    right = np.nanstd(mismatch(field, 1.0))
    contrast = field.image(field.reference_index)[..., 1].std()
    assert right < 0.015 * contrast
    assert np.nanstd(mismatch(field, -1.0)) > 0.2 * contrast
    assert np.nanstd(mismatch(field, 0.9)) > 2 * right
    assert np.nanstd(mismatch(field, 1.1)) > 2 * right
    grid = (5, 7)
    for row, column in ((0, 0), (0, 6), (4, 3)):
        assert np.abs(seen_against_middle("relief", row, column, grid=grid, size=(128, 128))).max() < 2e-3
    disparity = scenes.true_disparity("relief", 2, 3, grid=grid, size=(128, 128))
    dy, dx = np.gradient(disparity)
    assert (np.abs(dx) * 3 + np.abs(dy) * 2).max() < 0.5


@pytest.mark.parametrize("name", ["planes", "boxes", "textureless", "moving", "still_life"])
def test_most_of_the_other_scenes_looks_the_same_too(name: str) -> None:
    field = scenes.make(name, grid=(3, 3), size=(128, 128), dtype=np.float32, seed=1)
    right, wrong = (np.nanmedian(np.abs(mismatch(field, sign))) for sign in (1.0, -1.0))
    assert right < 0.01
    assert wrong > 3 * right


def seen_against_middle(name: str, row: int, column: int, **kwargs: Any) -> np.ndarray:
    """True disparity of what one view sees, minus that of what the middle view sees in the same place."""
    rows, columns = kwargs["grid"]
    own = scenes.true_disparity(name, row, column, **kwargs)
    middle = scenes.true_disparity(name, rows // 2, columns // 2, **kwargs)
    y, x = np.mgrid[: own.shape[0], : own.shape[1]]
    x, y = x + own * (column - columns // 2), y + own * (row - rows // 2)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    inside = (left >= 0) & (top >= 0) & (left < own.shape[1] - 1) & (top < own.shape[0] - 1)
    corners = np.stack([middle[top[inside] + i, left[inside] + j] for i in (0, 1) for j in (0, 1)])
    smooth = np.ptp(corners, axis=0) < 0.15  # not where an edge passes between the pixels
    return own[inside][smooth] - sampled(middle, x, y, order=1)[inside][smooth]


@pytest.mark.parametrize("name", ["planes", "boxes", "bars", "textureless", "moving", thorough("still_life")])
def test_other_scenes_have_occlusions_and_views_agree_elsewhere(name: str) -> None:
    size = (192, 192)
    difference = seen_against_middle(name, 0, 0, grid=(5, 5), size=size)
    assert np.mean(np.abs(difference) < 0.01) > 0.9
    thinner_than_a_pixel = 1e-3 if name == "still_life" else 0.0  # tips of leaves
    # What a view sees, the middle view sees too, or something nearer.
    assert np.mean(difference >= 0.1) <= thinner_than_a_pixel
    assert np.mean(difference < -0.3) > 0.005


# --- the scenes ---


@pytest.mark.parametrize("name", scenes.NAMES)
@pytest.mark.parametrize(("seed", "far", "near"), [(0, -1.5, 1.5), thorough(1, 0.5, 2.0)])
def test_truth_stays_in_the_range_and_uses_most_of_it(name: str, seed: int, far: float, near: float) -> None:
    field = scenes.make(name, seed=seed, disparity_range=(far, near), **SMALL)
    truth = truth_of(field)
    assert truth.dtype == np.float32
    assert truth.shape == (96, 112)
    assert far < truth.min() < far + 0.15 * (near - far)
    assert near - 0.2 * (near - far) < truth.max() < near
    corner = scenes.true_disparity(name, 2, 2, seed=seed, disparity_range=(far, near), **SMALL)
    assert far < corner.min() < corner.max() < near


@pytest.mark.parametrize(
    ("disparity_range", "depths"), [((0.5, 2.0), (8, 4)), ((3.0, 4.0), (16 / 3, 4)), ((-9.0, -8.0), (8, 4))]
)
def test_geometry_makes_sense_for_ranges_on_either_side_of_zero(
    disparity_range: tuple[float, float], depths: tuple[float, float]
) -> None:
    field = scenes.make("planes", grid=(1, 2), size=(32, 32), disparity_range=disparity_range)
    np.testing.assert_allclose(field.geometry.depth(disparity_range), depths)
    np.testing.assert_allclose(field.geometry.disparity(depths), disparity_range)


@pytest.mark.parametrize("name", ["planes", "moving"])
def test_the_seed_decides(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is drawn anew."""
    monkeypatch.setattr(synthesis, "_record", synthesis._record.__wrapped__)
    first, again, other = (scenes.make(name, seed=seed, noise=0.02, **SMALL) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.views, again.views)
    np.testing.assert_array_equal(truth_of(first), truth_of(again))
    assert np.abs(truth_of(first) - truth_of(other)).mean() > 0.02
    assert (first.views != other.views).mean() > 0.5


def test_views_do_not_depend_on_the_reference() -> None:
    middle = scenes.make("boxes", noise=0.01, **SMALL)
    corner = scenes.make("boxes", noise=0.01, reference=(0, 2), **SMALL)
    np.testing.assert_array_equal(middle.views, corner.views)
    np.testing.assert_array_equal(middle.positions, corner.positions)
    assert corner.reference_index == 2
    assert corner.geometry == middle.geometry
    np.testing.assert_array_equal(truth_of(corner), scenes.true_disparity("boxes", 0, 2, **SMALL).astype(np.float32))
    assert not np.array_equal(truth_of(corner), truth_of(middle))


def test_truth_and_arguments_are_the_same_in_all_three() -> None:
    field = scenes.make("relief", grid=(3, 3), size=(128, 128), dtype=np.float32, reference=(2, 0))
    contrast = field.image(field.reference_index)[..., 1].std()
    assert np.nanstd(mismatch(field, 1.0)) < 0.015 * contrast

    def arguments(function: Any) -> dict[str, Any]:
        return {p.name: p.default for p in inspect.signature(function).parameters.values()}

    make = arguments(scenes.make)
    for function, own in ((scenes.sequence, {"frames", "name"}), (scenes.true_disparity, {"row", "column"})):
        shared = {name: default for name, default in arguments(function).items() if name not in own}
        assert shared == {name: make[name] for name in shared}


@pytest.mark.parametrize("grid", [(1, 5), (4, 1), (2, 2)])
def test_lines_of_views_and_even_grids(grid: tuple[int, int]) -> None:
    for name in scenes.NAMES:
        field = scenes.make(name, grid=grid, size=(24, 32))
        assert field.grid_shape == grid
        assert field.reference_index == (grid[0] // 2) * grid[1] + grid[1] // 2
        assert np.isfinite(truth_of(field)).all()


@pytest.mark.parametrize("size", [(8, 8), (8, 60), (50, 11)])
def test_tiny_views(size: tuple[int, int]) -> None:
    for name in scenes.NAMES:
        field = scenes.make(name, grid=(3, 3), size=size)
        assert field.size == size
        assert np.abs(truth_of(field)).max() < 1.5


def test_kinds_of_pixels_show_the_same() -> None:
    precise = scenes.make("boxes", dtype=np.float32, **SMALL).views
    assert precise.dtype == np.float32
    assert precise.min() >= 0
    assert precise.max() <= 1
    for dtype, levels in ((np.uint8, 255), (np.uint16, 65535)):
        stored = scenes.make("boxes", dtype=dtype, **SMALL).views
        assert stored.dtype == dtype
        assert np.abs(stored / levels - precise).max() <= 0.5001 / levels + 1e-6
    grey = scenes.make("boxes", dtype=np.float32, channels=1, **SMALL).views
    assert grey.shape[-1] == 1
    np.testing.assert_allclose(grey[..., 0], precise @ np.float32([0.299, 0.587, 0.114]), atol=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_noise_has_the_deviation_asked_for(channels: int) -> None:
    clean, noisy = (
        scenes.make("textureless", noise=noise, dtype=np.float32, channels=channels, **SMALL).views
        for noise in (0.0, 0.03)
    )
    middle = (clean > 0.2) & (clean < 0.8)  # nothing is cut off there
    noise = np.where(middle, noisy - clean, np.nan)
    assert abs(np.nanstd(noise) - 0.03) < 0.001
    assert abs(np.nanmean(noise)) < 0.001
    first, second = noise[0].ravel(), noise[1].ravel()
    both = ~np.isnan(first + second)
    assert abs(np.corrcoef(first[both], second[both])[0, 1]) < 0.03  # each view has its own


def test_bars_are_thin_and_textureless_has_regions_of_one_colour() -> None:
    truth = scenes.true_disparity("bars", 1, 1, grid=(3, 3), size=(64, 512))
    for row in truth[::16]:
        bar = row > -0.6
        starts, ends = np.flatnonzero(np.diff(np.pad(bar.astype(int), 1))).reshape(-1, 2).T
        assert len(starts) >= 6
        assert np.median(ends - starts) <= 8
        assert 0.03 < bar.mean() < 0.3
    views = scenes.make("textureless", dtype=np.float32, grid=(1, 3), size=(128, 128)).views
    for view in views:
        colours, counts = np.unique(view.reshape(-1, 3), axis=0, return_counts=True)
        assert np.sum(counts > 300) >= 5  # two patches, a disc, faces of a box
        assert 0.2 < counts[counts > 300].sum() / view[..., 0].size < 0.7
        assert len(colours) > 5000  # and the wall has texture


# --- time ---


def test_sequence_moves_things_smoothly_before_a_still_room() -> None:
    frames = list(scenes.sequence(frames=8, grid=(1, 2), size=(96, 96)))
    assert len(frames) == 8
    truths = np.stack([truth_of(frame) for frame in frames])
    still = np.ptp(truths, axis=0) == 0
    assert 0.1 < still.mean() < 0.8
    views = np.stack([frame.views[frame.reference_index] for frame in frames]).astype(int)
    inner = np.ones_like(still)
    for shift in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        inner &= np.roll(still, shift, axis=(0, 1))  # pixels at a thing's edge mix
    assert np.ptp(views, axis=0)[inner & still].max() == 0
    steps = np.abs(np.diff(np.concatenate([truths, truths[:1]]), axis=0)).mean(axis=(1, 2))
    assert steps.min() > 0.02
    assert steps.max() < 3 * steps.min()  # the last meets the first


def test_a_sequence_is_make_over_time() -> None:
    kwargs: dict[str, Any] = {"seed": 2, "grid": (1, 2), "size": (48, 48), "noise": 0.02}
    frames = list(scenes.sequence("moving", frames=4, **kwargs))
    same = scenes.make("moving", time=0.75, **kwargs)
    np.testing.assert_array_equal(frames[3].views, same.views)
    np.testing.assert_array_equal(truth_of(frames[3]), truth_of(same))
    there = scenes.true_disparity("moving", 0, 0, seed=2, grid=(1, 2), size=(48, 48), time=0.75)
    assert not np.array_equal(there, scenes.true_disparity("moving", 0, 0, seed=2, grid=(1, 2), size=(48, 48)))
    kwargs: dict[str, Any] = {"grid": (1, 2), "size": (64, 64), "dtype": np.float32}
    start, end = scenes.make("moving", time=0.0, **kwargs), scenes.make("moving", time=1.0, **kwargs)
    np.testing.assert_allclose(start.views, end.views, atol=1e-3)
    frames = scenes.sequence(frames=10**9, grid=(1, 2), size=(16, 16))
    assert next(frames).size == (16, 16)


def test_paint_sticks_to_what_moves() -> None:
    paint = Painter(np.random.default_rng(0), 64).dots([[0.1, 0.2, 0.3], [0.9, 0.8, 0.7]], 0.1, 16)
    thing = Thing(Ellipsoid(CENTRE, EDGES), paint, path=(0.1, 0.05, 0.05, 0.4))
    here, there = thing.at(0.0, 64), thing.at(0.25, 64)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (3, 200))
    by = there.shape.centre - here.shape.centre
    assert np.abs(by).min() > 0.01
    moved = points + by[:, None]
    colours = here.texture.sample(*points[:2] * 64)
    assert colours.std() > 0.2
    np.testing.assert_allclose(there.texture.sample(*moved[:2] * 64), colours, atol=1e-5)
    np.testing.assert_allclose(there.shape.normals(moved), here.shape.normals(points))


# --- arguments ---


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"name": "teapot"}, "unknown scene 'teapot'; known are relief, planes"),
        ({"seed": -1}, "seed must be a whole number of at least 0, not -1"),
        ({"grid": (1, 1)}, "at least two views, found 1 x 1"),
        ({"grid": 9}, r"grid must be \(rows, columns\)"),
        ({"size": (4, 64)}, r"size must be \(height, width\), whole numbers >= 8, found \(4, 64\)"),
        ({"size": (8, 8), "grid": (9, 9)}, "too small for a grid of 9 x 9"),
        ({"disparity_range": (1.0, -1.0)}, "disparity_range must be two finite numbers"),
        ({"disparity_range": "wide"}, "disparity_range must be"),
        ({"noise": -0.1}, "noise must be a number from 0 to 1, not -0.1"),
        ({"reference": (3, 0)}, r"reference view \(row 3, column 0\) does not exist in a grid of 3 x 3"),
        ({"reference": 4}, "reference view must be"),
        ({"time": 0.5}, "time must be 0 for a scene that does not move, found 0.5 for 'boxes'"),
        ({"name": "moving", "time": 1.5}, "time must be a number from 0 to 1"),
        ({"dtype": np.float64}, "dtype must be uint8, uint16 or float32"),
        ({"dtype": "colour"}, "dtype must be"),
        ({"channels": 4}, r"channels must be 1 \(grey\) or 3 \(colour\), found 4"),
    ],
)
def test_bad_arguments_are_named_in_one_sentence(arguments: dict[str, Any], sentence: str) -> None:
    with pytest.raises(LightFieldError, match=sentence) as error:
        scenes.make(**{"name": "boxes", "grid": (3, 3), "size": (32, 32)} | arguments)
    assert str(error.value).endswith(".")
