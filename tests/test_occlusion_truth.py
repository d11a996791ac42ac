"""Does what is true explain the views best? Both data terms on ray-cast scenes with occlusions, started from the truth.

Raw intensities, no prior: what moves the map is the data term alone. The figures in the texts are of the seed that is
used; the bounds leave room for other machines, not for another model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.contract import DataTerm, Device
from lfgpu.solvers.lbfgs import BoundedLbfgs

KERNELS, DEVICE = load("warp"), "cpu"
SIZE, GRID, BORDER = (64, 80), (5, 5), 8
BOUNDS = (-2.0, 2.0)


@dataclass(frozen=True)
class Scene:
    """The truth, and the two data terms of one light field, as means over views and channels."""

    truth: np.ndarray
    plain: Callable[[Any, Any, Any], None]
    occluding: Callable[[Any, Any, Any], None]

    def moved(self, disparity: np.ndarray) -> float:
        """The share of pixels that are off by more than 0.07, without the border."""
        inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
        return float((np.abs(disparity - self.truth)[inner] > 0.07).mean())


@pytest.fixture(scope="module", params=["bars", "planes"])
def scene(request: pytest.FixtureRequest) -> Scene:
    lf = scenes.make(request.param, seed=1, grid=GRID, size=SIZE)
    there = lf.reference_truth()
    assert there is not None
    views, offsets = KERNELS.image(lf.views, DEVICE), KERNELS.field(lf.offsets, DEVICE)
    image = KERNELS.zeros_image((*SIZE, 3), DEVICE)
    KERNELS.intensities(views, lf.reference_index, None, scale=lf.scale, fill=0.0, image_out=image)
    seen = KERNELS.zeros(lf.views.shape[:3], DEVICE)
    KERNELS.seen_by_reference(KERNELS.field(there.disparity, DEVICE), offsets, None, None, seen_out=seen)
    mean = 1 / ((len(lf.views) - 1) * 3)

    def averaged(term: DataTerm) -> Callable[[Any, Any, Any], None]:
        term.load(image, views, seen)

        def evaluate(disparity: Any, gradient_out: Any, value_out: Any) -> None:
            term(disparity, gradient_out, value_out)
            KERNELS.axpby(mean, value_out, 0.0, value_out, value_out)
            KERNELS.axpby(mean, gradient_out, 0.0, gradient_out, gradient_out)

        return evaluate

    plain = KERNELS.data_term(lf.views.shape, offsets, scale=lf.scale, softness=0.1)
    occluding = KERNELS.z_buffered_data_term(
        lf.views.shape,
        offsets,
        scale=lf.scale,
        softness=0.1,
        sharpness=10.0,
        least_coverage=0.5,
        loss="squares",
        loss_scale=1.0,
    )
    return Scene(there.disparity.astype(float), averaged(plain), averaged(occluding))


def value_and_gradient(term: Callable[[Any, Any, Any], None], disparity: np.ndarray) -> tuple[float, np.ndarray]:
    gradient, value = KERNELS.zeros(SIZE, DEVICE), KERNELS.scalar(0.0, DEVICE)
    term(KERNELS.field(disparity, DEVICE), gradient, value)
    return KERNELS.number(value), KERNELS.numpy(gradient).astype(float)


def after_lbfgs(term: Callable[[Any, Any, Any], None], start: np.ndarray) -> np.ndarray:
    """30 iterations, or fewer if the line search finds nothing lower."""
    solver = BoundedLbfgs(SIZE, BOUNDS, Device(KERNELS, DEVICE), tolerance=0.0, max_iterations=30)
    found = KERNELS.field(start, DEVICE)
    solver.minimize(term, found)
    return KERNELS.numpy(found)


def after_small_steps(term: Callable[[Any, Any, Any], None], start: np.ndarray, steps: int = 60) -> np.ndarray:
    """Steps of at most about 0.01 px in each pixel by itself (Adam, Kingma and Ba 2015), with no line search to stop.

    At the rims of what is near, the gradient is a hundred times what it is elsewhere, and only for a thousandth of a
    pixel: a line search over all pixels ends there. So that L-BFGS stays near the truth says little by itself.
    """
    disparity, mean, square = start.copy(), np.zeros(SIZE), np.zeros(SIZE)
    for k in range(1, steps + 1):
        _, gradient = value_and_gradient(term, disparity)
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.99 * square + 0.01 * gradient**2
        direction = mean / (1 - 0.9**k) / (np.sqrt(square / (1 - 0.99**k)) + 1e-6)
        disparity = np.clip(disparity - 0.01 * min(1.0, 2 - 2 * k / steps) * direction, *BOUNDS)
    return disparity


def test_truth_explains_the_views_much_better_with_occlusions(scene: Scene) -> None:
    """By 22 times on bars, 9 times on planes."""
    plain, occluding = (value_and_gradient(term, scene.truth)[0] for term in (scene.plain, scene.occluding))
    assert occluding < 0.2 * plain


def test_lbfgs_leaves_the_truth_without_occlusions_only(scene: Scene) -> None:
    """bars: 39 % of the pixels without, 2.3 % with occlusions; planes: 70 % and 0.9 %."""
    plain, occluding = (scene.moved(after_lbfgs(term, scene.truth)) for term in (scene.plain, scene.occluding))
    assert occluding < 0.1
    assert occluding < 0.2 * plain


def test_with_occlusions_a_wrong_map_comes_nearer_to_the_truth(scene: Scene) -> None:
    """47 % of the pixels are wrong at first; then 11 % on bars and 19 % on planes, as many as from the truth itself.

    Without occlusions it becomes 52 % and 70 %.
    """
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    wrong = scene.truth + 0.2 * np.sin(x / 7 + 1) * np.cos(y / 9)
    plain, occluding = (scene.moved(after_small_steps(term, wrong)) for term in (scene.plain, scene.occluding))
    assert scene.moved(wrong) > 0.4
    assert plain > scene.moved(wrong)
    assert occluding < 0.5 * scene.moved(wrong)
