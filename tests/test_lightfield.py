"""The light field: what it keeps, how it is looked at, what is made from it, what it refuses."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.errors import LightFieldError
from lfgpu.scenes import make

ROWS, COLUMNS, HEIGHT, WIDTH = 3, 5, 6, 8


def grid(dtype: Any = np.uint8, channels: int = 3) -> NDArray[Any]:
    """[v, u, y, x, c] of random values."""
    values = np.random.default_rng(3).random((ROWS, COLUMNS, HEIGHT, WIDTH, channels))
    return values.astype(dtype) if dtype == np.float32 else (values * np.iinfo(dtype).max).astype(dtype)


@pytest.fixture
def views() -> NDArray[np.uint8]:
    return grid()


@pytest.fixture
def light_field(views: NDArray[np.uint8]) -> LightField:
    return LightField.from_grid(views, name="scene")


def test_sign_convention() -> None:
    """A point at (x, y) of the reference is at (x - d*du, y - d*dv): nearer points (larger d) move further.

    The camera that stands to the right (du = 1) sees a near point further left; the one below (dv = 1) further up.
    """
    disparity, x, y = 2, 4, 5
    views = np.zeros((3, 3, 10, 10), np.uint8)
    for v in range(3):
        for u in range(3):
            views[v, u, y - disparity * (v - 1), x - disparity * (u - 1)] = 255
    light_field = LightField.from_grid(views)
    assert light_field.view(1, 1)[y, x, 0] == 255
    assert light_field.view(1, 2)[5, 2, 0] == 255  # right of the reference: the point is further left
    assert light_field.view(2, 1)[3, 4, 0] == 255  # below the reference: the point is further up
    for index, (du, dv) in enumerate(light_field.offsets.astype(int)):
        assert light_field.views[index, y - disparity * dv, x - disparity * du, 0] == 255


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3])
def test_values_and_dtype_are_kept(dtype: Any, channels: int) -> None:
    values = grid(dtype, channels)
    light_field = LightField.from_grid(values)
    assert light_field.views.dtype == dtype
    assert light_field.channels == channels
    np.testing.assert_array_equal(light_field.views.reshape(values.shape), values)
    image = light_field.image(2)
    assert image.dtype == np.float32
    full = 1.0 if dtype == np.float32 else float(np.iinfo(dtype).max)
    np.testing.assert_allclose(image, values[0, 2] / full, rtol=1e-6)


def test_the_middle_view_is_the_reference(light_field: LightField) -> None:
    assert light_field.reference_index == light_field.index_of(1, 2)
    np.testing.assert_array_equal(light_field.offsets[0], [-2, -1])  # (du, dv) of the upper left view
    assert (light_field.grid_shape, light_field.size, light_field.missing) == ((3, 5), (HEIGHT, WIDTH), ())
    light_field = LightField.from_grid(np.zeros((2, 4, 5, 5), np.uint8))
    np.testing.assert_array_equal(light_field.positions[light_field.reference_index], [2, 1])
    light_field = LightField(np.zeros((3, 4, 4), np.uint8), np.array([[0, 0], [1.5, 0.2], [4, -1]]))
    assert light_field.reference == 1  # nearest to the middle (2, -0.5)
    np.testing.assert_allclose(light_field.offsets[2], [2.5, -1.2])
    assert light_field.missing == ()


def test_views_and_epis_are_slices_in_the_order_of_positions(light_field: LightField, views: NDArray[np.uint8]) -> None:
    for v in range(ROWS):
        for u in range(COLUMNS):
            np.testing.assert_array_equal(light_field.view(v, u), views[v, u])
    np.testing.assert_array_equal(light_field.epi_horizontal(4), views[1, :, 4])
    np.testing.assert_array_equal(light_field.epi_vertical(7), views[:, 2, :, 7])
    moved = light_field.with_reference(light_field.index_of(0, 4))
    np.testing.assert_array_equal(moved.epi_horizontal(4), views[0, :, 4])
    np.testing.assert_array_equal(moved.epi_vertical(7), views[:, 4, :, 7])
    order = np.random.default_rng(0).permutation(ROWS * COLUMNS)
    plain = LightField.from_grid(views)
    shuffled = LightField(plain.views[order], plain.positions[order])
    np.testing.assert_array_equal(shuffled.epi_horizontal(0), views[1, :, 0])
    np.testing.assert_array_equal(shuffled.epi_vertical(0), views[:, 2, :, 0])


def test_a_change_of_reference_changes_offsets_only(light_field: LightField) -> None:
    moved = light_field.with_reference(light_field.index_of(2, 0))
    np.testing.assert_array_equal(moved.offsets[moved.reference_index], [0, 0])
    np.testing.assert_array_equal(moved.offsets[0], [0, -2])
    np.testing.assert_array_equal(moved.positions, light_field.positions)
    assert moved.views is light_field.views


@pytest.mark.parametrize(
    ("pattern", "places"),
    [
        ("full", [(v, u) for v in range(3) for u in range(5)]),
        ("cross", [(0, 2), (1, 0), (1, 1), (1, 2), (1, 3), (1, 4), (2, 2)]),
        ("star", [(0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2), (1, 3), (1, 4), (2, 1), (2, 2), (2, 3)]),
        ("row", [(1, 0), (1, 1), (1, 2), (1, 3), (1, 4)]),
        ("column", [(0, 2), (1, 2), (2, 2)]),
    ],
)
def test_pattern_subsets(light_field: LightField, pattern: str, places: list[tuple[int, int]]) -> None:
    part = light_field.subset(pattern)
    assert [(v, u) for u, v in part.positions.astype(int).tolist()] == places
    assert part.positions[part.reference_index].tolist() == [2, 1]
    for v, u in places:
        np.testing.assert_array_equal(part.view(v, u), light_field.view(v, u))
    assert set(part.missing) == {(v, u) for v in range(3) for u in range(5)} - set(places)


def test_subsets_keep_the_reference_and_the_masks(light_field: LightField, views: NDArray[np.uint8]) -> None:
    part = light_field.with_reference(0).subset("cross")
    assert len(part.views) == 7
    assert {tuple(p) for p in part.positions.astype(int).tolist()} == {(u, 0) for u in range(5)} | {(0, 1), (0, 2)}
    valid = np.random.default_rng(0).random((15, HEIGHT, WIDTH)) > 0.5
    part = LightField.from_grid(views, valid=valid).subset([0, 14])
    np.testing.assert_array_equal(part.positions, [[0, 0], [2, 1], [4, 2]])
    assert part.reference == 1
    assert part.valid is not None
    np.testing.assert_array_equal(part.valid, valid[[0, 7, 14]])
    assert light_field.subset("full") is light_field
    assert light_field.subset(range(len(light_field.views))) is light_field
    diagonal = LightField(np.zeros((3, 2, 2), np.uint8), np.array([[0, 0], [1, 1], [2, 2]]), name="diagonal")
    with pytest.raises(LightFieldError, match="diagonal: the subset 'row' leaves the reference view alone"):
        diagonal.subset("row")


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"disparity": [1, 2]}, r"disparity must be \[y, x\], found shape \(2,\)"),
        ({"disparity": [["near"]]}, "disparity must be an array of numbers"),
        ({"disparity": np.full((1, 2), 1 + 1j)}, "disparity must be an array of numbers: complex numbers"),
        ({"disparity": [[10**400, 0]]}, "disparity must be an array of numbers"),
        ({"position": 3}, r"position must be a pair of numbers \(u, v\), not 3"),
        ({"position": (0, float("nan"))}, "position must be a pair of numbers"),
        ({"mask": [[1, 1]]}, r"mask must be bool \(1, 2\), found int64 \(1, 2\)"),
        ({"mask": [[True]]}, r"mask must be bool \(1, 2\), found bool \(1, 1\)"),
    ],
)
def test_a_truth_of_another_form_is_refused(fields: dict[str, object], words: str) -> None:
    with pytest.raises(LightFieldError, match=words):
        GroundTruth(**{"disparity": [[1, 2]], "position": (0, 0), **fields})  # type: ignore[arg-type]


def test_crop_takes_geometry_masks_and_truth_along(views: NDArray[np.uint8]) -> None:
    disparity = np.arange(HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    truth = GroundTruth(disparity, (2.0, 1.0), mask=disparity % 2 == 0)
    valid = np.random.default_rng(0).random((15, HEIGHT, WIDTH)) > 0.5
    light_field = LightField.from_grid(views, geometry=Geometry(100.0, 0.1), truth=truth, valid=valid)
    part = light_field.crop(np.s_[1:5], np.s_[2:])
    window = np.s_[1:5, 2:8]
    np.testing.assert_array_equal(part.view(0, 3), views[0, 3][window])
    np.testing.assert_array_equal(part.valid[4], valid[4][window])
    assert part.truth.mask is not None
    np.testing.assert_array_equal(part.truth.disparity, disparity[window])
    np.testing.assert_array_equal(part.truth.mask, (disparity % 2 == 0)[window])
    # the middle of 8 x 6 pixels is (3.5, 2.5); the window begins at (2, 1)
    assert part.geometry == Geometry(100.0, 0.1, principal_point=(1.5, 1.5))
    again = part.crop(np.s_[1:], np.s_[1:-1])
    assert again.geometry == Geometry(100.0, 0.1, principal_point=(0.5, 0.5))
    assert again.size == (3, 4)


def test_truth_belongs_to_one_view(views: NDArray[np.uint8]) -> None:
    truth = GroundTruth(np.zeros((HEIGHT, WIDTH), np.float32), position=(2.0, 1.0))
    light_field = LightField.from_grid(views, truth=truth)
    assert light_field.reference_truth() is truth
    assert light_field.with_reference(0).reference_truth() is None
    assert LightField.from_grid(views).reference_truth() is None


def test_downsampled_means_blocks(views: NDArray[np.uint8], light_field: LightField) -> None:
    valid = np.ones((15, HEIGHT, WIDTH), np.bool_)
    valid[0, 5, 7] = False
    coarse = LightField.from_grid(views, valid=valid, geometry=Geometry(1.0, 1.0)).downsampled(2)
    assert coarse.views.shape == (15, 3, 4, 3)
    assert coarse.views.dtype == np.float32
    np.testing.assert_allclose(coarse.view(2, 4)[1, 3], views[2, 4, 2:4, 6:8].mean(axis=(0, 1)) / 255, rtol=1e-5)
    assert not coarse.valid[0, 2, 3]
    assert coarse.valid.sum() == 15 * 12 - 1
    assert (coarse.geometry, coarse.truth) == (None, None)
    # Up to what fills no block, which is left out at the end.
    rng = np.random.default_rng(0)
    fine = LightField.from_grid(rng.integers(0, 256, (3, 3, 75, 93, 3), np.uint8), valid=rng.random((9, 75, 93)) < 0.99)
    once, twice = fine.downsampled(8), fine.downsampled(4).downsampled(2)
    assert once.views.shape == twice.views.shape == (9, 9, 11, 3)
    np.testing.assert_allclose(twice.views, once.views, rtol=1e-5)
    assert np.array_equal(once.valid, twice.valid)
    assert 0 < once.valid.mean() < 1
    assert light_field.downsampled(4).size == (1, 2)
    assert light_field.downsampled(1).size == (HEIGHT, WIDTH)


def views_of(n: int = 3, **changes: Any) -> dict[str, Any]:
    """Arguments of a good light field of n views in a row, with changes."""
    positions = np.stack([np.arange(n), np.zeros(n)], axis=1)
    return {"views": np.zeros((n, 4, 4, 3), np.uint8), "positions": positions} | changes


def test_good_arguments_are_good_and_positions_are_copied() -> None:
    assert LightField(**views_of()).reference == 1
    with pytest.raises(LightFieldError, match=r"\(3, 4, 4\)"):
        LightField.from_grid(np.zeros((3, 4, 4), np.uint8))
    with pytest.raises(LightFieldError, match=r"\(9, 16, 20, 3\) is the shape of a list of views"):
        LightField.from_grid(np.zeros((9, 16, 20, 3), np.uint8))
    positions = np.array([[0.0, 0.0], [1.0, 0.0]])
    light_field = LightField(np.zeros((2, 3, 3), np.uint8), positions)
    positions[:] = 7
    np.testing.assert_array_equal(light_field.positions, [[0, 0], [1, 0]])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"views": np.zeros((3, 4, 4, 2), np.uint8)}, ["c = 1 or 3", "(3, 4, 4, 2)"]),
        ({"views": np.zeros((4, 4), np.uint8)}, ["[n, y, x]", "(4, 4)"]),
        ({"views": np.zeros((3, 0, 4), np.uint8)}, ["(3, 0, 4, 1)"]),
        ({"views": np.zeros((3, 4, 4))}, ["float64"]),
        ({"views": np.zeros((3, 4, 4), np.int16)}, ["int16"]),
        ({"views": np.full((3, 4, 4), np.nan, np.float32)}, ["view 0 (row 0, column 0)", "NaN"]),
        ({"views": np.full((3, 4, 4), 255, np.float32)}, ["view 0", "255", "[0, 1]"]),
        (
            {"views": np.linspace(-0.5, 0.5, 48, dtype=np.float32).reshape(3, 4, 4)},
            ["from -0.5 to 0.5, on both sides of 0", "[0, 1]"],
        ),
        (views_of(1), ["a single view", "at least two"]),
        ({"positions": np.zeros((2, 2))}, ["positions", "3", "(2, 2)"]),
        ({"positions": np.full((3, 2), np.nan)}, ["positions", "finite"]),
        ({"positions": np.array([[0, 0], [1, 2], [1, 2]])}, ["two views", "row 2", "column 1"]),
        ({"reference": 3}, ["reference view 3", "0 to 2"]),
        ({"reference": -1}, ["reference view -1"]),
        ({"valid": np.ones((3, 4, 5), np.bool_)}, ["valid", "(3, 4, 5)"]),
        ({"valid": np.ones((3, 4, 4), np.uint8)}, ["valid", "uint8"]),
        ({"truth": GroundTruth(np.zeros((4, 5), np.float32), (1.0, 0.0))}, ["truth", "(4, 4)", "(4, 5)"]),
        ({"white": 256}, ["white", "from 1 to 255"]),
        ({"grid_shape": (1, 2)}, ["positions", "1 x 2", "0 to 2"]),
        (
            {"grid_shape": (1, 3), "positions": np.array([[0, 0], [0.5, 0], [1, 0]])},
            ["integers in the grid", "counted from 0"],
        ),
    ],
)
def test_what_is_no_light_field_is_refused(changes: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(LightFieldError) as error:
        LightField(**(views_of() | changes))
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    ("words", "ask"),
    [
        ("scene has no view at row 7, column 0; rows span 0 to 2", lambda lf: lf.view(7, 0)),
        ("reference view 15 does not exist", lambda lf: lf.with_reference(15)),
        ("unknown view pattern 'ring'", lambda lf: lf.subset("ring")),
        ("view indices must be from 0 to 14", lambda lf: lf.subset([15])),
        ("leaves the reference view alone", lambda lf: lf.subset([7])),
        ("must have no step and leave pixels", lambda lf: lf.crop(np.s_[4:4], np.s_[:])),
        ("must have no step", lambda lf: lf.crop(np.s_[::2], np.s_[:])),
        ("to 6, not 7", lambda lf: lf.downsampled(7)),
        ("to 6, not 0", lambda lf: lf.downsampled(0)),
        ("crop needs slices", lambda lf: lf.crop(3, 4)),
        ("factor must be a whole number from 1 to 6, not 1.5", lambda lf: lf.downsampled(1.5)),
        ("row must be a number, not 'a'", lambda lf: lf.index_of("a", 0)),
        ("column must be a number, not 1000", lambda lf: lf.index_of(0, 10**400)),
        ("index of a view must be a whole number from -15 to 14, not 99", lambda lf: lf.image(99)),
        ("row of pixels must be a whole number", lambda lf: lf.epi_horizontal(999)),
        ("baseline_m must be a positive number, not '1'", lambda lf: Geometry(100, "1")),
    ],
)
def test_requests_that_cannot_be_met(light_field: LightField, words: str, ask: Callable[[LightField], object]) -> None:
    with pytest.raises(LightFieldError) as error:
        ask(light_field)
    assert words in str(error.value)


def test_fields_and_arguments_of_another_type() -> None:
    lf = make("planes", grid=(3, 3), size=(8, 8))
    fields: list[tuple[str, Any, str]] = [
        ("name", 5, "name must be a str, not int"),
        ("grid_shape", "33", "grid_shape must be .rows, columns., whole numbers from 1 on, not '33'"),
        ("truth", np.zeros((8, 8), np.float32), "truth must be a GroundTruth, not ndarray"),
        ("geometry", "x", "geometry must be a Geometry, not str"),
        ("notes", 5, "notes must be a sequence of texts, not 5"),
        ("files", 5, "files must be a sequence of texts, not 5"),
    ]
    for name, value, message in fields:
        with pytest.raises(LightFieldError, match=message):
            LightField(lf.views, lf.positions, **{name: value})
    choices: list[Any] = [None, [0.9, 2.7], ["a"], np.ones(5, bool), [[0, 1], [2, 3]]]
    for which in choices:
        with pytest.raises(LightFieldError, match=r"indices, or a mask bool \[9\]"):
            lf.subset(which)


def test_masked_arrays_say_what_is_valid() -> None:
    views = make("planes", grid=(3, 3), size=(8, 8)).views.reshape(3, 3, 8, 8, 3)
    masked = np.ma.masked_array(views, mask=np.zeros(views.shape, bool))
    masked[1, 2, 3, 4, 0] = np.ma.masked
    lf = LightField.from_grid(masked)
    assert lf.valid is not None
    assert np.argwhere(~lf.valid).tolist() == [[5, 3, 4]]
    flat = LightField(masked.reshape(9, 8, 8, 3), lf.positions)
    np.testing.assert_array_equal(flat.valid, lf.valid)
