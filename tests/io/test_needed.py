"""Views that nobody needs are not read; whatever needs all views reads all."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu, refused
from numpy.typing import NDArray
from samples import box, picture, refusal, save, save_hci, save_named

from lfgpu import estimate_depth, scenes
from lfgpu.data.layout import in_pattern
from lfgpu.data.mapping import is_mapped
from lfgpu.io import load, read, write_hci
from lfgpu.methods import method_of, preset
from lfgpu.pipelines.verdict import needed_views

CORNER, IN_ROW = "view_00_00.png", "view_02_01.png"


def cross(offsets: NDArray[np.float64]) -> NDArray[np.intp]:
    return np.flatnonzero(in_pattern(offsets, "cross"))


def save_signed(folder: Path, first: int) -> Path:
    for row, column in box(5, 5, first):
        save(folder / f"cam_{row:+d}_{column:+d}.png", picture(10 * (row + 5) + column + 5))
    return folder


@pytest.mark.parametrize(
    "made",
    [
        lambda folder: save_named(folder, box(5, 5)),
        lambda folder: save_signed(folder, first=-2),
        lambda folder: save_signed(folder, first=-1),
        lambda folder: save_hci(folder, range(24), rows=4, columns=6),
    ],
    ids=["from 0", "around 0", "0 beside the middle", "hci"],
)
def test_the_part_is_that_of_all_views(made: Callable[[Path], Path], tmp_path: Path) -> None:
    folder = made(tmp_path / "views")
    part, expected = read(folder, needed=cross), read(folder).subset("cross")
    assert len(part.views) < 24
    np.testing.assert_array_equal(part.views, expected.views)
    np.testing.assert_array_equal(part.positions, expected.positions)
    for name in ("reference", "grid_shape", "files", "geometry", "notes", "reading", "name"):
        assert getattr(part, name) == getattr(expected, name), name


def grid_of(rows: int, columns: int, channels: int) -> NDArray[np.uint8]:
    return np.random.default_rng(rows).integers(0, 256, (rows, columns, 20, 24, channels), np.uint8)


@pytest.mark.parametrize(
    ("array", "options"),
    [
        (grid_of(5, 5, 3), {}),
        (grid_of(5, 6, 1)[..., 0], {}),
        (grid_of(5, 4, 3).reshape(20, 20, 24, 3), {"grid": (5, 4)}),
        (np.asfortranarray(grid_of(5, 5, 3)), {}),
        (grid_of(5, 5, 3).transpose(2, 3, 0, 1, 4), {"axes": "yxvuc"}),
        (grid_of(5, 5, 3).astype(">u2"), {}),
        (grid_of(5, 5, 3) / np.float32(255), {}),
    ],
    ids=["uint8", "grey", "one after the other", "fortran", "other axes", "big-endian", "float32"],
)
def test_the_part_of_an_array_is_that_of_all_views(array: NDArray, options: dict[str, object], tmp_path: Path) -> None:
    file = tmp_path / "views.npy"
    np.save(file, array)
    part, expected = read(file, needed=cross, **options), read(file, **options).subset("cross")
    assert is_mapped(read(file, needed=cross, lazy=True, **options).views) == is_mapped(
        read(file, lazy=True, **options).views
    )
    file.write_bytes(b"gone")  # views are in memory
    if array.dtype != ">u2":  # which is converted whole
        assert len(part.views) < 20
    np.testing.assert_array_equal(part.subset("cross").views, expected.views)
    np.testing.assert_array_equal(part.subset("cross").positions, expected.positions)
    for name in ("grid_shape", "geometry", "notes", "reading", "name"):
        assert getattr(part, name) == getattr(expected, name), name


def test_an_array_with_masks_is_read_whole(tmp_path: Path) -> None:
    array = np.concatenate([grid_of(5, 5, 3), np.full((5, 5, 20, 24, 1), 255, np.uint8)], axis=-1)
    array[2, 1, 0, 0, 3] = 0
    np.save(tmp_path / "views.npy", array)
    part, expected = read(tmp_path / "views.npy", needed=cross), read(tmp_path / "views.npy")
    np.testing.assert_array_equal(part.views, expected.views)
    np.testing.assert_array_equal(part.valid, expected.valid)
    assert part.notes == expected.notes


def test_a_file_is_opened_only_if_it_is_needed_and_noticed_wherever_it_is_missing(tmp_path: Path) -> None:
    save_named(tmp_path, box(5, 5))
    (tmp_path / CORNER).write_bytes(b"no picture")
    assert len(read(tmp_path, needed=cross).views) == 9
    assert CORNER in refusal(lambda: read(tmp_path))
    (tmp_path / CORNER).unlink()
    assert "row 0 column 0" in refusal(lambda: read(tmp_path, needed=cross))
    assert read(tmp_path, needed=cross, allow_missing=True).notes == read(tmp_path, allow_missing=True).notes
    save(tmp_path / CORNER)
    save(tmp_path / IN_ROW, picture()[:3])
    assert IN_ROW in refusal(lambda: read(tmp_path, needed=cross))
    (tmp_path / IN_ROW).write_bytes(b"no picture")
    assert IN_ROW in refusal(lambda: read(tmp_path, needed=cross))


def transparent(folder: Path) -> None:
    image = np.concatenate([picture(), np.full((4, 5, 1), 255, np.uint8)], axis=2)
    image[0, 0, 3] = 0
    save(folder / IN_ROW, image)


def twelve_bits(folder: Path) -> None:
    for row, column in box(5, 5):
        save(folder / f"view_{row:02d}_{column:02d}.png", picture(row, channels=1, dtype=np.uint16) >> 4)


def twice(folder: Path) -> None:
    (folder / IN_ROW).write_bytes((folder / "view_02_03.png").read_bytes())


@pytest.mark.parametrize("change", [transparent, twelve_bits, twice])
def test_what_all_views_decide_is_decided_by_all(change: Callable[[Path], None], tmp_path: Path) -> None:
    change(save_named(tmp_path, box(5, 5)))
    part, all_views = read(tmp_path, needed=cross), read(tmp_path)
    assert (len(part.views), part.notes, part.white) == (25, all_views.notes, all_views.white)
    assert part.notes


def test_other_places_of_the_cameras_need_all_files(tmp_path: Path) -> None:
    save_named(tmp_path, box(5, 5))
    for options in ({"flip": "u"}, {"transpose": True}, {"order": "column-major"}):
        assert len(read(tmp_path, needed=cross, **options).views) == 25


@pytest.mark.parametrize(
    ("name", "side", "count"), [("fast", 9, 29), ("fast", 15, 29), ("fast", 2, 4), ("accurate", 7, 49)]
)
def test_an_estimate_needs_the_views_that_it_uses_and_25_or_more_to_look_at(name: str, side: int, count: int) -> None:
    v, u = np.mgrid[:side, :side] - side // 2
    offsets, rule = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64), needed_views(preset(name))
    needed = rule(offsets)
    assert len(needed) == count
    assert set(method_of(preset(name)).used_views(offsets)) <= set(needed)
    np.testing.assert_array_equal(rule(offsets[needed]), np.arange(count))


def test_fast_maps_are_the_same_from_the_views_that_are_needed(tmp_path: Path) -> None:
    lf = scenes.make("boxes", grid=(7, 7), size=(48, 56))
    write_hci(lf, tmp_path / "boxes")
    unread = np.setdiff1d(np.arange(49), needed_views(preset("fast"))(lf.offsets))[0]
    broken = tmp_path / "boxes" / f"input_Cam{unread:03d}.png"
    broken.write_bytes(b"no picture")
    assert lfgpu("depth", tmp_path / "boxes", "-o", tmp_path / "out", "--preset=fast", "--device=cpu").code == 0
    found, expected = load(tmp_path / "out" / "result.npz"), estimate_depth(lf, config="fast", device="cpu")
    for part in ("disparity", "confidence", "uncertainty"):
        np.testing.assert_array_equal(getattr(found, part), getattr(expected, part))
    assert (found.notes, found.remarks) == (expected.notes, expected.remarks)
    for needs_all in ("--all-views", "--report", "--reference-view=3,2", "--preset=accurate"):
        options = ("--preset=fast", "--device=cpu", needs_all)
        refused(lfgpu("depth", tmp_path / "boxes", "-o", tmp_path / "all", *options), broken.name)


@pytest.mark.parametrize("kind", ["pictures", "array"])
def test_a_pattern_with_one_view_only_is_named_as_the_reason(kind: str, tmp_path: Path) -> None:
    row = save_named(tmp_path / "row", box(1, 5)) if kind == "pictures" else tmp_path / "row.npy"
    if kind == "array":
        np.save(row, grid_of(1, 5, 3))
    outcome = lfgpu("depth", row, "-o", tmp_path / "out", "--views", "column")
    refused(outcome, "row: the subset 'column' leaves the reference view alone; choose more views")
