"""Occlusions in the reference backend against independent truths: the formulas as loops, and central differences."""

import math
from types import SimpleNamespace

import numpy as np
import occlusion_checks
import pytest
from checks import Operation, compute
from occlusion_cases import OCCLUSION_CASES, OcclusionCase, occlusion_inputs
from test_reference import REFERENCE, tent_of_any

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


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_visible_is_what_comparing_every_two_pixels_says(case: OcclusionCase, rng: np.random.Generator) -> None:
    i = occlusion_inputs(case, rng)
    got, want = run(occlusion_checks.VISIBLE, i)["visible"], occlusion_checks.seen(i)
    decided = np.ones(got.shape, np.bool_) if case.exact else ~occlusion_checks.undecided(i)
    assert decided.mean() > 0.95
    np.testing.assert_array_equal(got[decided], want[decided])


def seen_of_a_slanted_plane(slope: float, offset: float, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the seen part of a plane of that slope, and the part that lands in the frame."""
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
