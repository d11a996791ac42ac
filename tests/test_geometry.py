"""Disparity and depth: the formula by hand, its inverse, its edges, its refusals."""

from pathlib import Path

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu.data.geometry import Geometry
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read, read_map
from lfgpu.pipelines.estimate import estimate_depth

GEOMETRY = Geometry(focal_length_px=1000.0, baseline_m=0.01, focus_distance_m=2.0)


def test_values_by_hand() -> None:
    # B f = 10; at 1 m: 10 * (1 - 0.5) = 5; on the focus plane 0; at 4 m: 10 * (0.25 - 0.5) = -2.5
    np.testing.assert_allclose(GEOMETRY.disparity([1.0, 2.0, 4.0]), [5.0, 0.0, -2.5])
    np.testing.assert_allclose(GEOMETRY.depth([5.0, 0.0, -2.5]), [1.0, 2.0, 4.0])


def test_larger_disparity_is_nearer() -> None:
    assert (np.diff(GEOMETRY.depth(np.linspace(-4, 10, 50))) < 0).all()


def test_depth_and_disparity_are_inverse() -> None:
    depth = np.random.default_rng(1).uniform(0.3, 50, (7, 9))
    np.testing.assert_allclose(GEOMETRY.depth(GEOMETRY.disparity(depth)), depth, rtol=1e-12)


def test_at_and_beyond_the_horizon_depth_is_infinite() -> None:
    # the horizon has the disparity -B f / F = -5
    assert GEOMETRY.disparity(np.inf) == -5.0
    assert np.isinf(GEOMETRY.depth([-5.0, -6.0])).all()


def test_an_undefined_disparity_has_an_undefined_depth() -> None:
    np.testing.assert_array_equal(np.isnan(GEOMETRY.depth([np.nan, 1.0])), [True, False])


def test_without_a_focus_plane_disparity_is_inverse_depth() -> None:
    geometry = Geometry(focal_length_px=1000.0, baseline_m=0.01)
    np.testing.assert_allclose(geometry.disparity([1.0, 10.0]), [10.0, 1.0])
    assert np.isinf(geometry.depth(0.0))


def test_shape_is_kept_and_integers_are_taken() -> None:
    assert GEOMETRY.depth(np.zeros((3, 4), np.float32)).shape == (3, 4)
    assert GEOMETRY.depth(5) == 1.0


@pytest.mark.parametrize("name", ["focal_length_px", "baseline_m", "focus_distance_m", "pixel_aspect"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_lengths_must_be_positive(name: str, value: float) -> None:
    lengths = {"focal_length_px": 1.0, "baseline_m": 1.0, "focus_distance_m": 1.0, name: value}
    with pytest.raises(LightFieldError, match=name):
        Geometry(**lengths)


@pytest.mark.parametrize("name", ["focal_length_px", "baseline_m"])
def test_only_the_focus_distance_may_be_infinite(name: str) -> None:
    lengths = {"focal_length_px": 1.0, "baseline_m": 1.0, name: float("inf")}
    with pytest.raises(LightFieldError, match=name):
        Geometry(**lengths)


@pytest.mark.parametrize("name", ["principal_point", "unshifted_at"])
@pytest.mark.parametrize("place", [(1.0,), (1.0, float("nan"))])
def test_places_must_be_pairs(name: str, place: tuple[float, ...]) -> None:
    with pytest.raises(LightFieldError, match=name):
        Geometry(1.0, 1.0, **{name: place})


@pytest.mark.data("cotton")
def test_true_disparity_gives_the_true_depth(data_folder: Path) -> None:
    lf = read(data_folder)
    assert lf.geometry is not None
    assert lf.truth is not None
    error = np.abs(lf.geometry.depth(lf.truth.disparity) - read_map(data_folder / "gt_depth_lowres.pfm"))
    assert np.median(error) < 1e-3


# --- cameras whose rows stand otherwise than columns, and pixels that are not square ---

UNEVEN = Geometry(1000.0, 0.01, 2.0, principal_point=(3.0, 1.5), pixel_aspect=1.25, unshifted_at=(1.0, 2.0))


def projected(geometry: Geometry, point: np.ndarray, camera_m: np.ndarray) -> np.ndarray:
    """Where a pinhole camera at (right, down), its frame shifted onto the focus plane, sees a point: (x, y)."""
    f = np.array([1.0, geometry.pixel_aspect]) * geometry.focal_length_px
    return geometry.principal_point + f * ((point[:2] - camera_m) / point[2] + camera_m / geometry.focus_distance_m)


def test_positions_are_camera_places_in_steps_that_move_images_alike() -> None:
    centres = np.array([[0.0, 0.0], [0.01, 0.0], [-0.02, 0.03]])
    np.testing.assert_allclose(UNEVEN.positions(centres), [[0, 0], [1, 0], [-2, 3.75]])
    np.testing.assert_allclose(UNEVEN.centres(UNEVEN.positions(centres)), centres)
    with pytest.raises(LightFieldError, match=r"\[n, 2\]"):
        UNEVEN.positions([1.0, 2.0])


def test_one_disparity_holds_for_both_directions() -> None:
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
    assert made.truth is not None
    errors = [
        np.median(np.abs(estimate_depth(lf, disparity_range=(-2, 2)).disparity - made.truth.disparity))
        for lf in (sparse, LightField.from_grid(sparse.views.reshape(3, 3, *sparse.views.shape[1:])))
    ]
    assert errors[0] < 0.03 < 0.09 < errors[1]  # taken for a square grid, it is wrong
    with pytest.raises(LightFieldError, match="vertical_step"):
        LightField.from_grid(made.views[None], vertical_step=0.0)
