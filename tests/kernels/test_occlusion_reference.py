"""Occlusions in the reference backend against independent truths: the formulas as loops, and central differences."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import occlusion_cases
import occlusion_checks
import pytest
from cases import IRREGULAR
from checks import Operation, compute, largest_error
from occlusion_cases import LOSSES, OCCLUSION_CASES, OcclusionCase, occlusion_inputs
from test_reference import REFERENCE, STEP, assert_gradient, away_from_joints, central_differences, changed, tent_of_any

from lfgpu.contract import Loss

SMALL = [case for case in OCCLUSION_CASES if math.prod(case.size) <= 200]


def run(operation: Operation, inputs: SimpleNamespace) -> dict[str, np.ndarray]:
    return compute(REFERENCE, "cpu", operation, inputs)


def mean_of_what_lands(i: SimpleNamespace, n: int) -> tuple[np.ndarray, np.ndarray]:
    """View n and its coverage, pixel by pixel: the definition in `lfgpu/contract`, written out."""
    height, width = i.disparity.shape
    du, dv = i.offsets[n].astype(float)
    d, image = i.disparity.astype(float), i.image.astype(float)
    given = np.empty((height, width, height, width))
    for py, px in np.ndindex(height, width):
        to_x = [tent_of_any(qx - (px - d[py, px] * du), i.softness) for qx in range(width)]
        to_y = [tent_of_any(qy - (py - d[py, px] * dv), i.softness) for qy in range(height)]
        given[py, px] = np.outer(to_y, to_x)
    view, coverage = np.zeros(image.shape), given.sum((0, 1))
    for qy, qx in np.ndindex(height, width):
        reaching = [(py, px) for py, px in np.ndindex(height, width) if given[py, px, qy, qx] > 1e-20]
        if not reaching:
            continue
        front = max(d[p] for p in reaching)
        weights = [given[p][qy, qx] * math.exp(i.sharpness * (d[p] - front)) for p in reaching]
        view[qy, qx] = sum(w * image[p] for w, p in zip(weights, reaching, strict=True)) / sum(weights)
    return view, coverage


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_splat_occluding_is_the_formula(case: OcclusionCase, rng: np.random.Generator) -> None:
    i = occlusion_inputs(case, rng)
    got = run(occlusion_checks.SPLAT, i)
    n = len(i.offsets) - 1
    view, coverage = mean_of_what_lands(i, n)
    np.testing.assert_allclose(got["views"][n], view, rtol=0, atol=1e-9)  # 1 - Λ near 0 has 1e-16 of rounding
    np.testing.assert_allclose(got["coverage"][n], coverage, rtol=0, atol=1e-12)


def penalty(square: float, loss: Loss, s: float) -> float:
    """ρ of r²."""
    if loss == "squares":
        return square
    if loss == "charbonnier":
        return 2 * s * s * (math.sqrt(1 + square / s**2) - 1)
    return s * s * square / (s * s + square)


@pytest.mark.parametrize("loss", LOSSES)
def test_data_term_adds_up_losses_of_what_is_valid_and_covered(loss: Loss, rng: np.random.Generator) -> None:
    i = occlusion_inputs(OcclusionCase("any", masked=True, dtype="uint8", disparities=(-3.0, 3.0), loss=loss), rng)
    got = run(occlusion_checks.SPLAT, i)
    want, counted = 0.0, 0
    for place in np.ndindex(i.recorded.shape[:3]):
        if i.valid[place] != 0 and got["coverage"][place] >= i.least_coverage:
            square = float(((got["views"][place] - i.recorded[place] / 255.0) ** 2).sum())
            want, counted = want + penalty(square, loss, i.loss_scale), counted + 1
    assert 0.2 < counted / i.valid.size < 0.69  # the mask and the coverage both leave something out
    assert float(run(occlusion_checks.DATA_TERM, i)["value"]) == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("loss", LOSSES)
def test_losses_are_squares_of_small_residuals(loss: Loss, rng: np.random.Generator) -> None:
    squares, other = (
        run(occlusion_checks.DATA_TERM, changed(i, loss=kind, loss_scale=1e4))
        for i in [occlusion_inputs(OcclusionCase("any"), rng)]
        for kind in ("squares", loss)
    )
    assert largest_error(other["gradient"], squares["gradient"]) < 1e-6
    assert largest_error(other["value"], squares["value"]) < 1e-6


DIFFERENTIABLE = (
    OcclusionCase("overlapping", size=(9, 10), disparities=(-0.75, 0.75), sharpness=3.0),
    OcclusionCase("grey masked uint8", size=(9, 10), channels=1, masked=True, dtype="uint8", sharpness=2.0),
    OcclusionCase("irregular", size=(9, 10), offsets=IRREGULAR, masked=True, sharpness=2.0, softness=0.3),
    OcclusionCase("one row", size=(1, 12), offsets=((2.0, 0.0), (-1.0, 0.0)), sharpness=2.0),
)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("case", DIFFERENTIABLE, ids=str)
def test_occluding_data_term_has_its_gradient(case: OcclusionCase, loss: Loss, rng: np.random.Generator) -> None:
    check_gradient(occlusion_cases.with_loss(away_from_joints(case, rng), replace(case, loss=loss)), rng)


@pytest.mark.parametrize("loss", LOSSES)
def test_occluding_data_term_has_its_gradient_on_smooth_surfaces(loss: Loss, rng: np.random.Generator) -> None:
    """Waves, one in front of the other: within a surface neighbours blend, at its rim it hides what is behind."""
    case = OcclusionCase("smooth", size=(10, 12), loss=loss, sharpness=8.0, disparities=(-0.02, 0.02))
    i = away_from_joints(case, rng)
    y, x = np.mgrid[:10, :12]
    smooth = 0.3 * np.sin(0.5 * x + rng.uniform(0, 6)) * np.cos(0.4 * y + rng.uniform(0, 6)) + 0.8 * (x + y > 9)
    i.disparity = off_joints(smooth, case.softness, i.offsets)
    check_gradient(occlusion_cases.with_loss(i, case), rng)


def off_joints(disparity: np.ndarray, softness: float, offsets: np.ndarray) -> np.ndarray:
    """The disparities, moved by a little where a landing place is near a joint of the tent."""
    joints, moved = np.array([0.0, softness, 1 - softness, 1.0]), disparity.copy()
    for _ in range(100):
        fractions = np.mod(-moved[..., None, None] * offsets.astype(float), 1.0)
        near = (np.abs(fractions[..., None] - joints).min(-1) < 1e-3) & (offsets != 0)
        if not near.any():
            return moved
        moved[near.any((-1, -2))] += 3.1e-4
    raise AssertionError("no such disparities found")


def check_gradient(i: SimpleNamespace, rng: np.random.Generator) -> None:
    """The gradient is that of central differences, while the same pixels count."""
    counts = occlusion_cases.coverage_of(i) >= i.least_coverage
    assert counts.any()
    want = central_differences(
        lambda d: float(run(occlusion_checks.DATA_TERM, changed(i, disparity=d))["value"]), i.disparity, rng
    )
    for sign in (1, -1):
        moved = changed(i, disparity=i.disparity + sign * STEP)
        assert ((occlusion_cases.coverage_of(moved) >= i.least_coverage) == counts).all()
    assert_gradient(run(occlusion_checks.DATA_TERM, i)["gradient"], want)


def test_without_sharpness_the_mean_is_the_splat_by_its_coverage(rng: np.random.Generator) -> None:
    i = occlusion_inputs(OcclusionCase("plain", sharpness=0.0, disparities=(-3.0, 3.0)), rng)
    views, coverage = np.empty(i.views.shape), np.empty(i.views.shape[:3])
    arrays = (a.astype(np.float64) for a in (i.image, i.disparity, i.offsets))
    REFERENCE.splat(*arrays, softness=i.softness, views_out=views, coverage_out=coverage)
    got = run(occlusion_checks.SPLAT, i)
    np.testing.assert_allclose(got["coverage"], coverage, rtol=0, atol=1e-12)
    np.testing.assert_allclose(got["views"] * coverage[..., None], views, rtol=0, atol=1e-12)


def test_a_farther_scene_looks_the_same(rng: np.random.Generator) -> None:
    """Only differences of disparity decide who hides whom: whole shifts of all move the views, and nothing else."""
    offsets = ((1.0, 0.0), (0.0, -1.0))
    i = occlusion_inputs(OcclusionCase("any", size=(9, 12), offsets=offsets, sharpness=20.0), rng)
    near, far = (run(occlusion_checks.SPLAT, changed(i, disparity=i.disparity + d))["views"] for d in (0.0, -3.0))
    np.testing.assert_allclose(far[0][:, 3:], near[0][:, :-3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(far[1][:-3], near[1][3:], rtol=0, atol=1e-9)


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_visible_is_what_comparing_every_two_pixels_says(case: OcclusionCase, rng: np.random.Generator) -> None:
    i = occlusion_inputs(case, rng)
    got, want = run(occlusion_checks.VISIBLE, i)["visible"], occlusion_checks.seen(i)
    decided = np.ones(got.shape, np.bool_) if case.exact else ~occlusion_checks.undecided(i)
    assert decided.mean() > 0.95
    np.testing.assert_array_equal(got[decided], want[decided])


def seen_of_a_slanted_plane(slope: float, offset: float, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """What is seen of a plane of that slope, and what lands in the frame."""
    x = np.mgrid[:5, :60][1].astype(float)
    disparity, offsets, seen = slope * (x - 30) + 0.013, np.array([[offset, 0.0]]), np.empty((1, 5, 60))
    REFERENCE.visible(disparity, offsets, tolerance=tolerance, visible_out=seen)
    place = x - disparity * offset
    return seen[0] != 0, (place >= 0) & (place <= 59)


@pytest.mark.parametrize("slope", [-0.4, 0.2, 0.45])
@pytest.mark.parametrize("offset", [-1.0, 1.0])
def test_a_slanted_plane_hides_nothing_of_itself(slope: float, offset: float) -> None:
    """As long as the tolerance is what `lfgpu/contract` says."""
    tolerance = 1.001 * abs(slope) / abs(1 - slope * offset)
    np.testing.assert_array_equal(*seen_of_a_slanted_plane(slope, offset, tolerance))


def test_without_tolerance_a_slanted_plane_hides_parts_of_itself() -> None:
    seen, there = seen_of_a_slanted_plane(0.45, 1.0, 0.0)
    assert (there & ~seen).any()
