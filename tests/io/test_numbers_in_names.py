"""What the numbers in names of pictures count: words, dates, times, patterns, and what is asked."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import lfgpu
from fields import linear, write_exr
from PIL import Image
from samples import grid_of, picture, planes, refusal, save, save_as, stored_as

from lfgpu.batch.items import find_items
from lfgpu.data import LightField
from lfgpu.io import read
from lfgpu.io.images import TURNED, read_image
from lfgpu.pipelines.sources.base import Options
from lfgpu.pipelines.sources.folder import frames
from lfgpu.scenes import make


@pytest.fixture(scope="module")
def true() -> LightField:
    return planes()


WORDS = {
    "row and col": lambda v, u: f"row{v}_col{u}.png",
    "col and row": lambda v, u: f"col{u}_row{v}.png",
    "x and y": lambda v, u: f"cam_x{u}_y{v}.png",
    "v and u": lambda v, u: f"v{v}u{u}.png",
    "u and v": lambda v, u: f"u{u}_v{v}.png",
    "s and t": lambda v, u: f"s{u}_t{v}.png",
    "capitals": lambda v, u: f"Scene7 X{u + 1} Y{v + 1}.PNG",
    "camel case": lambda v, u: f"camX{u}Y{v}.png",
    "words behind": lambda v, u: f"{v}row_{u}col.png",
    "no words": lambda v, u: f"cam_{v}_{u}.png",
    "two digits": lambda v, u: f"view_{v:02d}_{u:02d}.png",
    "a number before": lambda v, u: f"2067_{v:02d}_{u:02d}.png",
    "numbers only": lambda v, u: f"{v}_{u}.bmp",
    "letters": lambda v, u: f"r{v}c{u}.PNG",
    "three digits": lambda v, u: f"lf_v{v:03d}u{u:03d}.TIFF",
    "other letters": lambda v, u: f"Straße 7 – ({v}, {u}) final.png",
    "hyphens": lambda v, u: f"img-{v}-{u}.tif",
    "hyphens that are no signs": lambda v, u: f"view_-{v}_-{u}.png",
    "two hyphens": lambda v, u: f"view--{v}-{u}.png",
    "by": lambda v, u: f"view_{v}x{u}.png",
    "one word": lambda v, u: f"row{v} - {u}.png",
    "a counter beside": lambda v, u: f"IMG_{1000 + 4 * v + u}_row{v}_col{u}.png",
    "a date beside": lambda v, u: f"20240229_120000_r{v}_c{u}.png",
    "the times beside": lambda v, u: f"20240229_1200{4 * v + u:02d}_r{v}_c{u}.png",
    "a day before": lambda v, u: f"row{v}/2024-02-29 {u:02d}.png",
    "rows in folders": lambda v, u: f"row_{v}/{u:03d}.png",
    "columns in folders": lambda v, u: f"column {u}/row {v}.png",
}


@pytest.mark.parametrize("name", WORDS.values(), ids=WORDS)
def test_words_are_believed(name: Callable[[int, int], str], true: LightField, tmp_path: Path) -> None:
    found = read(save_as(tmp_path / "in", true, name))
    assert found.grid_shape == (3, 4)
    for row, column in np.ndindex(3, 4):
        np.testing.assert_array_equal(found.view(row, column), true.view(row, column))
    assert found.notes == ()


def moved(lf: LightField, time: int) -> LightField:
    """What it shows, some pixels further down at each time."""
    return replace(lf, views=np.roll(lf.views, 5 * time, axis=2))


def test_cameras_and_times(true: LightField, tmp_path: Path) -> None:
    row = true.subset("row")
    for time in range(3):
        save_as(tmp_path, moved(row, time), lambda v, u, time=time: f"cam{u:02d}_frame{time:04d}.png")
    first, last = read(tmp_path), read(tmp_path, frame=2)
    np.testing.assert_array_equal(first.views, row.views)
    np.testing.assert_array_equal(last.views, moved(row, 2).views)
    assert first.grid_shape == (1, 4)
    assert "4 cameras and 3 times; this is time 0 (cam00_frame0000.png" in first.notes[0]
    assert "camera (the word cam says so)" in first.reading.places
    assert "frame must be from 0 to 2" in asked(tmp_path, frame=3)
    items, _ = find_items([str(tmp_path)], sequence=True)
    assert [(item.frame, item.sequence) for item in items] == [(time, str(tmp_path)) for time in range(3)]
    assert len(list(frames(str(tmp_path), Options()))) == 3
    (tmp_path / "cam03_frame0001.png").rename(tmp_path / "cam03_frame0002b.png")
    assert "pictures of 3 of its 4 cameras at time 1" in asked(tmp_path, frame=1)
    assert len(read(tmp_path, frame=1, allow_missing=True).views) == 3


@pytest.mark.parametrize("name", ["cam{n}/frame{t}.png", "t{t}/camera {n}.png", "frame_{t}/{n}.png"])
def test_cameras_and_times_in_folders(name: str, true: LightField, tmp_path: Path) -> None:
    row = true.subset("row")
    for time in range(3):
        save_as(tmp_path, moved(row, time), lambda v, u, time=time: name.format(n=u, t=time))
    pattern = {"pattern": name} if name.startswith("frame_") else {}
    np.testing.assert_array_equal(read(tmp_path, frame=1, **pattern).views, moved(row, 1).views)
    live = list(frames(str(tmp_path), Options(reading=pattern)))
    np.testing.assert_array_equal([lf.views for lf in live], [moved(row, time).views for time in range(3)])


def test_live_frames_are_read_as_told(true: LightField, tmp_path: Path) -> None:
    for time in range(2):
        save_as(tmp_path / f"take_{time}", moved(true, time), lambda v, u: f"a{u}-b{v}-c7.png")
    assert "--pattern" in refusal(lambda: list(frames(str(tmp_path), Options())))
    live = list(frames(str(tmp_path), Options(reading={"pattern": "a{u}-b{v}-*.png"})))
    np.testing.assert_array_equal([lf.views for lf in live], [moved(true, time).views for time in range(2)])
    for time in range(2):
        save_as(tmp_path / "row" / str(time), true, lambda v, u: f"img{4 * v + u:02d}.png")
    assert "--grid" in refusal(lambda: list(frames(str(tmp_path / "row"), Options())))
    assert next(frames(str(tmp_path / "row"), Options(grid=(3, 4)))).grid_shape == (3, 4)
    ended = lfgpu("live", tmp_path, "--pattern", "x{u}.png", "--frames", 1, "--device", "cpu")
    assert "no picture whose name is of the pattern" in ended.err
    assert ended.code == 1


def test_patterns_say_what_numbers_count(true: LightField, tmp_path: Path) -> None:
    save_as(tmp_path, true, lambda v, u: f"a{u}-b{v}-c7.png")
    assert '--pattern "a{?}-b{?}-c7.png"' in refusal(lambda: read(tmp_path))
    found = read(tmp_path, pattern="a{u}-b{v}-*.png")
    np.testing.assert_array_equal(found.view(2, 1), true.view(2, 1))
    assert "no picture whose name is of the pattern" in refusal(lambda: read(tmp_path, pattern="x{u}.png"))
    assert "pattern must name numbers" in refusal(lambda: read(tmp_path, pattern="a{q}.png"))
    assert "pattern must name numbers" in refusal(lambda: read(tmp_path, pattern="*.png"))
    for pattern in ("a{u}-b{u}-c7.png", "a{n}-b{v}-c7.png"):
        assert "says twice where a camera stood" in asked(tmp_path, pattern=pattern)


@pytest.mark.parametrize("name", ["{0}_{1:02d}.png", "{1:02d}_{0}.png", "row{0}/{1:03d}.png", "line {0} - {1}.png"])
def test_numbers_that_go_on_from_row_to_row_are_no_columns(name: str, true: LightField, tmp_path: Path) -> None:
    save_as(tmp_path, true, lambda v, u: name.format(v, 4 * v + u))
    assert "has 12 numbered images, in one row or in a grid" in refusal(lambda: read(tmp_path))
    np.testing.assert_array_equal(read(tmp_path, grid=(3, 4)).view(2, 1), true.view(2, 1))


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("IMG_20240229_1200{0:02d}.png", "IMG_{date}_{time}.png"),
        ("2024-02-29 12.00.{0:02d}.png", None),
        ("20240229T1200{0:02d}500.png", None),
        ("PXL_20240229_1200{0:02d}123.png", "PXL_{date}_{time}.png"),
        ("shot 12-00-{0:02d}.png", None),
        ("17091935{0:02d}.png", "{date}.png"),
        ("Screenshot 2024-02-29 at 9.05.{0:02d}.png", None),
        ("2024-02-29_12-{0:02d}.png", None),
    ],
)
def test_dates_and_times_are_no_places(name: str, pattern: str | None, tmp_path: Path) -> None:
    for number, second in enumerate((3, 4, 7, 11, 20)):
        save(tmp_path / name.format(second), picture(number))
    text = refusal(lambda: read(tmp_path))
    assert "are times, which say nothing of where the camera stood" in text
    asked = text.split('--pattern "')[1].split('"')[0]
    assert pattern in (None, asked)
    found = read(tmp_path, pattern=asked)
    assert found.grid_shape == (1, 5)
    np.testing.assert_array_equal(found.views[3], picture(3))


def asked(folder: Path, **options: Any) -> str:
    return refusal(lambda: read(folder, **options))


@pytest.mark.parametrize(
    ("number", "order"),
    [
        (lambda v, u: 4 * v + u, ""),
        (lambda v, u: 4 * v + (u if v % 2 == 0 else 3 - u), "serpentine"),
        (lambda v, u: 3 * u + v, "column-major"),
    ],
)
def test_numbered_images_in_a_grid_are_asked_about(
    number: Callable[[int, int], int], order: str, true: LightField, tmp_path: Path
) -> None:
    save_as(tmp_path, true, lambda v, u: f"img{number(v, u):02d}.png")
    text = asked(tmp_path)
    assert "--grid 1x12, --grid 2x6, --grid 3x4, --grid 4x3, --grid 6x2" in text
    assert f"; by the pictures --grid 3x4{f' --order {order}' if order else ''} fits" in text
    found = read(tmp_path, grid=(3, 4), order=order or None)
    for row, column in np.ndindex(3, 4):
        np.testing.assert_array_equal(found.view(row, column), true.view(row, column))


def test_a_row_whose_pictures_show_it_is_not_asked_about(tmp_path: Path) -> None:
    row = planes((1, 6))
    found = read(save_as(tmp_path / "in", row, lambda v, u: f"img{u:02d}.png"))
    assert found.grid_shape == (1, 6)
    assert "by their parallax they stand in one row" in found.reading.places
    found = read(save_as(tmp_path / "frames", row, lambda v, u: f"frame_{u:04d}.png"))
    assert found.grid_shape == (1, 6)


@pytest.mark.parametrize("options", [{}, {"grid": (3, 4)}, {"grid": (3, 4), "allow_missing": True}])
@pytest.mark.parametrize("word", ["img", "cam", "7_view "])
def test_two_digits_that_make_a_grid_are_asked_about(
    word: str, options: dict[str, Any], true: LightField, tmp_path: Path
) -> None:
    save_as(tmp_path, true, lambda v, u: f"{word}{v + 1}{u + 1}.png")
    text = asked(tmp_path, **options)
    assert f'a full grid of 3 x 4: if these are row and column, say --pattern "{word}{{v}}{{u}}.png"' in text
    np.testing.assert_array_equal(read(tmp_path, pattern=f"{word}{{v}}{{u}}.png").views, true.views)
    row = read(tmp_path, pattern=f"{word}{{n}}.png", allow_missing=True)
    assert row.grid_shape == (1, 24)


def test_two_digits_without_gaps_are_no_rows_and_columns(true: LightField, tmp_path: Path) -> None:
    save_as(tmp_path, true, lambda v, u: f"img{10 + 5 * (4 * v + u)}.png")
    assert read(tmp_path, grid=(3, 4)).grid_shape == (3, 4)


def test_a_grid_that_the_pictures_contradict_is_named(true: LightField, tmp_path: Path) -> None:
    save_as(tmp_path, true, lambda v, u: f"im_{4 * v + u:02d}.png")
    assert read(tmp_path, grid=(4, 3)).notes == (
        "By their parallax the views do not stand where they are said to stand; --grid 3x4 fits (grid= in Python).",
    )
    assert read(tmp_path, grid=(3, 4)).notes == ()


def test_a_grid_is_compared_with_the_views_that_are_there(true: LightField, tmp_path: Path) -> None:
    save_as(tmp_path, true, lambda v, u: f"img{10 * v + u:03d}.png")
    text = asked(tmp_path, grid=(3, 4), allow_missing=True)
    assert "has 12 views, whose numbers from 0 to 23 count 24 places, but a grid of 3 x 4 has 12" in text


def test_what_is_named_otherwise(tmp_path: Path) -> None:
    for number in range(5):
        save(tmp_path / f"cam{number}.png", picture(number))
        save(tmp_path / f"cam{number}_mask.png", picture(number))
    text = asked(tmp_path)
    assert "named in different ways: cam0.png and cam0_mask.png" in text
    assert '--pattern "cam{n}.png"' in text
    assert len(read(tmp_path, pattern="cam{n}.png").views) == 5


@pytest.mark.parametrize("name", ["{letter}{number}.png", "img_{number}{letter}.png", "row{letter}_{number}.png"])
def test_letters_that_may_be_rows_are_asked_about(name: str, tmp_path: Path) -> None:
    for place in range(9):
        save(tmp_path / name.format(letter="ABC"[place // 3], number=place % 3 + 1), picture(place))
    first, other = (name.format(letter=letter, number=1) for letter in "AB")
    text = asked(tmp_path)
    assert f"names differ by a letter, such as {first} and {other}: if letters count rows, columns or" in text
    assert f'--pattern "{name.format(letter="A", number="{n}")}"' in text


def test_exposures_are_chosen(tmp_path: Path) -> None:
    for number in range(3):
        for exposure in (10, 100):
            save(tmp_path / f"cam{number}_exp{exposure}.png", picture(number + exposure))
    text = asked(tmp_path)
    assert 'choose one with --pattern "cam{n}_exp10.png"' in text
    np.testing.assert_array_equal(read(tmp_path, pattern="cam{n}_exp100.png").views[1], picture(101))


def test_folders_of_cameras_with_numbered_images_are_asked_about(tmp_path: Path) -> None:
    for camera in range(3):
        for number in range(4):
            save(tmp_path / f"cam{camera}" / f"{number:04d}.png", picture(10 * camera + number))
    text = asked(tmp_path)
    assert '"cam{u}/{t}.png" for cameras and times' in text
    found = read(tmp_path, pattern="cam{u}/{t}.png", frame=2)
    np.testing.assert_array_equal(found.views[1], picture(12))


def test_folders_of_times_with_grids_are_asked_about(true: LightField, tmp_path: Path) -> None:
    for time in range(2):
        save_as(tmp_path / f"{time:05d}", moved(true, time), WORDS["no words"])
    pattern = asked(tmp_path).split('such as "')[1].split('"')[0]
    assert pattern == "{t}/cam_{v}_{u}.png"
    np.testing.assert_array_equal(read(tmp_path, pattern=pattern, frame=1).views, moved(true, 1).views)


def test_a_view_read_as_another_orientation_or_order_is_noticed(true: LightField, tmp_path: Path) -> None:
    folder = save_as(tmp_path / "in", true, lambda v, u: f"row{u}_col{v}.png")
    turned = read(folder)
    assert "rows of cameras are taken for columns: read it with --transpose." in turned.notes[-1]
    right = read(folder, transpose=True)
    assert right.notes == ()
    np.testing.assert_array_equal(right.view(2, 1), true.view(2, 1))
    both = read(save_as(tmp_path / "both", true, lambda v, u: f"row{u}_col{2 - v}.png"))
    assert "read it with --transpose --flip v" in both.notes[-1]
    assert "read it without --flip v" in read(save_as(tmp_path / "b", true, WORDS["u and v"]), flip="v").notes[-1]


def run(*arguments: object) -> str:
    """What a command says that ends well, in one line."""
    found = lfgpu(*arguments)
    assert found.code == 0, found.err
    return " ".join(found.out.split())


@pytest.mark.usefixtures("_no_look")
def test_info_says_what_was_taken_for_what(true: LightField, tmp_path: Path) -> None:
    folder = save_as(tmp_path / "in", true, WORDS["u and v"])
    lines = run("info", folder)
    assert "places the numbers in names such as u0_v0.png are column (the word u says so); row (the word v" in lines
    assert "pictures oriented as they are stored, all pixels are valid" in lines
    assert "lengths none: there is disparity only" in lines
    save_as(tmp_path / "named", true, lambda v, u: f"a{u}-b{v}.png")
    lines = run("info", tmp_path / "named", "--pattern", "a{v}-b{u}.png", "--transpose")
    assert "3 x 4 grid" in lines
    assert "rows and columns swapped, as told" in lines
    run("info", tmp_path / "named", "--pattern", "a{u}-b{v}.png", "--write", tmp_path / "a.toml")
    assert read(tmp_path / "a.toml").grid_shape == (3, 4)


@pytest.mark.usefixtures("_no_look")
def test_a_description_of_an_array_keeps_what_was_told(true: LightField, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", stored_as("yxuvc", grid_of(true)))
    run("info", tmp_path / "a.npy", "--axes", "yxuvc", "--write", tmp_path / "a.toml")
    np.testing.assert_array_equal(read(tmp_path / "a.toml").views, true.views)
    run("info", tmp_path / "a.npy", "--axes", "yxvuc", "--transpose", "--write", tmp_path / "b.toml")
    np.testing.assert_array_equal(read(tmp_path / "b.toml").view(2, 1), true.view(2, 1))


def test_equal_pictures_are_no_light_field(true: LightField, tmp_path: Path) -> None:
    for number in range(5):
        save(tmp_path / f"cam{number}.png", true.views[0])
    assert "All views are the same picture: there is no parallax" in read(tmp_path).notes[-1]


def test_rows_in_alternating_directions_are_named(true: LightField, tmp_path: Path) -> None:
    save_as(tmp_path, true, lambda v, u: f"row{v}_col{u if v % 2 == 0 else 3 - u}.png")
    turning = read(tmp_path)
    assert turning.notes[-1].endswith("--order serpentine fits (order= in Python).")
    right = read(tmp_path, order="serpentine")
    assert right.notes == ()
    np.testing.assert_array_equal(right.view(1, 0), true.view(1, 0))


@pytest.mark.parametrize("places", [[(1, 3)], [(0, 0), (2, 2)], [(1, 2)]])
def test_pictures_upside_down_are_named(places: list[tuple[int, int]], true: LightField, tmp_path: Path) -> None:
    views = true.views.copy()
    for row, column in places:
        views[true.index_of(row, column)] = true.view(row, column)[::-1, ::-1]
    save_as(tmp_path, replace(true, views=views), lambda v, u: f"view_{v}_{u}.png")
    note = read(tmp_path).notes[-1]
    assert all(f"row {row}, column {column}" in note for row, column in places)
    assert note.endswith("upside down: turn it by 180 degrees." if len(places) == 1 else "turn them by 180 degrees.")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["png", "jpg", "tif", "webp"])
def test_all_formats_are_upright_as_exif_says(kind: str, orientation: int, tmp_path: Path) -> None:
    """A picture with a bright corner, stored such that the orientation brings it upright; in colour and grey."""
    stored = {1: (0, 0), 2: (0, 1), 3: (1, 1), 4: (1, 0), 5: (0, 0), 6: (1, 0), 7: (1, 1), 8: (0, 1)}
    picture = np.full((32, 64, 3) if orientation < 5 else (64, 32, 3), 40, np.uint8)
    half_y, half_x = (side // 2 for side in picture.shape[:2])
    row, column = stored[orientation]
    picture[half_y * row : half_y * (row + 1), half_x * column : half_x * (column + 1)] = 220
    exif = Image.Exif()
    exif[0x112] = orientation
    for shown in (picture, picture[..., 0]):
        Image.fromarray(shown).save(tmp_path / f"a.{kind}", exif=exif)
        upright, remarks = read_image(tmp_path / f"a.{kind}")
        assert upright.shape[:2] == (32, 64)
        assert upright[:14, :30].min() > 200
        assert max(upright[18:, :].max(), upright[:, 34:].max()) < 60
        assert (TURNED in remarks) == (orientation != 1)


@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_white_stored_as_0(kind: str, tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    top = {"u1": 255, "u2": 65535, "f4": 1}[kind]
    ramp = np.tile(np.linspace(0, top, 40).astype(kind), (32, 1))
    tifffile.imwrite(tmp_path / "a.tif", (top - ramp).astype(kind), photometric="miniswhite")
    found, _ = read_image(tmp_path / "a.tif")
    np.testing.assert_allclose(found[..., 0], ramp, atol=1e-6 if kind == "f4" else 0)


def test_folders_of_openexr(true: LightField, tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    alpha = np.pad(np.ones((96, 100), np.float32), ((0, 0), (0, 12)))
    for view, (u, v) in zip(true.views, true.positions.astype(int).tolist(), strict=True):
        write_exr(tmp_path / f"view_{v}_{u}.exr", {**linear(view), "A": alpha})
    found = read(tmp_path)
    assert (found.grid_shape, found.views.dtype) == ((3, 4), np.uint16)
    np.testing.assert_allclose(found.views / 65535, true.views / 255, atol=1e-4)
    assert found.valid[:, :, :100].all()
    assert not found.valid[:, :, 100:].any()


def test_arrays_whose_axes_make_no_sense_are_asked_about(true: LightField, tmp_path: Path) -> None:
    grid, flat = grid_of(true), true.views[:9]
    for order in ("yxvuc", "vucyx", "cvuyx", "yxcvu", "ncyx", "yxcn", "yxnc", "cnyx"):
        options = {"grid": (3, 3)} if "n" in order else {}
        np.save(tmp_path / "a.npy", stored_as(order, flat if options else grid))
        assert f" {order}" in asked(tmp_path / "a.npy", **options)
        found = read(tmp_path / "a.npy", axes=order, **options)
        np.testing.assert_array_equal(found.views, flat if options else true.views)
    assert "axes must be letters such as vuyxc" in asked(tmp_path / "a.npy", axes="vux")
    assert "of which axes nyxc make" in asked(tmp_path / "a.npy", axes="nyxc", grid=(3, 3))


def test_arrays_of_views_one_after_the_other(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", planes((3, 3)).views)
    assert "a square, as their parallax shows" in read(tmp_path / "a.npy").reading.places
    np.save(tmp_path / "b.npy", planes((1, 9)).views)
    assert "--grid 1x9 fits" in asked(tmp_path / "b.npy")
    assert read(tmp_path / "b.npy", grid=(1, 9)).grid_shape == (1, 9)


@pytest.mark.parametrize(("order", "kind"), [("ZCYX", "imagej"), ("ZCYX", "ome"), ("CZYX", "ome"), ("TZCYX", "ome")])
def test_axes_that_a_tiff_names(order: str, kind: str, tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    lf = make("planes", grid=(3, 3), size=(40, 48), seed=1)
    axes = order.replace("T", "v").replace("Z", "u" if "T" in order else "n").lower()
    stored = stored_as(axes, grid_of(lf) if "T" in order else lf.views)
    tifffile.imwrite(tmp_path / "a.tif", stored, **{kind: True}, metadata={"axes": order})
    found = read(tmp_path / "a.tif")
    np.testing.assert_array_equal(found.views, lf.views)
    assert f"are {axes}, as the file names them" in found.reading.places


def test_pages_that_were_appended_and_planes(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    lf = make("planes", grid=(3, 3), size=(40, 48), seed=1)
    for view in lf.views:
        tifffile.imwrite(tmp_path / "a.tif", view, append=True, photometric="rgb")
    np.testing.assert_array_equal(read(tmp_path / "a.tif").views, lf.views)
    tifffile.imwrite(tmp_path / "b.tif", lf.views[..., 0], planarconfig="separate", photometric="minisblack")
    np.testing.assert_array_equal(read(tmp_path / "b.tif").views[..., 0], lf.views[..., 0])


def test_tiles_given_as_a_mosaic(true: LightField, tmp_path: Path) -> None:
    sheet = np.concatenate([np.concatenate(list(row), axis=1) for row in grid_of(true)])
    save(tmp_path / "a.png", sheet)
    for options in ({}, {"grid": (3, 4)}, {"grid": (8, 8)}):
        assert "--format tiles --grid 3x4" in asked(tmp_path / "a.png", format="mosaic", **options)
    for options in ({}, {"grid": (3, 4)}):
        np.testing.assert_array_equal(read(tmp_path / "a.png", format="tiles", **options).views, true.views)
    assert "does not fill" in asked(tmp_path / "a.png", format="tiles", grid=(5, 5))
    save(tmp_path / "b.png", true.views[0])
    assert "no views side by side that look alike" in asked(tmp_path / "b.png", format="tiles")
