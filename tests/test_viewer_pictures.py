"""The pictures and tiles that pages of the viewer draw."""

import numpy as np
import pytest
from walls import SIZE, wall

from lfgpu import scenes
from lfgpu.data import DisparityMap, LightField
from lfgpu.errors import LightFieldError
from lfgpu.viewer import pictures
from lfgpu.viewer.contents import Contents, Entry
from tests.made import masked

WHOLE = (0, 0, pictures.TILE)  # column, row and side of the tile that is the whole of a small picture


@pytest.mark.parametrize(
    ("dtype", "white"), [(np.uint8, None), (np.uint16, None), (np.uint16, 4095), (np.float32, None)]
)
@pytest.mark.parametrize("level", [0, 1, 3])
def test_tiles_are_means_of_intensities(dtype: type, white: int | None, level: int) -> None:
    rng = np.random.default_rng(1)
    top = 1.0 if dtype is np.float32 else white or np.iinfo(dtype).max
    views = (rng.random((2, 30, 531, 3)) * top).astype(dtype)
    lf = LightField(views, [[0, 0], [1, 0]], white=white)
    tiles = [pictures.view_tile(lf, 1, level, column, 0) for column in range(2 if level == 0 else 1)]
    found = np.concatenate(tiles, axis=1) / float(np.iinfo(tiles[0].dtype).max)
    step = 2**level
    padded = np.pad(lf.image(1), ((0, -30 % step), (0, -531 % step), (0, 0)), mode="edge")
    means = padded.reshape(-(-30 // step), step, -(-531 // step), step, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found, means, atol=0.6 / np.iinfo(tiles[0].dtype).max)
    with pytest.raises(LightFieldError, match="no tile"):
        pictures.view_tile(lf, 1, level, 2, 0)
    with pytest.raises(LightFieldError, match="no view 2"):
        pictures.view_tile(lf, 2, level, 0, 0)


def test_maps_come_as_they_are() -> None:
    values = np.random.default_rng(1).standard_normal((600, 700)).astype(np.float32)
    values[3, 5] = np.nan
    np.testing.assert_array_equal(pictures.map_tile(values, 0, 1, 1), values[512:, 512:])
    np.testing.assert_array_equal(pictures.map_tile(values, 2, 0, 0), values[::4, ::4])


@pytest.mark.parametrize(("u", "v"), [(2, 1), (1, 0), (0, 0), (1, 1)])
def test_a_pixel_is_found_in_the_reference_view(u: int, v: int) -> None:
    """A near square before a far wall: behind it the wall is not seen, beside it nothing else is."""
    lf = wall(1.0)
    disparity = np.full(SIZE, -1.0, np.float32)
    disparity[8:16, 10:20] = 3.0
    disparity[0, 0] = np.nan
    contents = Contents(lf, {"mine": Entry(DisparityMap(disparity))})
    offset = u - 1, v - 1
    for x, y in ((12, 10), (25, 20), (17, 14)):
        d = disparity[y, x]
        assert pictures.in_reference(contents, "mine", "final", offset, x - d * (u - 1), y - d * (v - 1)) == (x, y)
    assert pictures.in_reference(contents, "none", "final", offset, 3, 4) == ((3, 4) if (u, v) == (1, 1) else None)


@pytest.mark.parametrize("size", [(40, 48), (37, 43)])
@pytest.mark.parametrize("factor", [2, 4, 8])
def test_small_views_are_in_line_with_large_ones(size: tuple[int, int], factor: int) -> None:
    ramp = np.add.outer(np.arange(size[0]), 2.0 * np.arange(size[1]))[..., None].astype(np.float32)
    small = pictures._middles(ramp, factor)
    assert small.shape == (-(-size[0] // factor), -(-size[1] // factor), 1)
    whole = size[0] // factor, size[1] // factor  # those at the right and the lower end are of fewer pixels
    np.testing.assert_array_equal(
        small[: whole[0], : whole[1]], pictures._reduced(ramp, factor)[: whole[0], : whole[1]]
    )


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("has_mask", [False, True])
def test_computed_tiles_fit_together_to_the_whole_picture(level: int, has_mask: bool) -> None:
    """Points that other surfaces hide, colours from beyond a tile, and sides that no tile divides."""
    lf = scenes.make("boxes", grid=(5, 5), size=(101, 131))
    if has_mask:
        lf = masked(lf, np.s_[3, 30:60, 20:90])
    truth = lf.reference_truth()
    disparity = truth.disparity.copy()
    disparity[40:44, 50:58] = np.nan
    disparity[60:, 20:] = np.where(np.arange(111) % 30 < 12, 4, -4)  # hides what is 16 pixels beside
    contents = Contents(lf).with_entry("map", Entry(DisparityMap(disparity)))
    rows, columns = (-(-side // (32 << level)) for side in lf.size)
    for tile in (
        lambda *place: pictures.refocused(lf, 1.3, None, level, *place),
        lambda *place: pictures.sharp(contents, "map", "final", level, *place),
    ):
        lines = [np.concatenate([tile(column, row, 32) for column in range(columns)], axis=1) for row in range(rows)]
        whole = tile(*WHOLE).astype(int)
        assert whole.shape[:2] == (-(-101 // 2**level), -(-131 // 2**level))
        np.testing.assert_allclose(np.concatenate(lines), whole, atol=1)


def test_levels_end_where_one_pixel_is_the_whole_picture() -> None:
    lf = wall(1.0)
    assert pictures.view_tile(lf, 0, 5, 0, 0).shape == (1, 1, 1)
    for level in (-1, 6, 16):  # of 65536 x 65536 pixels
        with pytest.raises(LightFieldError, match="no tile"):
            pictures.view_tile(lf, 0, level, 0, 0)
    for side in (0, pictures.TILE + 1):
        with pytest.raises(LightFieldError, match="no tile"):
            pictures.refocused(lf, 0.0, None, 0, 0, 0, side)
