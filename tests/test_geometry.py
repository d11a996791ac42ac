"""Disparity and depth by hand, layouts of views, xarray datasets, and filters over windows."""

import sys
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

import lfgpu
from lfgpu import LightField, LightFieldError, scenes
from lfgpu.data import Geometry
from lfgpu.data.layout import PATTERNS
from lfgpu.data.windows import eroded, gradient_size, smoothed, window_max, window_mean, window_min
from lfgpu.io import read, read_map
from lfgpu.pipelines.estimate import estimate_depth
from tests.made import masked

GEOMETRY = Geometry(focal_length_px=1000.0, baseline_m=0.01, focus_distance_m=2.0)


def test_values_by_hand() -> None:
    # B f = 10; at 1 m: 10 * (1 - 0.5) = 5; on the focus plane 0; at 4 m: 10 * (0.25 - 0.5) = -2.5
    np.testing.assert_allclose(GEOMETRY.disparity([1.0, 2.0, 4.0]), [5.0, 0.0, -2.5])
    np.testing.assert_allclose(GEOMETRY.depth([5.0, 0.0, -2.5]), [1.0, 2.0, 4.0])
    assert (np.diff(GEOMETRY.depth(np.linspace(-4, 10, 50))) < 0).all()
    depth = np.random.default_rng(1).uniform(0.3, 50, (7, 9))
    np.testing.assert_allclose(GEOMETRY.depth(GEOMETRY.disparity(depth)), depth, rtol=1e-12)
    # the horizon has the disparity -B f / F = -5
    assert GEOMETRY.disparity(np.inf) == -5.0
    assert np.isinf(GEOMETRY.depth([-5.0, -6.0])).all()
    np.testing.assert_array_equal(np.isnan(GEOMETRY.depth([np.nan, 1.0])), [True, False])
    geometry = Geometry(focal_length_px=1000.0, baseline_m=0.01)
    np.testing.assert_allclose(geometry.disparity([1.0, 10.0]), [10.0, 1.0])
    assert np.isinf(geometry.depth(0.0))
    assert GEOMETRY.depth(np.zeros((3, 4), np.float32)).shape == (3, 4)
    assert GEOMETRY.depth(5) == 1.0


def test_lengths_must_be_positive_and_places_pairs() -> None:
    """Only the focus distance may be infinite."""
    lengths = ("focal_length_px", "baseline_m", "focus_distance_m", "pixel_aspect")
    wrong: list[tuple[str, Any]] = [*product(lengths, (0.0, -1.0, np.nan)), *product(lengths[:2], (np.inf,))]
    for name, value in (*wrong, *product(("principal_point", "unshifted_at"), (5, (1.0,), (1.0, np.nan)))):
        with pytest.raises(LightFieldError, match=name):
            Geometry(**({"focal_length_px": 1.0, "baseline_m": 1.0} | {name: value}))


@pytest.mark.data("cotton")
def test_true_disparity_gives_the_true_depth(data_folder: Path) -> None:
    lf = read(data_folder)
    error = np.abs(lf.geometry.depth(lf.truth.disparity) - read_map(data_folder / "gt_depth_lowres.pfm"))
    assert np.median(error) < 1e-3


# --- cameras whose rows stand otherwise than columns, and pixels that are not square ---

UNEVEN = Geometry(1000.0, 0.01, 2.0, principal_point=(3.0, 1.5), pixel_aspect=1.25, unshifted_at=(1.0, 2.0))


def projected(geometry: Geometry, point: np.ndarray, camera_m: np.ndarray) -> np.ndarray:
    """Where a pinhole camera at (right, down), its frame shifted onto the focus plane, sees a point: (x, y)."""
    f = np.array([1.0, geometry.pixel_aspect]) * geometry.focal_length_px
    return geometry.principal_point + f * ((point[:2] - camera_m) / point[2] + camera_m / geometry.focus_distance_m)


def test_positions_are_places_in_steps_that_move_images_alike() -> None:
    centres = np.array([[0.0, 0.0], [0.01, 0.0], [-0.02, 0.03]])
    np.testing.assert_allclose(UNEVEN.positions(centres), [[0, 0], [1, 0], [-2, 3.75]])
    np.testing.assert_allclose(UNEVEN.centres(UNEVEN.positions(centres)), centres)
    with pytest.raises(LightFieldError, match=r"\[n, 2\]"):
        UNEVEN.positions([1.0, 2.0])
    point, steps = np.array([0.1, -0.2, 1.3]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.5], [-2.0, 0.7]])
    seen = np.array([projected(UNEVEN, point, centre) for centre in UNEVEN.centres(steps)])
    np.testing.assert_allclose(seen, seen[0] - UNEVEN.disparity(1.3) * steps)


@pytest.mark.parametrize("position", [(1.0, 2.0), (3.0, 0.5)])
def test_points_of_any_view_are_those_that_it_shows(position: tuple[float, float]) -> None:
    disparity = np.linspace(-1, 3, 12).reshape(3, 4)
    points = UNEVEN.points(disparity, position=position)
    camera = UNEVEN.centres(np.subtract([position], UNEVEN.unshifted_at))[0]
    for (row, column), d in np.ndenumerate(disparity):
        assert points[row, column, 2] == pytest.approx(float(UNEVEN.depth(d)))
        np.testing.assert_allclose(projected(UNEVEN, points[row, column], camera), [column, row], atol=1e-12)


def test_what_is_masked_has_no_depth_and_what_is_no_number_is_refused() -> None:
    cameras = Geometry(500.0, 0.02, 4.0)
    np.testing.assert_array_equal(cameras.depth(np.ma.masked_equal([0.0, 2.5], 2.5)), [4.0, np.nan])
    np.testing.assert_array_equal(cameras.disparity(np.ma.masked_equal([4.0, 2.0], 2.0)), [0.0, np.nan])
    assert np.isnan(cameras.points(np.ma.masked_equal([[0.0, 2.5]], 2.5))[0, 1]).all()
    for use in (cameras.depth, cameras.disparity, cameras.points, cameras.positions, cameras.centres):
        with pytest.raises(LightFieldError, match="must be an array of numbers"):
            use("far")
    for step in (0, -1, 1.5):
        with pytest.raises(LightFieldError, match="step must be a whole number of at least 1"):
            cameras.points(np.zeros((4, 4)), step=step)  # type: ignore[arg-type]


def test_what_has_no_depth_is_no_point() -> None:
    points = GEOMETRY.points([[np.nan, -5.0, -9.0, 1.0]])  # the horizon has the disparity -5
    np.testing.assert_array_equal(np.isnan(points).all(2), [[True, True, True, False]])
    with pytest.raises(LightFieldError, match="shape"):
        GEOMETRY.points([1.0, 2.0])


def test_rows_that_stand_farther_apart_than_columns() -> None:
    made = scenes.make("relief", grid=(5, 3), size=(48, 64), dtype=np.float32)
    sparse = LightField.from_grid(
        made.views.reshape(5, 3, *made.views.shape[1:])[::2], vertical_step=2.0, geometry=made.geometry
    )
    np.testing.assert_array_equal(np.unique(sparse.positions[:, 1]), [0, 2, 4])
    assert sparse.grid_shape is None
    errors = [
        np.median(np.abs(estimate_depth(lf, disparity_range=(-2, 2)).disparity - made.truth.disparity))
        for lf in (sparse, LightField.from_grid(sparse.views.reshape(3, 3, *sparse.views.shape[1:])))
    ]
    assert errors[0] < 0.03 < 0.09 < errors[1]  # taken for a square grid, it is wrong
    with pytest.raises(LightFieldError, match="vertical_step"):
        LightField.from_grid(made.views[None], vertical_step=0.0)


@pytest.fixture(scope="module")
def lf() -> LightField:
    made = scenes.make("boxes", grid=(5, 4), size=(16, 20), reference=(1, 2), dtype=np.uint16)
    valid = np.random.default_rng(1).random(made.views.shape[:3]) < 0.9
    return replace(made, valid=valid, white=4095)


def test_a_layout_is_the_light_field_without_its_pixels(lf: LightField) -> None:
    layout = lf.layout
    assert (layout.shape, layout.dtype, layout.scale) == (lf.views.shape, lf.views.dtype, 1 / 4095)
    assert (layout.count, layout.size, layout.channels, layout.name) == (20, lf.size, 3, lf.name)
    assert (layout.reference, layout.farthest) == (lf.reference_index, 3.0)
    assert np.array_equal(layout.offsets, lf.offsets)
    assert layout.masks is not None
    assert np.array_equal(np.stack(layout.masks), lf.valid)


@pytest.mark.parametrize("which", [*PATTERNS, [0, 3, 7, 19]])
def test_its_subset_is_the_layout_of_the_subset(lf: LightField, which: str | list[int]) -> None:
    ours, theirs = lf.layout.subset(which), lf.subset(which).layout
    assert np.array_equal(ours.offsets, theirs.offsets)
    assert (ours.reference, ours.shape) == (theirs.reference, theirs.shape)
    assert ours.masks is not None
    assert theirs.masks is not None
    assert np.array_equal(ours.masks, theirs.masks)


def test_a_subset_is_a_layout_that_copies_no_mask(lf: LightField) -> None:
    masks = lf.layout.subset("cross").masks
    assert all(mask.base is lf.valid for mask in masks)
    with pytest.raises(LightFieldError, match="leaves the reference view alone"):
        lf.layout.subset([lf.reference_index])


@pytest.mark.parametrize("size", [1, 3, 7])
@pytest.mark.parametrize("shape", [(20, 30), (9, 7)])
def test_windows_are_those_of_scipy(shape: tuple[int, int], size: int) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    np.testing.assert_array_equal(window_max(values, size), ndimage.maximum_filter(values, size, mode="nearest"))
    np.testing.assert_array_equal(window_min(values, size), ndimage.minimum_filter(values, size, mode="nearest"))
    np.testing.assert_allclose(window_mean(values, size), ndimage.uniform_filter(values, size), rtol=1e-6)
    high = values > 0.9
    np.testing.assert_array_equal(window_max(high, size), ndimage.maximum_filter(high, size, mode="nearest"))
    np.testing.assert_array_equal(window_min(~high, size), ndimage.minimum_filter(~high, size, mode="nearest"))


@pytest.mark.parametrize("shape", [(20, 30), (9, 7)])
def test_smoothed_images_gradients_and_margins_are_those_of_scipy(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    for deviation in (0.7, 1.5):
        np.testing.assert_allclose(smoothed(values, deviation), ndimage.gaussian_filter(values, deviation), rtol=1e-5)
    sobel = np.hypot(ndimage.sobel(values, 0), ndimage.sobel(values, 1)) / 8
    np.testing.assert_allclose(gradient_size(values), sobel, rtol=0, atol=1e-6)
    known = values > 0.05
    for times in (1, 3):
        want = ndimage.binary_erosion(known, iterations=times, border_value=0)
        np.testing.assert_array_equal(eroded(known, times), want)


@pytest.fixture(scope="module")
def of_boxes() -> lfgpu.LightField:
    pytest.importorskip("xarray", reason="xarray is not installed: pip install 'lfgpu[xarray]'")
    return scenes.make("boxes", grid=(3, 5), size=(24, 32))


@pytest.fixture(scope="module")
def result(of_boxes: lfgpu.LightField) -> lfgpu.DepthResult:
    return lfgpu.estimate_depth(of_boxes, config="fast", disparity_range=(-2, 2), check_cameras=False)


def test_a_grid_has_rows_and_columns(of_boxes: lfgpu.LightField) -> None:
    found = lfgpu.to_xarray(of_boxes)
    assert found.views.dims == ("v", "u", "y", "x", "channel")
    index = of_boxes.index_of(1, 4)
    picked = found.views.sel(v=1, u=4, channel="green")
    np.testing.assert_array_equal(picked, of_boxes.views[index, ..., 1])
    np.testing.assert_allclose(
        picked * found.views.scale_factor_to_unit_intensity, of_boxes.image(index)[..., 1], rtol=1e-6
    )
    assert (found.u.units, found.x.units) == ("view steps", "px")
    assert found.attrs["reference"] == [2.0, 1.0]
    assert found.attrs["baseline_m"] == of_boxes.geometry.baseline_m  # type: ignore[union-attr]
    assert np.shares_memory(found.views.values, of_boxes.views)


def test_views_that_fill_no_grid_are_a_list_and_masks_come_too(of_boxes: lfgpu.LightField) -> None:
    found = lfgpu.to_xarray(of_boxes.subset("cross"))
    assert found.views.dims == ("view", "y", "x", "channel")
    np.testing.assert_array_equal(np.stack([found.u, found.v], 1), of_boxes.subset("cross").positions)
    found = lfgpu.to_xarray(masked(of_boxes, (0, 0, 0)))
    assert int((~found.valid).sum()) == 1


def test_a_result_has_units_and_its_file_comes_back(result: lfgpu.DepthResult, tmp_path: Path) -> None:
    import xarray

    found = lfgpu.to_xarray(result)
    assert {name: found[name].units for name in found} == {
        "disparity": "px per view step",
        "confidence": "1",
        "uncertainty": "px per view step",
        "depth": "m",
    }
    for name in found:
        np.testing.assert_array_equal(found[name], getattr(result, str(name)))
        assert found[name].dims == ("y", "x")
    assert found.attrs["position"] == [2.0, 1.0]
    found.to_netcdf(tmp_path / "map.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "map.nc", engine="scipy") as read:
        np.testing.assert_array_equal(read.disparity, result.disparity)
        assert read.attrs["convention"] == found.attrs["convention"]


def test_maps_of_all_views_and_a_map_without_geometry(result: lfgpu.DepthResult, of_boxes: lfgpu.LightField) -> None:
    maps = np.broadcast_to(result.disparity, of_boxes.views.shape[:3])
    all_views = lfgpu.ViewsResult(maps, maps, of_boxes.positions, (7,), result, {})
    assert lfgpu.to_xarray(all_views).disparity.dims == ("view", "y", "x")
    assert set(lfgpu.to_xarray(lfgpu.DisparityMap(result.disparity))) == {"disparity"}


def test_what_cannot_be_converted_gets_a_sentence(of_boxes: lfgpu.LightField, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="not ndarray"):
        lfgpu.to_xarray(of_boxes.views)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(lfgpu.LightFieldError, match=r"to_xarray needs xarray.*\[xarray\]"):
        lfgpu.to_xarray(of_boxes)
