"""Light fields, maps and masks from and to files: what is read, what is noted, what is refused and in which words."""

from __future__ import annotations

import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from lfgpu.errors import LightFieldError
from lfgpu.geometry import Geometry
from lfgpu.io import (
    FORMATS,
    atomic_folder,
    atomic_write,
    check_writable,
    read,
    read_map,
    read_mask,
    recognise,
    write_hci,
    write_pfm,
)
from lfgpu.io.images import read_image
from lfgpu.io.png import write_png
from lfgpu.lightfield import GroundTruth, LightField

HEIGHT, WIDTH = 4, 5

CFG = """
[intrinsics]
focal_length_mm = 100.0
image_resolution_x_px = 5
image_resolution_y_px = 4
sensor_size_mm = 35.0

[extrinsics]
num_cams_x = {columns}
num_cams_y = {rows}
baseline_mm = 25.0
focus_distance_m = 4.25

[meta]
scene = 100 % cotton
disp_min = -1.6
disp_max = 1.5
"""


def picture(seed: int = 0, channels: int = 3, dtype: Any = np.uint8) -> NDArray[Any]:
    """[y, x, c] of random values, another one for each seed."""
    values = np.random.default_rng(seed).random((HEIGHT, WIDTH, channels))
    return values.astype(dtype) if dtype == np.float32 else (values * np.iinfo(dtype).max).astype(dtype)


def save(path: Path, image: NDArray[Any] | None = None) -> None:
    """Write an image with Pillow, in the format that the suffix names."""
    image = picture() if image is None else image
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image[..., 0] if image.shape[2] == 1 else image).save(path)


def save_named(folder: Path, places: Iterable[tuple[int, int]], pattern: str = "view_{0:02d}_{1:02d}.png") -> Path:
    """Views at places of a grid, each with its own content (seed 100 * row + column)."""
    for row, column in places:
        save(folder / pattern.format(row, column), picture(100 * row + column))
    return folder


def save_hci(folder: Path, indices: Iterable[int], *, rows: int = 3, columns: int = 3, cfg: str | None = CFG) -> Path:
    for index in indices:
        save(folder / f"input_Cam{index:03d}.png", picture(index))
    if cfg is not None:
        (folder / "parameters.cfg").write_text(cfg.format(rows=rows, columns=columns))
    return folder


def box(rows: int, columns: int, first: int = 0) -> list[tuple[int, int]]:
    return [(row + first, column + first) for row in range(rows) for column in range(columns)]


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(LightFieldError) as error:
        call()
    text = str(error.value)
    assert text.endswith(".")
    assert "\n" not in text
    return text


@pytest.fixture
def _permissions_count(tmp_path: Path) -> None:
    closed = tmp_path / "closed.txt"
    closed.touch(mode=0)
    if os.access(closed, os.R_OK):
        pytest.skip("this user may read and write everything (root)")
    closed.unlink()


# --- the table of formats ---


def test_the_table_is_well_formed() -> None:
    names = [entry.name for entry in FORMATS]
    assert len(set(names)) == len(names)
    for entry in FORMATS:
        assert entry.name == entry.name.lower()
        assert " " not in entry.name
        assert "\n" not in entry.description
        assert not entry.description.endswith(".")


def test_recognise_says_why(tmp_path: Path) -> None:
    entry, reason = recognise(save_hci(tmp_path / "a", [0, 1], rows=1, columns=2))
    assert (entry.name, reason) == ("hci", "it is a folder with input_Cam000.png")
    entry, reason = recognise(save_named(tmp_path / "b", box(1, 2)))
    assert entry.name == "named-views"
    assert "view_00_00.png" in reason
    entry, reason = recognise(save_named(tmp_path / "c" / "lf", box(1, 2)).parent)
    assert entry.name == "named-views"
    assert "its folder lf" in reason


def test_a_format_can_be_asked_for(tmp_path: Path) -> None:
    save_hci(tmp_path, range(9))
    save_named(tmp_path, box(2, 2))
    assert read(tmp_path).grid_shape == (3, 3)
    assert read(tmp_path, format="named-views").grid_shape == (2, 2)
    assert "unknown format 'hcl'; known are hci, named-views" in refusal(lambda: read(tmp_path, format="hcl"))


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_every_format_refuses_folders_and_files_that_are_none(entry: Any, tmp_path: Path) -> None:
    assert entry.recognise(tmp_path) is None
    assert str(tmp_path) in refusal(lambda: read(tmp_path, format=entry.name))
    file = tmp_path / "notes.txt"
    file.write_text("hello")
    assert entry.recognise(file) is None
    assert str(file) in refusal(lambda: read(file, format=entry.name))


def test_what_is_no_light_field(tmp_path: Path) -> None:
    missing = refusal(lambda: read(tmp_path / "nowhere"))
    assert "nowhere does not exist" in missing
    empty = refusal(lambda: read(tmp_path))
    assert "an empty folder" in empty
    assert all(entry.name in empty for entry in FORMATS)
    for name in ("d.txt", "c.txt", "b.txt", "a.txt"):
        (tmp_path / name).write_text("")
    assert "a folder with a.txt, b.txt, c.txt and 1 more" in refusal(lambda: read(tmp_path))
    text = refusal(lambda: read(tmp_path / "a.txt"))
    assert "a.txt" in text
    assert "give the folder" in text


@pytest.mark.usefixtures("_permissions_count")
def test_what_may_not_be_read(tmp_path: Path) -> None:
    folder = save_named(tmp_path / "views", box(1, 2))
    (folder / "view_00_01.png").chmod(0)
    text = refusal(lambda: read(folder))
    assert "view_00_01.png cannot be read as an image: Permission denied" in text
    try:
        for mode in (0, 0o400):  # not to be listed; to be listed, but not to be entered
            folder.chmod(mode)
            assert f"{folder} cannot be listed: Permission denied" in refusal(lambda: read(folder))
            assert "deeper cannot be opened: Permission denied" in refusal(lambda: read(folder / "deeper"))
    finally:
        folder.chmod(0o700)


# --- views named by row and column ---


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


def cross(n: int) -> set[tuple[int, int]]:
    return {(row, column) for row, column in box(n, n) if row == n // 2 or column == n // 2}


def star(n: int) -> set[tuple[int, int]]:
    return {(row, column) for row, column in box(n, n) if abs(row - n // 2) == abs(column - n // 2)} | cross(n)


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


# --- images ---


@pytest.mark.parametrize(
    ("suffix", "channels", "dtype"),
    [
        ("png", 1, np.uint8),
        ("png", 3, np.uint8),
        ("png", 1, np.uint16),
        ("bmp", 1, np.uint8),
        ("bmp", 3, np.uint8),
        ("tif", 1, np.uint8),
        ("tif", 3, np.uint8),
        ("tif", 1, np.uint16),
        ("tif", 1, np.float32),
    ],
)
def test_values_are_kept(tmp_path: Path, suffix: str, channels: int, dtype: Any) -> None:
    for column in range(2):
        save(tmp_path / f"0_{column}.{suffix}", picture(column, channels, dtype))
    light_field = read(tmp_path)
    assert light_field.views.dtype == dtype
    np.testing.assert_array_equal(light_field.views[1], picture(1, channels, dtype))
    np.testing.assert_array_equal(
        light_field.views[0], iio.imread(tmp_path / f"0_0.{suffix}", plugin="pillow").reshape(HEIGHT, WIDTH, -1)
    )


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_bytes(width: int, height: int, depth: int, colour: int, rows: bytes) -> bytes:
    """A PNG of unfiltered rows, made by hand: what is read is held against the format, not against our writer."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)


@pytest.mark.parametrize("channels", [3, 4])
def test_16_bit_colour_png_is_read_with_all_its_bits(tmp_path: Path, channels: int) -> None:
    image = picture(1, channels, np.uint16)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in image)
    (tmp_path / "a.png").write_bytes(png_bytes(WIDTH, HEIGHT, 16, {3: 2, 4: 6}[channels], rows))
    found, remarks = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(found, image[..., :3])
    assert (channels == 4) == bool(remarks)


def test_16_bit_grey_with_alpha_is_refused(tmp_path: Path) -> None:
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in picture(1, 2, np.uint16))
    (tmp_path / "a.png").write_bytes(png_bytes(WIDTH, HEIGHT, 16, 4, rows))
    assert "a.png is 16-bit grey with transparency" in refusal(lambda: read_image(tmp_path / "a.png"))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_round_trip(tmp_path: Path, channels: int, dtype: Any) -> None:
    image = picture(2, channels, dtype)
    write_png(tmp_path / "a.png", image)
    found, remarks = read_image(tmp_path / "a.png")
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, image)
    assert not remarks
    if channels == 3:  # Pillow agrees as far as it goes: it reads the high bytes
        np.testing.assert_array_equal(iio.imread(tmp_path / "a.png"), image >> (8 * (image.itemsize - 1)))


def tiff_bytes(image: NDArray[Any], *, sample_format: int, planar: int = 1, order: str = "<") -> bytes:
    """An uncompressed TIFF of one strip (or one for each plane), made by hand."""
    height, width, channels = image.shape
    stored = image if planar == 1 else np.moveaxis(image, 2, 0)
    data = stored.astype(image.dtype.newbyteorder(order)).tobytes()
    strips = 1 if planar == 1 else channels
    tags: list[tuple[int, list[int]]] = [
        (256, [width]),
        (257, [height]),
        (258, [8 * image.itemsize] * channels),
        (259, [1]),
        (262, [1 if channels == 1 else 2]),
        (273, [8 + index * len(data) // strips for index in range(strips)]),
        (277, [channels]),
        (278, [height]),
        (279, [len(data) // strips] * strips),
        (284, [planar]),
        (339, [sample_format] * channels),
    ]
    start = 8 + len(data)
    values_at = start + 2 + 12 * len(tags) + 4
    directory, values = struct.pack(order + "H", len(tags)), b""
    for tag, numbers in tags:
        packed = struct.pack(f"{order}{len(numbers)}I", *numbers)
        where = packed if len(packed) <= 4 else struct.pack(order + "I", values_at + len(values))
        values += packed if len(packed) > 4 else b""
        directory += struct.pack(order + "HHI", tag, 4, len(numbers)) + where
    magic = b"II*\0" if order == "<" else b"MM\0*"
    return magic + struct.pack(order + "I", start) + data + directory + b"\0\0\0\0" + values


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("channels", [1, 3])
def test_16_bit_tiff_in_either_byte_order(tmp_path: Path, order: str, channels: int) -> None:
    image = picture(1, channels, np.uint16)
    (tmp_path / "a.tif").write_bytes(tiff_bytes(image, sample_format=1, order=order))
    found, _ = read_image(tmp_path / "a.tif")
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, image)


UNUSUAL = {
    "float colour": (picture(1, 3, np.float32), 3, 1),
    "float64": (picture(1, 1, np.float32).astype(np.float64) / 3, 3, 1),
    "separate planes": (picture(1, 3, np.uint16), 1, 2),  # Pillow reads these without complaint, but wrongly
}


@pytest.mark.parametrize(("image", "sample_format", "planar"), UNUSUAL.values(), ids=UNUSUAL)
def test_unusual_tiff_by_way_of_tifffile(
    tmp_path: Path, image: NDArray[Any], sample_format: int, planar: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(tiff_bytes(image, sample_format=sample_format, planar=planar))
    with monkeypatch.context() as context:
        context.setattr("importlib.util.find_spec", lambda name: None)
        assert "pip install tifffile" in refusal(lambda: read_image(path))
    pytest.importorskip("tifffile", reason="tifffile is not installed")
    found, remarks = read_image(path)
    if image.dtype == np.float64:
        assert remarks == {"float64 values rounded to float32"}
        image = image.astype(np.float32)
    assert found.dtype == image.dtype
    np.testing.assert_array_equal(found, image)


def test_alpha_is_dropped_with_a_note(tmp_path: Path) -> None:
    save(tmp_path / "0_0.png", picture(0, 4))
    save(tmp_path / "0_1.png", picture(1, 3))
    light_field = read(tmp_path)
    np.testing.assert_array_equal(light_field.views[0], picture(0, 4)[..., :3])
    assert "Alpha channel dropped in 1 of 2 views." in light_field.notes


def test_grey_with_alpha_stays_grey(tmp_path: Path) -> None:
    save(tmp_path / "0_0.png", picture(0, 2))
    save(tmp_path / "0_1.png", picture(1, 1))
    assert read(tmp_path).channels == 1


def test_palettes_become_colours(tmp_path: Path) -> None:
    image = Image.fromarray(picture(0)).quantize(4)
    image.save(tmp_path / "a.png")
    found, remarks = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(found, np.asarray(image.convert("RGB")))
    assert not remarks


def test_one_bit_images_are_grey(tmp_path: Path) -> None:
    Image.fromarray(picture(0)).convert("1").save(tmp_path / "a.png")
    found, _ = read_image(tmp_path / "a.png")
    assert found.shape == (HEIGHT, WIDTH, 1)
    assert set(np.unique(found)) <= {0, 255}


@pytest.mark.parametrize(
    ("other", "found"),
    [
        (picture(1, 1), "5 x 4 grey uint8"),
        (picture(1, 1, np.uint16), "5 x 4 grey uint16"),
        (picture(1)[:3], "5 x 3 RGB uint8"),
    ],
)
def test_unlike_views_are_refused_by_name(tmp_path: Path, other: NDArray[Any], found: str) -> None:
    save_named(tmp_path, box(1, 3))
    save(tmp_path / "view_00_01.png", other)
    text = refusal(lambda: read(tmp_path))
    assert str(tmp_path) in text
    assert "view_00_00.png is 5 x 4 RGB uint8" in text
    assert f"view_00_01.png is {found}" in text


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tif"])
@pytest.mark.parametrize("kept", [0, 10, 0.6])
def test_damaged_images_are_named(tmp_path: Path, suffix: str, kept: float) -> None:
    for column in range(2):
        path = tmp_path / f"0_{column}.{suffix}"
        Image.fromarray(np.random.default_rng(column).integers(0, 256, (60, 80, 3), dtype=np.uint8)).save(path)
    content = path.read_bytes()
    path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    assert f"0_1.{suffix} cannot be read as an image" in refusal(lambda: read(tmp_path))


def test_text_is_no_image(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("<html>404 Not Found</html>")
    assert "a.png cannot be read as an image: it is none" in refusal(lambda: read_image(tmp_path / "a.png"))


@pytest.mark.parametrize("side", [12_000, 60_000])
def test_absurd_sizes_are_refused_before_memory_is_taken(tmp_path: Path, side: int) -> None:
    (tmp_path / "a.png").write_bytes(png_bytes(side, side, 8, 2, b""))
    text = refusal(lambda: read_image(tmp_path / "a.png"))
    assert "a.png cannot be read as an image" in text
    assert str(side * side) in text


def test_lack_of_memory_is_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError

    save_named(tmp_path, box(1, 2))
    monkeypatch.setattr("lfgpu.io.views.np.empty", full)
    assert "2 views, each 5 x 4 RGB uint8, do not fit into memory" in refusal(lambda: read(tmp_path))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_undefined_values_are_refused_by_file_name(tmp_path: Path, bad: float) -> None:
    for column in range(2):
        save(tmp_path / f"0_{column}.tif", picture(column, 1, np.float32))
    image = picture(1, 1, np.float32)
    image[2, 3] = bad
    save(tmp_path / "0_1.tif", image)
    assert "0_1.tif has NaN or infinite values" in refusal(lambda: read(tmp_path))


def test_other_kinds_of_values_are_refused(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((3, 3), np.int32)).save(tmp_path / "a.tif")
    assert "a.tif has 32-bit integers" in refusal(lambda: read_image(tmp_path / "a.tif"))
    Image.fromarray(picture()).convert("CMYK").save(tmp_path / "a.jpg")
    assert "a.jpg has colour mode CMYK" in refusal(lambda: read_image(tmp_path / "a.jpg"))


# --- HCI 4D folders ---


def test_hci_grid_and_geometry(tmp_path: Path) -> None:
    light_field = read(save_hci(tmp_path, range(6), rows=2, columns=3))
    assert (light_field.grid_shape, light_field.notes) == ((2, 3), ())
    np.testing.assert_array_equal(light_field.view(1, 2), picture(5))  # index = columns * row + column
    assert light_field.positions[light_field.reference_index].tolist() == [1, 1]
    # 100 mm / 35 mm * 5 px, the longer side of the views
    assert light_field.geometry == Geometry(100 / 35 * 5, 0.025, 4.25)


def test_hci_truth_and_mask_belong_to_the_centre_view(tmp_path: Path) -> None:
    save_hci(tmp_path, range(10), rows=2, columns=5)
    disparity = np.arange(HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    disparity[0, 1] = np.inf
    write_pfm(tmp_path / "gt_disp_lowres.pfm", disparity)
    save(tmp_path / "valid_mask.png", (disparity > 7)[..., None].astype(np.uint8))
    light_field = read(tmp_path)
    truth = light_field.reference_truth()
    assert truth is not None
    assert truth.position == (2.0, 1.0)
    disparity[0, 1] = np.nan
    np.testing.assert_array_equal(truth.disparity, disparity)
    assert truth.mask is not None
    np.testing.assert_array_equal(truth.mask[1:], disparity[1:] > 7)


def test_hci_star_of_views(tmp_path: Path) -> None:
    indices = sorted(5 * row + column for row, column in star(5))
    light_field = read(save_hci(tmp_path, indices, rows=5, columns=5))
    assert light_field.notes == ()
    assert light_field.positions[light_field.reference_index].tolist() == [2, 2]
    assert len(light_field.missing) == 8


def test_hci_with_lost_views(tmp_path: Path) -> None:
    save_hci(tmp_path, set(range(9)) - {5})
    assert "row 1 column 2" in refusal(lambda: read(tmp_path))
    assert read(tmp_path, allow_missing=True).missing == ((1, 2),)


@pytest.mark.parametrize("indices", [range(9), [0, 2, 4, 8]])
def test_hci_without_parameters_takes_a_square(tmp_path: Path, indices: Iterable[int]) -> None:
    light_field = read(save_hci(tmp_path, indices, cfg=None))
    assert light_field.grid_shape == (3, 3)
    assert light_field.geometry is None
    assert light_field.notes[0].startswith("There is no parameters.cfg: a square grid is assumed")


def test_hci_without_parameters_and_no_square(tmp_path: Path) -> None:
    text = refusal(lambda: read(save_hci(tmp_path, range(6), cfg=None)))
    assert str(tmp_path) in text
    assert "no parameters.cfg" in text
    assert "num_cams_x" in text


def test_hci_with_a_grid_but_without_lengths(tmp_path: Path) -> None:
    light_field = read(save_hci(tmp_path, range(2), rows=1, columns=2, cfg="[extrinsics]\nnum_cams_x=2\nnum_cams_y=1"))
    assert light_field.geometry is None
    assert light_field.notes == ("parameters.cfg does not describe the cameras: metric depth is not known.",)


def test_hci_views_of_another_size_than_the_parameters_say(tmp_path: Path) -> None:
    cfg = CFG.replace("resolution_x_px = 5", "resolution_x_px = 10")
    light_field = read(save_hci(tmp_path, range(9), cfg=cfg))
    assert "is for views of 10 x 4 pixels and these have 5 x 4" in light_field.notes[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("num_cams_x = {columns}", "num_cams_x = 2", ["3 x 2 views", "index 5", "index 8"]),
        ("num_cams_x = {columns}", "", ["no num_cams_x in [extrinsics]"]),
        ("num_cams_y = {rows}", "num_cams_y = three", ["num_cams_y must be a number", "'three'"]),
        ("num_cams_y = {rows}", "num_cams_y = 2.5", ["num_cams_y must be a whole number", "2.5"]),
        ("num_cams_y = {rows}", "num_cams_y = 1e12", ["num_cams_y", "1000"]),
        ("num_cams_y = {rows}", "num_cams_y = 0", ["num_cams_y", "0"]),
        ("baseline_mm = 25.0", "", ["no baseline_mm in [extrinsics]"]),
        ("baseline_mm = 25.0", "baseline_mm = -25", ["baseline_m must be a positive number"]),
        ("baseline_mm = 25.0", "baseline_mm = 2,5", ["baseline_mm must be a number", "'2,5'"]),
        ("focal_length_mm = 100.0", "focal_length_mm =", ["focal_length_mm must be a number", "''"]),
        ("focal_length_mm = 100.0", "focal_length_mm = nan", ["focal_length_px", "nan"]),
        ("sensor_size_mm = 35.0", "sensor_size_mm = 0", ["sensor_size_mm must be positive"]),
        ("resolution_x_px = 5", "resolution_x_px = inf", ["image_resolution_x_px must be a whole number", "inf"]),
        ("[extrinsics]", "", ["no num_cams_y in [extrinsics]"]),
        ("[intrinsics]", "intrinsics", ["not a valid configuration file"]),
        ("scene = 100 % cotton", "scene = 1\nscene = 2", ["not a valid configuration file", "scene"]),
    ],
)
def test_hci_parameters_that_contradict_or_lack_something(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in CFG
    text = refusal(lambda: read(save_hci(tmp_path, range(9), cfg=CFG.replace(old, new))))
    assert str(tmp_path / "parameters.cfg") in text
    assert all(word in text for word in words), text


def test_hci_parameters_that_are_no_text(tmp_path: Path) -> None:
    save_hci(tmp_path, range(9), cfg=None)
    (tmp_path / "parameters.cfg").write_bytes(b"\xff\xfe\x00")
    assert "parameters.cfg is not a valid configuration file" in refusal(lambda: read(tmp_path))


def test_hci_two_files_for_one_view(tmp_path: Path) -> None:
    save_hci(tmp_path, range(9))
    save(tmp_path / "input_Cam4.png")
    text = refusal(lambda: read(tmp_path))
    assert "input_Cam004.png and input_Cam4.png" in text


def test_hci_one_view(tmp_path: Path) -> None:
    assert "one view only (input_Cam004.png)" in refusal(lambda: read(save_hci(tmp_path, [4])))


@pytest.mark.parametrize("name", ["gt_disp_lowres.pfm", "valid_mask.png"])
def test_hci_truth_of_another_size(tmp_path: Path, name: str) -> None:
    save_hci(tmp_path, range(9))
    write_pfm(tmp_path / "gt_disp_lowres.pfm", np.zeros((HEIGHT, WIDTH + (name == "gt_disp_lowres.pfm"))))
    save(tmp_path / "valid_mask.png", picture(0, 1)[:3])
    text = refusal(lambda: read(tmp_path))
    assert name in text
    assert "the views have 5 x 4" in text


# --- writing HCI 4D folders ---


def scene(dtype: Any = np.uint8, channels: int = 3, **fields: Any) -> LightField:
    views = np.stack([picture(index, channels, dtype) for index in range(6)])
    return LightField.from_grid(views.reshape(2, 3, HEIGHT, WIDTH, channels), **fields)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_hci_round_trip(tmp_path: Path, dtype: Any, channels: int) -> None:
    disparity = np.random.default_rng(9).normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    disparity[0, 0] = np.nan
    light_field = scene(
        dtype,
        channels,
        geometry=Geometry(1234.5, 0.0173, 2.1, principal_point=(1.25, 2.0)),
        truth=GroundTruth(disparity, (1.0, 1.0), disparity > 0),
        name="100 % new\nscene",
    )
    assert write_hci(light_field, tmp_path / "a" / "b") == ()
    found = read(tmp_path / "a" / "b")
    assert found.views.dtype == dtype
    np.testing.assert_array_equal(found.views, light_field.views)
    assert (found.grid_shape, found.reference, found.notes) == ((2, 3), light_field.reference, ())
    assert found.geometry is not None
    assert found.geometry.principal_point == (1.25, 2.0)
    lengths = found.geometry.focal_length_px, found.geometry.baseline_m, found.geometry.focus_distance_m
    assert lengths == pytest.approx((1234.5, 0.0173, 2.1), rel=1e-12)
    assert found.truth is not None
    assert found.truth.mask is not None
    np.testing.assert_array_equal(found.truth.disparity, disparity)
    np.testing.assert_array_equal(found.truth.mask, disparity > 0)
    depth = read_map(tmp_path / "a" / "b" / "gt_depth_lowres.pfm")
    np.testing.assert_allclose(depth, found.geometry.depth(disparity), rtol=1e-6)
    assert np.isnan(depth[0, 0])


def test_hci_round_trip_without_geometry_or_with_parallel_frames(tmp_path: Path) -> None:
    write_hci(scene(), tmp_path / "a")
    assert read(tmp_path / "a").geometry is None
    write_hci(scene(geometry=Geometry(100.0, 0.5)), tmp_path / "b")
    assert read(tmp_path / "b").geometry == Geometry(100.0, 0.5)


def test_hci_stores_float_views_with_16_bits(tmp_path: Path) -> None:
    light_field = scene(np.float32)
    assert write_hci(light_field, tmp_path) == ("The float32 views were rounded to 16 bits.",)
    found = read(tmp_path)
    assert found.views.dtype == np.uint16
    np.testing.assert_allclose(found.image(3), light_field.views[3], atol=0.5001 / 65535)


def test_hci_says_what_it_left_out(tmp_path: Path) -> None:
    light_field = replace(
        scene(truth=GroundTruth(np.zeros((HEIGHT, WIDTH), np.float32), (0.0, 0.0))),
        valid=np.ones((6, HEIGHT, WIDTH), np.bool_),
        reference=0,
    )
    left_out = write_hci(light_field, tmp_path)
    assert [sentence.split(" was")[0] for sentence in left_out] == [
        "The ground truth",
        "The validity of the views' pixels",
        "The choice of the reference view",
    ]
    assert read(tmp_path).truth is None


def test_hci_round_trip_of_some_views(tmp_path: Path) -> None:
    light_field = scene().subset("cross")
    write_hci(light_field, tmp_path)
    found = read(tmp_path)
    np.testing.assert_array_equal(found.positions, light_field.positions)
    assert found.missing == light_field.missing


def test_hci_does_not_mix_with_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "license.txt").write_text("mine")
    truth = GroundTruth(np.zeros((HEIGHT, WIDTH), np.float32), (1.0, 1.0))
    write_hci(scene(truth=truth), tmp_path)
    write_hci(scene(truth=truth, name="again"), tmp_path)
    before = sorted(tmp_path.iterdir())
    assert "holds gt_disp_lowres.pfm of another" in refusal(lambda: write_hci(scene(), tmp_path))
    assert "holds input_Cam000.png of another" in refusal(
        lambda: write_hci(scene(truth=truth).subset("cross"), tmp_path)
    )
    assert sorted(tmp_path.iterdir()) == before
    assert "again" in (tmp_path / "parameters.cfg").read_text()


def test_hci_holds_grids_only(tmp_path: Path) -> None:
    light_field = replace(scene(name="array"), grid_shape=None)
    assert "array is not a grid of views" in refusal(lambda: write_hci(light_field, tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []


def test_hci_failing_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lfgpu.io.hci.write_parameters", full)
    text = refusal(lambda: write_hci(scene(), tmp_path / "deep" / "out"))
    assert str(tmp_path / "deep" / "out") in text
    assert "No space left on device" in text
    assert list(tmp_path.iterdir()) == []


# --- maps and masks ---

MAP = np.random.default_rng(5).normal(size=(3, 7)).astype(np.float32)


def test_pfm_round_trip_and_imageio_agrees(tmp_path: Path) -> None:
    values = MAP.copy()
    values[1, 2:4] = np.nan, np.inf
    write_pfm(tmp_path / "a.PFM", values)
    np.testing.assert_array_equal(read_map(tmp_path / "a.PFM"), values)
    (tmp_path / "a.PFM").rename(tmp_path / "a.pfm")
    np.testing.assert_array_equal(iio.imread(tmp_path / "a.pfm"), values)
    iio.imwrite(tmp_path / "b.pfm", MAP)
    np.testing.assert_array_equal(read_map(tmp_path / "b.pfm"), MAP)


def test_pfm_is_stored_bottom_up_and_little_endian(tmp_path: Path) -> None:
    write_pfm(tmp_path / "a.pfm", [[1, 2], [3, 4]])
    assert (tmp_path / "a.pfm").read_bytes() == b"Pf\n2 2\n-1.0\n" + struct.pack("<4f", 3, 4, 1, 2)


@pytest.mark.parametrize("header", [b"Pf\n2 1\n1.0\n", b"Pf 2 1 1\n", b"Pf\r\n2 1\r\n1.0\r\n", b"Pf\n2\n1\n+1e0\n"])
def test_pfm_headers_of_other_writers(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "a.pfm").write_bytes(header + struct.pack(">2f", 1.5, -2.5))  # a positive scale is big endian
    np.testing.assert_array_equal(read_map(tmp_path / "a.pfm"), [[1.5, -2.5]])


def test_maps_from_numpy_and_tiff(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", MAP.astype(np.float64))
    np.savez(tmp_path / "a.npz", disparity=MAP, other=np.zeros(3))
    Image.fromarray(MAP).save(tmp_path / "a.tif")
    for name in ("a.npy", "a.npz", "a.tif"):
        found = read_map(tmp_path / name)
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, MAP)


def bad_maps(folder: Path) -> dict[str, str]:
    """Names of files that are no maps, and what is said about them."""
    data = struct.pack("<6f", *range(6))
    (folder / "colour.pfm").write_bytes(b"PF\n2 1\n-1.0\n" + data)
    (folder / "short.pfm").write_bytes(b"Pf\n3 3\n-1.0\n" + data)
    (folder / "long.pfm").write_bytes(b"Pf\n2 1\n-1.0\n" + data)
    (folder / "empty.pfm").write_bytes(b"")
    (folder / "text.pfm").write_bytes(b"hello")
    np.save(folder / "line.npy", np.zeros(4))
    np.save(folder / "pickle.npy", np.array([{}], object), allow_pickle=True)
    np.save(folder / "complex.npy", np.zeros((2, 2), complex))
    (folder / "short.npy").write_bytes((folder / "line.npy").read_bytes()[:-8])
    np.savez(folder / "keys.npz", depth=MAP)
    (folder / "broken.npz").write_bytes((folder / "keys.npz").read_bytes()[:100])
    save(folder / "colour.tif")
    (folder / "map.exr").write_bytes(b"")
    (folder / "folder.npy").mkdir()
    return {
        "colour.pfm": "colour PFM",
        "short.pfm": "damaged: 3 x 3 float32 values are 36 bytes, it has 24",
        "long.pfm": "damaged",
        "empty.pfm": "not a PFM",
        "text.pfm": "not a PFM",
        "line.npy": "shape (4,)",
        "pickle.npy": "cannot be read as NumPy data",
        "complex.npy": "complex128",
        "short.npy": "cannot be read as NumPy data",
        "keys.npz": "no array 'disparity'; it holds depth",
        "broken.npz": "cannot be read as NumPy data",
        "colour.tif": "colour image",
        "map.exr": "known are .pfm, .npy, .npz and .tif",
        "folder.npy": "cannot be opened",
        "missing.pfm": "cannot be opened: No such file",
        "missing.tif": "No such file",
    }


def test_what_is_no_map_is_refused(tmp_path: Path) -> None:
    for name, words in bad_maps(tmp_path).items():
        text = refusal(lambda name=name: read_map(tmp_path / name))
        assert str(tmp_path / name) in text
        assert words in text, text


def test_masks(tmp_path: Path) -> None:
    mask = np.array([[0, 1, 255], [0, 0, 7]], np.uint8)
    save(tmp_path / "grey.png", mask[..., None])
    save(tmp_path / "colour.png", mask[..., None] * np.array([0, 1, 0], np.uint8))
    for name in ("grey.png", "colour.png"):
        found = read_mask(tmp_path / name)
        assert found.dtype == np.bool_
        np.testing.assert_array_equal(found, mask > 0)
    assert "none.png" in refusal(lambda: read_mask(tmp_path / "none.png"))


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((2, 2, 1)), np.zeros((0, 2))])
def test_only_maps_become_pfm(tmp_path: Path, values: NDArray[Any]) -> None:
    text = refusal(lambda: write_pfm(tmp_path / "a.pfm", values))
    assert "a.pfm" in text
    assert str(values.shape) in text


# --- whole or not at all ---


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    with atomic_write(path) as temporary:
        temporary.write_text("old")
        assert temporary.suffix == ".txt"
        assert not path.exists()
    with atomic_write(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyboardInterrupt("mine"), ValueError("mine")])
def test_a_file_is_not_written_at_all(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    for target in (path, tmp_path / "new" / "deep" / "b.txt"):
        with pytest.raises(type(error), match="mine"):
            interrupted(atomic_write(target), error)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def interrupted(context: AbstractContextManager[Path], error: BaseException) -> None:
    """Write half of a file, or into a folder, and fail."""
    with context as temporary:
        (temporary / "a.txt" if temporary.is_dir() else temporary).write_text("half")
        raise error


def test_a_folder_is_written_whole(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with atomic_folder(out) as temporary:
        (temporary / "a.txt").write_text("1")
        (temporary / "deep").mkdir()
        (temporary / "deep" / "b.txt").write_text("1")
        assert not out.exists()
    (out / "mine.txt").write_text("mine")
    with atomic_folder(out) as temporary:
        (temporary / "a.txt").write_text("2")
        assert (out / "a.txt").read_text() == "1"
    contents = {str(p.relative_to(out)): p.read_text() for p in out.rglob("*") if p.is_file()}
    assert contents == {"a.txt": "2", str(Path("deep", "b.txt")): "1", "mine.txt": "mine"}
    assert list(tmp_path.iterdir()) == [tmp_path / "new"]
    assert list((tmp_path / "new").iterdir()) == [out]


@pytest.mark.parametrize("exists", [False, True])
def test_a_folder_is_not_written_at_all(tmp_path: Path, exists: bool) -> None:
    out = tmp_path / "new" / "out"
    if exists:
        out.mkdir(parents=True)
    with pytest.raises(RuntimeError, match="mine"):
        interrupted(atomic_folder(out), RuntimeError("mine"))
    assert sorted(tmp_path.rglob("*")) == ([out.parent, out] if exists else [])


def test_new_files_have_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "plain.txt").write_text("")
    with atomic_write(tmp_path / "a.txt") as temporary:
        temporary.write_text("")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain.txt").stat().st_mode


def test_a_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "real")
    with atomic_folder(link) as temporary:
        (temporary / "a.txt").write_text("")
    file_link = tmp_path / "link.txt"
    file_link.symlink_to(tmp_path / "real" / "a.txt")
    with atomic_write(file_link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert file_link.is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "new"


def test_writers_at_the_same_time_do_not_disturb_each_other(tmp_path: Path) -> None:
    def write(index: int) -> None:
        for _ in range(10):
            write_pfm(tmp_path / "a.pfm", np.full((20, 20), index))

    threads = [threading.Thread(target=write, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(np.unique(read_map(tmp_path / "a.pfm"))) == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_places_that_cannot_be_written_are_found_early_and_late(tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    file.write_text("mine")
    for out in (file, file / "out", file / "deep" / "out"):
        assert f"{file} is a file" in refusal(lambda out=out: check_writable(out))
        assert str(out) in refusal(lambda out=out: enter(atomic_folder(out)))
    assert f"{tmp_path} cannot be written: it is a folder" in refusal(lambda: check_writable(tmp_path, folder=False))
    assert f"{tmp_path} cannot be written: it is a folder" in refusal(lambda: enter(atomic_write(tmp_path)))
    assert f"{file} is a file" in refusal(lambda: check_writable(file / "a.pfm", folder=False))
    assert str(file / "a.pfm") in refusal(lambda: write_pfm(file / "a.pfm", MAP))
    assert file.read_text() == "mine"


def enter(context: Any) -> None:
    with context:
        pass


def test_places_that_can_be_written_pass_and_nothing_is_made(tmp_path: Path) -> None:
    (tmp_path / "a.pfm").write_text("")
    check_writable(tmp_path)
    check_writable(tmp_path / "new" / "deep")
    check_writable(tmp_path / "a.pfm", folder=False)
    check_writable(tmp_path / "new" / "a.pfm", folder=False)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.pfm"]


@pytest.mark.usefixtures("_permissions_count")
def test_places_without_permission(tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    (closed / "open").mkdir(parents=True)
    closed.chmod(0o500)
    try:
        for out in (closed, closed / "new", closed / "new" / "deep"):
            assert f"no permission to write in {closed}" in refusal(lambda out=out: check_writable(out))
            assert "Permission denied" in refusal(lambda out=out: enter(atomic_folder(out)))
        assert f"no permission to write in {closed}" in refusal(lambda: check_writable(closed / "a", folder=False))
        check_writable(closed / "open")  # as a mounted folder in a container is
        with atomic_folder(closed / "open") as temporary:
            (temporary / "a.txt").write_text("")
        assert (closed / "open" / "a.txt").exists()
        closed.chmod(0)
        assert f"no permission to write in {closed}" in refusal(lambda: check_writable(closed / "open" / "new"))
    finally:
        closed.chmod(0o700)


# --- real data ---

DATA = Path(os.environ.get("LFGPU_DATA", Path(__file__).parents[2] / "shared" / "data"))


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
        ("lytro_2067", (81, 383, 552, 3), (9, 9), ["The file names count rows and columns from 1."]),
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


def test_a_folder_in_the_way_of_one_file_leaves_all_files_as_they_were(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "b.txt").mkdir(parents=True)
    (out / "a.txt").write_text("old")

    def write() -> None:
        with atomic_folder(out) as folder:
            for name in ("a.txt", "b.txt", "c.txt"):
                (folder / name).write_text("new")

    with pytest.raises(LightFieldError, match=r"b\.txt is in the way"):
        write()
    assert (out / "a.txt").read_text() == "old"
    assert sorted(path.name for path in out.iterdir()) == ["a.txt", "b.txt"]
