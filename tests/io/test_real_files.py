"""Real light fields of several cameras and data sets."""

from typing import Any

import numpy as np
import pytest
from conftest import real_data
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.io import parallax, read, read_map
from lfgpu.io.flips import flipped
from lfgpu.io.images import read_image
from tests.made import thorough


def moves_as(light_field: LightField, disparity: NDArray[Any], step: int = 1) -> bool:
    """Whether views to the right and below, looked up at x - d, look like the reference; those at x + d do not."""
    row, column = light_field.positions[light_field.reference_index][::-1]
    centre, right, below = (
        light_field.view(*place)[..., 1].astype(float)
        for place in ((row, column), (row, column + step), (row + step, column))
    )
    height, width = light_field.size
    y, x = np.mgrid[30 : height - 30, 30 : width - 30]
    shift = np.rint(step * np.nan_to_num(disparity[y, x])).astype(int)
    right_way, wrong_way, still = (
        np.abs([right[y, x + sign * shift] - centre[y, x], below[y + sign * shift, x] - centre[y, x]]).mean()
        for sign in (-1, 1, 0)
    )
    return bool(right_way < 0.5 * min(wrong_way, still))


def test_real_cotton() -> None:
    light_field = read(real_data("cotton"))
    assert light_field.views.shape == (81, 512, 512, 3)
    assert (light_field.grid_shape, light_field.reference, light_field.notes) == ((9, 9), 40, ())
    truth, geometry = light_field.reference_truth(), light_field.geometry
    depth = read_map(real_data("cotton") / "gt_depth_lowres.pfm")
    assert np.median(np.abs(geometry.depth(truth.disparity) - depth)) < 1e-3
    assert moves_as(light_field, truth.disparity, step=4)


def test_real_kitchen() -> None:
    light_field = read(real_data("kitchen"))
    assert light_field.views.shape == (34, 512, 512, 3)  # a star of 33, and view 021
    assert light_field.notes == ("34 of 81 views of the 9 x 9 grid are there.",)
    assert light_field.positions[light_field.reference_index].tolist() == [4, 4]
    truth = light_field.reference_truth()
    assert 0.5 < truth.mask.mean() < 1


@pytest.mark.parametrize(
    ("name", "shape", "grid_shape", "notes"),
    [
        ("lytro_2067", (81, 383, 552, 3), (9, 9), ["The corners are black: 2.9 %"]),
        ("tao2013_IMG_1", (49, 362, 311, 3), (7, 7), ["Left out 1"]),
        ("tao2013_IMG_4", (49, 362, 311, 3), (7, 7), ["Left out 1"]),
        ("stillLife_3x3", (9, 768, 768, 3), (3, 3), ["The views are in the folder lf."]),
    ],
)
def test_real_named_views(name: str, shape: tuple[int, ...], grid_shape: tuple[int, int], notes: list[str]) -> None:
    light_field = read(real_data(name), format="named-views")
    assert (light_field.views.shape, light_field.grid_shape) == (shape, grid_shape)
    assert light_field.reference == shape[0] // 2
    assert len(light_field.notes) == len(notes)
    assert all(note.startswith(start) for note, start in zip(light_field.notes, notes, strict=True))


def test_real_export_of_an_old_scene() -> None:
    folder = real_data("stillLife_3x3")
    light_field = read(folder)
    truth, published = light_field.reference_truth(), read_map(folder / "gt_disp_3x3.pfm")
    assert np.abs(truth.disparity - published).max() < 1e-4
    depth = np.fromfile(folder / "depth.bin", "<f4").reshape(light_field.size)
    assert np.abs(light_field.geometry.depth(truth.disparity) - depth).max() < 1e-4
    assert moves_as(light_field, truth.disparity)


def test_real_stanford_names() -> None:
    """The floor before the knights is nearer than the wall behind them, in the directions that the names say."""
    light_field = read(real_data("real/stanford_knights"))
    assert light_field.views.shape == (289, 256, 256, 3)
    assert light_field.notes == (
        "One view step is 8.70886 in the unit of the names, the median distance of neighbours.",
    )
    for axis in (0, 1):
        measured = parallax.measured(light_field, axis)
        assert measured is not None
        disparity, weight = measured
        wall, floor = (
            float(np.average(disparity[rows], weights=weight[rows])) for rows in (slice(12), slice(-8, None))
        )
        assert wall < -0.5 < 0.5 < floor


def test_real_row_of_cameras() -> None:
    folder = real_data("mansion") / "images"
    light_field = read(folder)
    assert (light_field.views.shape, light_field.grid_shape) == ((51, 200, 300, 3), (1, 51))
    measured = parallax.measured(light_field.subset(range(20, 31)), axis=0)
    assert measured is not None
    published, _ = read_image(real_data("mansion") / "mansion_depth" / "mansion_depth_0050.png")
    blocks = published[..., 0].astype(float).reshape(50, 4, 75, 4).mean(axis=(1, 3))
    # The frames are not shifted: all disparities are positive, and brighter, nearer places have larger ones.
    disparity, weight = measured
    far, near = blocks < np.percentile(blocks, 30), blocks > np.percentile(blocks, 80)
    means = [float((disparity * weight)[place].sum() / weight[place].sum()) for place in (far, near)]
    assert -0.05 < means[0] < 0.15 < 0.3 < means[1]


@pytest.mark.parametrize(
    "name", [*("cotton", "kitchen", "stillLife_3x3", "tao2013_IMG_1"), *map(thorough, ("lytro_2067", "tao2013_IMG_4"))]
)
def test_real_axes_run_alike(name: str) -> None:
    light_field = read(real_data(name))
    assert parallax.axes_agree(light_field) is True
    assert parallax.axes_agree(flipped(light_field, "v")) is False
