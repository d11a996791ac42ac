"""Views in files that are named by row and column, and grids with holes."""

from pathlib import Path

import numpy as np
import pytest
from lenslet_samples import Camera, capture, container, eight_bit, metadata, packed
from PIL import Image
from samples import box, cross, picture, refusal, save, save_hci, save_named, star

from lfgpu.batch.items import find_items
from lfgpu.io import read
from lfgpu.scenes import make


@pytest.mark.parametrize(
    ("places", "shape", "counted"),
    [
        (box(2, 3), (2, 3), "rows count from 0, columns from 0"),
        (box(11, 2, first=1), (11, 2), "rows count from 1, columns from 1"),
        ([(0, column) for column in range(1, 6)], (1, 5), "rows count from 0, columns from 1"),
        ([(row, 4) for row in range(3)], (3, 1), "rows count from 0, columns from 4"),
    ],
    ids=["from 0", "from 1", "a row of a larger grid", "a column of a larger grid"],
)
def test_numbers_may_start_anywhere_and_need_no_leading_zeros(
    places: list[tuple[int, int]], shape: tuple[int, int], counted: str, tmp_path: Path
) -> None:
    light_field = read(save_named(tmp_path, places, "{0}_{1}.png"))
    assert light_field.grid_shape == shape
    row, column = places[-1]
    np.testing.assert_array_equal(light_field.view(shape[0] - 1, shape[1] - 1), picture(100 * row + column))
    assert light_field.reading.places.endswith(f"; {counted}")
    assert (light_field.name, light_field.notes) == (tmp_path.name, ())


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
        "Left out 4 of the images, not named as the others: IMG_1.jpg, at_12_20230101.png, "
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
    assert '--pattern "{?}_{v}_{u}.png"' in text
    assert read(tmp_path, pattern="2067_{v}_{u}.png").grid_shape == (2, 2)


@pytest.mark.parametrize("other", ["01_01.png", "1_1.bmp", "1_1.PNG"])
def test_two_files_for_one_place_are_refused(tmp_path: Path, other: str) -> None:
    save_named(tmp_path, box(2, 2), "{0}_{1}.png")
    save(tmp_path / other)
    text = refusal(lambda: read(tmp_path))
    assert "row 1, column 1" in text
    assert "1_1.png" in text
    assert other in text


def test_one_view_is_not_enough(tmp_path: Path) -> None:
    text = refusal(lambda: read(save_named(tmp_path, [(3, 4)])))
    assert str(tmp_path) in text
    assert "one view only (view_03_04.png)" in text


# --- grids with holes ---


@pytest.mark.parametrize("places", [cross(3), star(5)], ids=["cross", "star"])
def test_patterns_of_more_than_half_of_the_views_are_meant(tmp_path: Path, places: set[tuple[int, int]]) -> None:
    light_field = read(save_named(tmp_path, places))
    assert len(light_field.views) == len(places)
    assert light_field.notes == ()
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


RING, CORNERS = set(box(3, 3)) - {(1, 1)}, {(0, 0), (0, 6), (6, 0), (6, 6)}


@pytest.mark.parametrize("places", [RING, CORNERS], ids=["ring", "corners"])
def test_without_the_centre_view_the_nearest_is_the_reference(tmp_path: Path, places: set[tuple[int, int]]) -> None:
    """Corners alone are meant, as a pattern is."""
    light_field = read(save_named(tmp_path, places), allow_missing=places == RING)
    row, column = (int(place) for place in light_field.positions[light_field.reference_index][::-1])
    middle = 1 if places == RING else 3
    assert light_field.grid_shape == (2 * middle + 1, 2 * middle + 1)
    assert abs(row - middle) + abs(column - middle) == min(abs(v - middle) + abs(u - middle) for v, u in places)
    note = f"The centre view (row {middle}, column {middle}) is missing"
    assert light_field.notes[-1] == f"{note}; the reference is the view at row {row}, column {column}."


# --- signs, sizes, folders of several ---


def test_numbers_with_signs_count_from_their_lowest_one(tmp_path: Path) -> None:
    """The view at zero is the reference, also of lopsided numbers."""
    places = [(row, column) for row in range(-1, 2) for column in range(-1, 4)]
    light_field = read(save_named(tmp_path, places, "image_{0:+d}_{1:+d}.tif"))
    assert (light_field.grid_shape, light_field.missing) == ((3, 5), ())
    assert light_field.positions[light_field.reference_index].tolist() == [1, 1]
    assert light_field.files[0].endswith("image_-1_-1.tif")
    assert light_field.reading.places.endswith("; rows count from -1, columns from -1")


@pytest.mark.parametrize("pattern", ["x{1}_y{0}.png", "cam_v{0:+d}u{1:+d}.png", "row{0}col{1}.png"])
def test_a_minus_after_a_word_that_stands_before_zero_is_a_sign(tmp_path: Path, pattern: str) -> None:
    light_field = read(save_named(tmp_path, [(r, c) for r in (0, 1) for c in (-2, -1, 0)], pattern))
    assert (light_field.grid_shape, light_field.notes) == ((2, 3), ())
    assert light_field.files[light_field.reference_index] == str(tmp_path / pattern.format(0, 0))
    assert light_field.reading.places.endswith("; rows count from 0, columns from -2")


def test_a_minus_after_a_word_that_stands_before_no_zero_may_be_a_hyphen(tmp_path: Path) -> None:
    for place in range(5):
        save(tmp_path / f"view-{place}.png", picture(place))
    save(tmp_path / "view0.png")
    assert "Left out 1 of the images, not named as the others: view0.png." in read(tmp_path).notes


def test_half_of_the_numbered_images_are_not_left_out(tmp_path: Path) -> None:
    save_named(tmp_path, box(2, 2, first=1), "x{0}_y{1}.png")
    for number in range(4):
        save(tmp_path / f"{'abcd'[number]}{number}.png", picture(number))
    text = refusal(lambda: read(tmp_path))
    assert "named in different ways: x1_y1.png and a0.png" in text
    assert len(read(tmp_path, pattern="x{u}_y{v}.png").views) == 4


def test_a_folder_of_raw_captures_is_several_light_fields(tmp_path: Path) -> None:
    lens = capture(make("planes", grid=(9, 9), size=(30, 30), seed=3), Camera(size=(280, 300)))
    for number in (1, 2):
        Image.fromarray(eight_bit(lens.raw)).save(tmp_path / f"IMG_{number}.png")
    text = refusal(lambda: read(tmp_path))
    assert "holds 2 raw captures, each a light field of its own (IMG_1.png, IMG_2.png)" in text
    assert "lfgpu batch" in text
    items, _ = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["IMG_1.png", "IMG_2.png"]
    containers = tmp_path / "containers"
    containers.mkdir()
    data = container(packed(np.zeros((8, 20), np.uint16), 12), metadata((8, 20)))
    (containers / "a.lfr").write_bytes(data)
    assert "holds 1 captures, each a light field" in refusal(lambda: read(containers))


def test_a_folder_of_folders_is_several_light_fields(tmp_path: Path) -> None:
    save_named(tmp_path / "views", box(2, 2))
    save_hci(tmp_path / "hci", range(9))
    assert "holds 2 light fields, each a light field of its own (hci, views)" in refusal(lambda: read(tmp_path))
    assert len(find_items([str(tmp_path)], sequence=False)[0]) == 2


def test_a_folder_around_a_light_field_is_no_row_of_cameras(tmp_path: Path) -> None:
    inside = save_hci(tmp_path / "hci", range(5))
    for _ in range(2):
        assert refusal(lambda: read(tmp_path)) == f"{tmp_path} holds one light field: give {inside}, which is hci."
        assert [item.source for item in find_items([str(tmp_path)], sequence=False)[0]] == [str(inside)]
        save(tmp_path / "overview.png")


def test_numbered_folders_of_other_scenes_are_no_rows(tmp_path: Path) -> None:
    for number, kind in enumerate(("boxes", "relief")):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        for place, view in enumerate(make(kind, grid=(1, 5), size=(40, 48), seed=number).views):
            Image.fromarray(view).save(folder / f"{place:03d}.png")
    assert "several folders with numbered images (0, 1); give one" in refusal(lambda: read(tmp_path))


@pytest.mark.parametrize("name", ["view_00_01.png", "parameters.cfg", "gt_disp_lowres.pfm", "a.h5", "a.lfp", "a.npy"])
def test_files_that_git_lfs_did_not_fetch(name: str, tmp_path: Path) -> None:
    save_named(tmp_path, box(2, 2)) if name.startswith("view") else save_hci(tmp_path, range(9))
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    (tmp_path / name).write_text(pointer)
    source = tmp_path / name if name.startswith("a.") else tmp_path
    text = refusal(lambda: read(source))
    assert text == (
        f"{tmp_path / name} was not fetched: Git LFS left a pointer in its place; run 'git lfs pull' in its repository."
    )
