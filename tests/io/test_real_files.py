"""Real light fields of several cameras and data sets."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from lfgpu.io import read, read_map

DATA = Path(os.environ.get("LFGPU_DATA", Path(__file__).parents[3] / "shared" / "data"))


def real(name: str) -> Path:
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there: set LFGPU_DATA to the folder of the real light fields")
    return folder


def test_real_cotton() -> None:
    light_field = read(real("cotton"))
    assert light_field.views.shape == (81, 512, 512, 3)
    assert (light_field.grid_shape, light_field.reference, light_field.notes) == ((9, 9), 40, ())
    truth, geometry = light_field.reference_truth(), light_field.geometry
    assert truth is not None
    assert geometry is not None
    depth = read_map(real("cotton") / "gt_depth_lowres.pfm")
    assert np.median(np.abs(geometry.depth(truth.disparity) - depth)) < 1e-3


def test_real_kitchen() -> None:
    light_field = read(real("kitchen"))
    assert light_field.views.shape == (34, 512, 512, 3)  # a star of 33, and view 021
    assert light_field.notes == ("34 of 81 views of the 9 x 9 grid are there.",)
    assert light_field.positions[light_field.reference_index].tolist() == [4, 4]
    truth = light_field.reference_truth()
    assert truth is not None
    assert truth.mask is not None
    assert 0.5 < truth.mask.mean() < 1


@pytest.mark.parametrize(
    ("name", "shape", "grid_shape", "notes"),
    [
        (
            "lytro_2067",
            (81, 383, 552, 3),
            (9, 9),
            ["The file names count rows and columns from 1.", "The corners are black: 2.9 %"],
        ),
        ("tao2013_IMG_1", (49, 362, 311, 3), (7, 7), ["Left out 1", "The file names count rows and columns from 0."]),
        ("tao2013_IMG_4", (49, 362, 311, 3), (7, 7), ["Left out 1", "The file names count rows and columns from 0."]),
        ("stillLife_3x3", (9, 768, 768, 3), (3, 3), ["The views are in the folder lf.", "The file names"]),
    ],
)
def test_real_named_views(name: str, shape: tuple[int, ...], grid_shape: tuple[int, int], notes: list[str]) -> None:
    light_field = read(real(name))
    assert (light_field.views.shape, light_field.grid_shape) == (shape, grid_shape)
    assert light_field.reference == shape[0] // 2
    assert len(light_field.notes) == len(notes)
    assert all(note.startswith(start) for note, start in zip(light_field.notes, notes, strict=True))


def test_real_views_move_as_their_truth_says() -> None:
    """The sign convention on real data: the view to the right, read at x - d, looks like the centre view."""
    light_field = read(real("cotton"))
    truth = light_field.reference_truth()
    assert truth is not None
    centre, right, below = (light_field.view(*place)[..., 1].astype(float) for place in ((4, 4), (4, 8), (8, 4)))
    y, x = np.mgrid[20:492, 20:492]
    shift = np.rint(4 * truth.disparity[y, x]).astype(int)

    def mismatch(horizontal: int, vertical: int) -> float:
        errors = right[y, x + horizontal * shift] - centre[y, x], below[y + vertical * shift, x] - centre[y, x]
        return float(np.mean(np.abs(errors)))

    assert mismatch(-1, -1) < 0.5 * min(mismatch(1, 1), mismatch(0, 0))
