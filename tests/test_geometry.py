"""Disparity and depth: the formula by hand, its inverse, its edges, its refusals."""

from __future__ import annotations

import numpy as np
import pytest

from lfgpu.errors import LightFieldError
from lfgpu.geometry import Geometry

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


@pytest.mark.parametrize("name", ["focal_length_px", "baseline_m", "focus_distance_m"])
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
