"""Views in files that are named by row and column, and grids with holes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from samples import HEIGHT, WIDTH, box, cross, picture, refusal, save, save_named, star

from lfgpu.io import read


@pytest.mark.parametrize(
    "pattern",
    [
        "view_{0:02d}_{1:02d}.png",
        "2067_{0:02d}_{1:02d}.png",
        "{0}_{1}.bmp",
        "img-{0}-{1}.tif",
        "r{0}c{1}.PNG",
        "{0:02d}_{1:02d}.png",
        "Straße 7 – ({0}, {1}) final.png",
        "lf_v{0:03d}u{1:03d}.TIFF",
    ],
)
def test_common_names(tmp_path: Path, pattern: str) -> None:
    light_field = read(save_named(tmp_path, box(2, 3), pattern))
    assert light_field.grid_shape == (2, 3)
    for row, column in box(2, 3):
        np.testing.assert_array_equal(light_field.view(row, column), picture(100 * row + column))
    assert light_field.name == tmp_path.name
    assert light_field.notes == ("The file names count rows and columns from 0.",)


def test_jpeg_views(tmp_path: Path) -> None:
    light_field = read(save_named(tmp_path, box(2, 2), "img-{0}-{1}.jpg"))
    assert light_field.views.shape == (4, HEIGHT, WIDTH, 3)


def test_rows_are_v_and_columns_are_u(tmp_path: Path) -> None:
    light_field = read(save_named(tmp_path, box(2, 3)))
    np.testing.assert_array_equal(light_field.positions, [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]])
    assert light_field.reference == 4  # row 2 // 2, column 3 // 2


def test_numbers_may_start_at_1_and_need_no_leading_zeros(tmp_path: Path) -> None:
    light_field = read(save_named(tmp_path, box(11, 2, first=1), "{0}_{1}.png"))
    assert light_field.grid_shape == (11, 2)
    np.testing.assert_array_equal(light_field.view(10, 1), picture(1102))
    assert light_field.notes == ("The file names count rows and columns from 1.",)


def test_one_row_of_a_larger_grid_is_a_row(tmp_path: Path) -> None:
    light_field = read(save_named(tmp_path / "row", [(0, column) for column in range(1, 6)]))
    assert light_field.grid_shape == (1, 5)
    assert light_field.notes == ("All views are in row 0 of the file names, which count columns from 1.",)
    light_field = read(save_named(tmp_path / "column", [(row, 4) for row in range(3)]))
    assert light_field.grid_shape == (3, 1)
    assert light_field.notes == ("All views are in column 4 of the file names, which count rows from 0.",)


def test_a_lost_first_row_is_noticed(tmp_path: Path) -> None:
    places = [(row, column) for row in range(1, 5) for column in range(5)]
    assert "row 0 column 0" in refusal(lambda: read(save_named(tmp_path, places)))


def test_other_images_are_left_out_with_a_note(tmp_path: Path) -> None:
    save_named(tmp_path, box(2, 2))
    for name in ("thumbnail.png", "IMG_1.jpg", "at_20230101_12.png", "at_12_20230101.png"):
        save(tmp_path / name)
    for name in ("._view_00_00.png", "readme.txt", "depth_1_2.pfm"):
        (tmp_path / name).write_text("no image, and nothing to mention")
    light_field = read(tmp_path)
    assert len(light_field.views) == 4
    assert light_field.notes[0] == (
        "Left out 4 of the images, not named by row and column: IMG_1.jpg, at_12_20230101.png, "
        "at_20230101_12.png and 1 more."
    )


def test_views_in_a_sub_folder(tmp_path: Path) -> None:
    save(tmp_path / "mask.png")
    save_named(tmp_path / "lf", box(2, 2))
    (tmp_path / "empty").mkdir()
    light_field = read(tmp_path)
    assert light_field.name == tmp_path.name
    assert light_field.notes[0] == "The views are in the folder lf."
    save_named(tmp_path / "masks", box(2, 2))
    assert "(lf, masks); give one" in refusal(lambda: read(tmp_path))
    save_named(tmp_path, box(2, 3))
    assert read(tmp_path).grid_shape == (2, 3)


def test_files_of_several_scenes_are_refused(tmp_path: Path) -> None:
    save_named(tmp_path, box(2, 2), "2067_{0}_{1}.png")
    save_named(tmp_path, [(2, 2)], "2068_{0}_{1}.png")
    text = refusal(lambda: read(tmp_path))
    assert str(tmp_path) in text
    assert "named in different ways: 2067_0_0.png and 2068_2_2.png" in text


@pytest.mark.parametrize("other", ["01_01.png", "1_1.bmp", "1_1.PNG"])
def test_two_files_for_one_place_are_refused(tmp_path: Path, other: str) -> None:
    save_named(tmp_path, box(2, 2), "{0}_{1}.png")
    save(tmp_path / other)
    text = refusal(lambda: read(tmp_path))
    assert "row 1, column 1" in text
    assert "1_1.png" in text
    assert other in text


def test_mixed_suffixes_are_noted(tmp_path: Path) -> None:
    save_named(tmp_path, [(0, 0)], "{0}_{1}.png")
    save_named(tmp_path, [(0, 1)], "{0}_{1}.bmp")
    assert "The views are of different kinds: .bmp, .png." in read(tmp_path).notes


def test_one_view_is_not_enough(tmp_path: Path) -> None:
    text = refusal(lambda: read(save_named(tmp_path, [(3, 4)])))
    assert str(tmp_path) in text
    assert "one view only (view_03_04.png)" in text


# --- grids with holes ---


@pytest.mark.parametrize("places", [cross(3), star(5)], ids=["cross", "star"])
def test_patterns_of_more_than_half_of_the_views_are_meant(tmp_path: Path, places: set[tuple[int, int]]) -> None:
    light_field = read(save_named(tmp_path, places))
    assert len(light_field.views) == len(places)
    assert light_field.notes == ("The file names count rows and columns from 0.",)
    assert light_field.missing == tuple(sorted(set(box(*light_field.grid_shape or (0, 0))) - places))


def test_lost_views_are_named(tmp_path: Path) -> None:
    lost = {(0, 3), (2, 1)}
    save_named(tmp_path, set(box(4, 4)) - lost)
    text = refusal(lambda: read(tmp_path))
    assert str(tmp_path) in text
    assert "lacks 2 of the 16 views" in text
    assert "row 0 column 3, row 2 column 1" in text
    assert "allow_missing=True" in text
    assert "--allow-missing" in text
    light_field = read(tmp_path, allow_missing=True)
    assert set(light_field.missing) == lost
    assert "14 of 16 views of the 4 x 4 grid are there." in light_field.notes


def test_many_lost_views_are_not_all_named(tmp_path: Path) -> None:
    text = refusal(lambda: read(save_named(tmp_path, box(5, 5)[:6] + box(5, 5)[12:])))
    assert "lacks 6" in text
    assert text.count("column") == 5
    assert ", ..." in text


def test_sparse_grids_pass_with_a_note(tmp_path: Path) -> None:
    places = [(0, 0), (0, 2), (1, 1), (2, 2)]
    light_field = read(save_named(tmp_path, places))
    assert "4 of 9 views of the 3 x 3 grid are there." in light_field.notes


def test_without_the_centre_view_the_nearest_is_the_reference(tmp_path: Path) -> None:
    light_field = read(save_named(tmp_path, set(box(3, 3)) - {(1, 1)}), allow_missing=True)
    row, column = light_field.positions[light_field.reference_index][::-1].astype(int)
    assert abs(row - 1) + abs(column - 1) == 1
    assert light_field.notes[-1] == (
        f"The centre view (row 1, column 1) is missing; the reference is the view at row {row}, column {column}."
    )
