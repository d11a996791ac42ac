"""The old HCI formats, folders of Stanford and plenopticam, rows, videos, descriptions, and what a user tries next."""

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fields import SAMPLES, scene
from PIL import Image
from samples import box, picture, refusal, save, save_named

from lfgpu.data import LightField
from lfgpu.io import read, recognise
from lfgpu.io.parallax import axes_agree


@pytest.mark.parametrize("grid", [(3, 3), (2, 4), (4, 2)])
def test_hdf5_counts_columns_from_the_right(tmp_path: Path, grid: tuple[int, int]) -> None:
    true = scene(grid)
    found = read(SAMPLES["hci-hdf5"].write(true, tmp_path))
    for v, u in box(*grid):
        np.testing.assert_array_equal(found.view(v, u), true.view(v, u))
    assert found.reference_truth() is not None
    assert found.notes == ("Lengths have no unit in the file: they are taken for metres.",)


def test_hdf5_that_counts_from_the_left_is_turned_round_by_its_truth(tmp_path: Path, true: LightField) -> None:
    import h5py

    path = SAMPLES["hci-hdf5"].write(true, tmp_path)
    with h5py.File(path, "r+") as file:
        file["LF"][...] = file["LF"][...][::-1, ::-1]
    found = read(path)
    np.testing.assert_array_equal(found.view(0, 0), true.view(0, 0))
    assert sum("they were turned round" in note for note in found.notes) == 2


def test_hdf5_in_a_folder_without_truth_and_grey(tmp_path: Path, true: LightField) -> None:
    import h5py

    path = SAMPLES["hci-hdf5"].write(true, tmp_path)
    with h5py.File(path, "r+") as file:
        grey = file["LF"][..., 0]
        del file["LF"], file["GT_DEPTH"], file.attrs["shift"]
        file["LF"] = grey
    found = read(tmp_path)
    assert (found.channels, found.truth, found.geometry) == (1, None, None)
    assert "dH, focalLength or shift is not known" in found.notes[0]
    save_named(tmp_path, box(2, 2))  # views are not passed over for a file beside them
    assert recognise(tmp_path)[0].name == "named-views"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"LF": None}, "has no dataset LF; it holds GT_DEPTH"),
        ({"LF": "hello"}, "wanted is an array of numbers"),
        ({"LF": {"shape": (9, 9, 40000, 40000, 3), "chunks": (1, 1, 100, 100, 3)}}, "is damaged: it claims"),
        ({"LF": {"shape": (2, 2, 4, 5, 3), "external": [("/etc/hostname", 0, 10_000)]}}, "lies in other files"),
        ({"GT_DEPTH": np.ones((3, 4))}, "has shape (3, 4), which does not fit"),
        ({"dH": "wide"}, "the attribute dH must be a number"),
        ({"focalLength": -3.0}, "must be positive"),
        ({"dV": 1.0}, "describe them in a lightfield.toml"),
    ],
)
def test_hdf5_that_is_refused(tmp_path: Path, true: LightField, change: dict[str, Any], words: str) -> None:
    """Datasets that are lost, or made of a value or with options; attributes of other values."""
    import h5py

    path = SAMPLES["hci-hdf5"].write(true, tmp_path)
    ((name, value),) = change.items()
    with h5py.File(path, "r+") as file:
        if name in file.attrs:
            file.attrs[name] = value
        else:
            del file[name]
        if isinstance(value, dict):
            file.create_dataset(name, dtype=np.uint8, **value)
        elif name not in file.attrs and value is not None:
            file[name] = value
    text = refusal(lambda: read(path))
    assert words in text
    assert str(path) in text


def test_export_that_contradicts_itself(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["hci-export"].write(true, tmp_path)
    attributes = (path / "attributes.dat").read_text()
    (path / "attributes.dat").write_text(attributes.replace("5 //vRes", "7 //vRes"))
    assert "says 7 x 5 views, found a grid of 5 x 5" in refusal(lambda: read(path))
    (path / "attributes.dat").write_text(attributes.replace("60.0 //", "sixty //"))
    assert "'focalLength' must be a number, not 'sixty'" in refusal(lambda: read(path))
    (path / "attributes.dat").write_text(attributes)
    (path / "depth.bin").write_bytes(b"123")
    assert "has 3 bytes; the depth of 48 x 40 pixels is 7680" in refusal(lambda: read(path))
    (path / "depth.bin").unlink()
    assert read(path).truth is None


def test_plenopticam_that_lost_a_row(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["plenopticam"].write(true, tmp_path)
    assert read(path / "viewpoints_5px").grid_shape == (5, 5)
    for file in path.glob("*/4_*.png"):
        file.unlink()
    assert "says 5 x 5 views, found a grid of 4 x 5" in refusal(lambda: read(path))
    (path / "viewpoints_3px").mkdir()
    assert "several exports (viewpoints_3px, viewpoints_5px)" in refusal(lambda: read(path))


def save_row(folder: Path, numbers: Any) -> Path:
    for number in numbers:
        save(folder / f"mansion_image_{number:04d}.png", picture(number))
    return folder


def test_numbered_images_are_a_row(tmp_path: Path) -> None:
    found = read(save_row(tmp_path / "a", range(25, 60, 5)))
    assert (found.grid_shape, found.reference) == ((1, 7), 3)
    np.testing.assert_array_equal(found.view(0, 2), picture(35))
    found = read(tmp_path / "a", every=3)
    np.testing.assert_array_equal(found.views[1], picture(40))
    assert found.grid_shape == (1, 3)
    assert read(tmp_path / "a", grid=(7, 1)).grid_shape == (7, 1)
    save(tmp_path / "a" / "cover.png")
    assert "not named as the others: cover.png" in read(tmp_path / "a").notes[0]


def test_numbered_images_that_leave_it_open(tmp_path: Path) -> None:
    save_row(tmp_path / "gaps", [1, 2, 3, 5])
    assert "lacks 1 of the 5 views" in refusal(lambda: read(tmp_path / "gaps"))
    assert len(read(tmp_path / "gaps", allow_missing=True).views) == 4
    save_row(tmp_path / "far", [1, 2, 20261231])
    assert "that is no row of cameras" in refusal(lambda: read(tmp_path / "far"))
    assert "several folders with numbered images" in refusal(lambda: read(tmp_path))


def test_videos(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["video"].write(true, tmp_path)
    row = true.views[true.row()]
    found = read(path, every=2)
    np.testing.assert_array_equal(found.views, row[::2])
    assert read(path, grid=(5, 1)).grid_shape == (5, 1)
    assert "5 views, which is not a grid of 2 x 2" in refusal(lambda: read(path, grid=(2, 2)))
    assert "has 1 frames to take" in refusal(lambda: read(path, every=9))
    path.write_bytes(path.read_bytes()[:200])
    assert f"{path} cannot be read as a video" in refusal(lambda: read(path))


def save_stanford(folder: Path, places: Any, end: str = "_") -> Path:
    for index, (row, column, y, x) in enumerate(places):
        save(folder / f"out_{row:02d}_{column:02d}_{y:.6f}_{x:.6f}{end}.png", picture(index))
    return folder


@pytest.mark.parametrize("end", ["_", ""])
def test_stanford_positions_are_irregular_view_steps(end: str, tmp_path: Path) -> None:
    """y counts downwards, whether names end in an underscore or not."""
    places = [(0, 0, -20.0, 100.0), (0, 1, -20.5, 110.0), (0, 2, -19.5, 121.0), (1, 0, -8.0, 101.0)]
    found = read(save_stanford(tmp_path, places, end))
    # The distances of neighbours in a row are 10 and 11: the step is their median.
    np.testing.assert_allclose(found.positions[:, 0] * 10.5, [0, 10, 21, 1], atol=1e-9)
    np.testing.assert_allclose(found.positions[:, 1] * 10.5, [0.5, 0, 1, 12.5], atol=1e-9)
    assert found.grid_shape is None
    assert "One view step is 10.5 in the unit" in found.notes[0]


def test_stanford_pictures_are_believed_against_names(tmp_path: Path, true: LightField) -> None:
    for index, (u, v) in enumerate(true.positions):
        name = f"out_{round(v):02d}_{round(u):02d}_{-v:.3f}_{u:.3f}_.png"
        Image.fromarray(true.views[index]).save(tmp_path / name)
    found = read(tmp_path)
    assert any("rows were turned round" in note for note in found.notes)
    np.testing.assert_allclose(found.positions[found.index_of(0, 0)], [0, 0])
    np.testing.assert_array_equal(found.view(0, 0), true.view(0, 0))


def test_stanford_that_is_refused(tmp_path: Path) -> None:
    told = {"stand in one place": (1.0, 1.0), "two views have the position": (1.0, 2.0, 2.0), "one view only": (1.0,)}
    for words, xs in told.items():
        folder = save_stanford(tmp_path / words, [(0, column, 5.0, x) for column, x in enumerate(xs)])
        assert words in refusal(lambda folder=folder: read(folder))


def describe(folder: Path, text: str) -> Path:
    save(folder / "a.png", picture(1))
    save(folder / "b.png", picture(2))
    save(folder / "mask.png", np.array(picture(3, 1) > 100, np.uint8) * np.uint8(255))
    (folder / "lightfield.toml").write_text(text, encoding="utf-8")
    return folder


TWO = '[[views]]\nfile = "a.png"\nposition = [0, 0]\n[[views]]\nfile = "b.png"\nposition = [1.5, -0.25]\n'


def test_a_description_by_hand(tmp_path: Path) -> None:
    text = (
        'name = "Bänke"\nreference = 0\n[geometry]\nfocal_length_px = 1200\nbaseline_m = 0.02\n'
        "principal_point = [1.0, 2.0]\n" + TWO + 'valid = "mask.png"\n'
    )
    found = read(describe(tmp_path, text))
    assert (found.name, found.reference, found.grid_shape) == ("Bänke", 0, None)
    np.testing.assert_array_equal(found.positions, [[0, 0], [1.5, -0.25]])
    assert (found.geometry.focus_distance_m, found.geometry.principal_point) == (float("inf"), (1, 2))
    assert found.valid[0].all()
    np.testing.assert_array_equal(found.valid[1], picture(3, 1)[..., 0] > 100)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("views = 3", "views must be a list"),
        ("colour = 1\n" + TWO, "a description has an unknown entry 'colour'"),
        (TWO + "angle = 3\n", "views[1] has an unknown entry 'angle'"),
        (TWO.replace("b.png", "c.png"), "views[1].file names"),
        (TWO.replace("b.png", ""), "views[1] has no file"),
        (TWO.replace("[1.5, -0.25]", "[1.5]"), "views[1].position must be a pair of numbers"),
        (TWO.replace("[1.5, -0.25]", "[nan, 0]"), "must be a number, not nan"),
        (TWO.replace("[1.5, -0.25]", "[inf, 0]"), "finite pairs"),
        (TWO.replace("[1.5, -0.25]", "[true, 0]"), "must be a number, not True"),
        (TWO.replace("[1.5, -0.25]", "[0, 0]"), "two views have the position row 0, column 0"),
        (TWO.replace("position = [0, 0]\n", ""), "views[0] has no position"),
        (TWO[:42], "lists 1 views"),
        ("reference = 2\n" + TWO, "reference view 2 does not exist"),
        ("reference = 1.5\n" + TWO, "reference must be a whole number"),
        ("grid = [3, 3]\n" + TWO, "positions must be integers in the grid"),
        ("name = 3\n" + TWO, "name must be a text"),
        ("[geometry]\nfocal_length_px = 3\n" + TWO, "geometry has no baseline_m"),
        ("[geometry]\nfocal_length_px = 3\nbaseline_m = -1\n" + TWO, "baseline_m must be a positive number"),
        ('[truth]\ndisparity = "t.pfm"\n' + TWO, "truth must have a file of disparity and the position"),
        ('[source]\npath = "."\nformat = "lightfield-toml"\n', "source must name a path and its format"),
        ('[source]\npath = "."\n', "source must name a path and its format"),
        ('[source]\npath = "no.npy"\nformat = "numpy"\n', "no.npy does not exist"),
        ('[source]\npath = "a.png"\nformat = "numpy"\nflip = 3\n', "source: flip must be u"),
        ("= 3", "is not valid TOML"),
    ],
)
def test_descriptions_that_are_refused(tmp_path: Path, text: str, words: str) -> None:
    found = refusal(lambda: read(describe(tmp_path, text)))
    assert words in found
    assert "lightfield.toml" in found or "no.npy" in found


def test_json_that_is_refused(tmp_path: Path) -> None:
    for text in ("[1", "[" * 100_000, "[]", '{"views": [{"file": "a"}, 3]}', '"\\ud800"', "{" + '"a":{' * 5000):
        (tmp_path / "a.json").write_text(text)
        assert "a.json" in refusal(lambda: read(tmp_path / "a.json"))


# --- what the user says ---


def test_flip_mirrors_the_cameras(tmp_path: Path) -> None:
    save_named(tmp_path, box(2, 3))
    plain, turned = read(tmp_path), read(tmp_path, flip="u")
    np.testing.assert_array_equal(turned.view(0, 0), plain.view(0, 2))
    np.testing.assert_array_equal(turned.view(1, 2), plain.view(1, 0))
    assert turned.reference == turned.index_of(1, 1)
    both = read(tmp_path, flip="uv")
    np.testing.assert_array_equal(both.view(0, 0), plain.view(1, 2))
    assert "flip must be u (columns)" in refusal(lambda: read(tmp_path, flip="x"))


def test_parallax_tells_a_flip(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["npy"].write(true, tmp_path)
    assert [axes_agree(read(path, flip=flip)) for flip in ("", "u", "v", "uv")] == [True, False, False, True]
    assert axes_agree(true.subset("row")) is None
    assert read(path).notes == ()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"grid": (2, 3)}, "has rows and columns in the names of its images; leave grid out"),
        ({"every": 2}, "for which every means nothing"),
        ({"grid": (0, 3)}, "grid must be (rows, columns)"),
        ({"every": 0}, "every must be a whole number of at least 1, not 0."),
        ({"transpose": "no"}, "transpose must be True or False, not 'no'"),
        ({"allow_missing": "no"}, "allow_missing must be True or False, not 'no'"),
        ({"lazy": "no"}, "lazy must be True or False, not 'no'"),
    ],
)
def test_options_that_mean_nothing_are_refused(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    save_named(tmp_path, box(2, 3))
    assert words in refusal(lambda: read(tmp_path, **options))


# --- what a user tries next ---


def test_one_image_of_a_folder_names_the_folder(tmp_path: Path) -> None:
    folder = save_named(tmp_path / "my views", box(2, 2))
    text = refusal(lambda: read(folder / "view_00_01.png"))
    assert f"give the folder {folder}, which is named-views" in text
    save(tmp_path / "alone" / "a.png")
    assert "one image (give the folder that holds the views" in refusal(lambda: read(tmp_path / "alone" / "a.png"))


def test_files_that_are_not_what_their_name_says(tmp_path: Path, true: LightField) -> None:
    """Formats are known by the beginning of a file; archives have to be unpacked."""
    path = SAMPLES["npy"].write(true, tmp_path).rename(tmp_path / "views.dat")
    assert recognise(path)[0].name == "numpy"
    for name in ("a.h5", "a.mat", "a.npz", "a.mp4"):
        (tmp_path / name).write_text("<html>404 Not Found</html>")
        assert "does not begin as such files do" in refusal(lambda name=name: read(tmp_path / name))
        (tmp_path / name).write_bytes(b"")
        assert "an empty file" in refusal(lambda name=name: read(tmp_path / name))
    with zipfile.ZipFile(tmp_path / "lego.zip", "w") as archive:
        archive.writestr("a.png", "x")
    assert "a zip archive (unpack it" in refusal(lambda: read(tmp_path / "lego.zip"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes in the file system here")
def test_pipes_and_links_in_circles(tmp_path: Path, true: LightField) -> None:
    hci = SAMPLES["hci"].write(true, tmp_path)
    for name in ("parameters.cfg", "gt_disp_lowres.pfm"):
        (hci / name).unlink()
        os.mkfifo(hci / name)
    assert read(hci).geometry is None
    os.mkfifo(tmp_path / "pipe")
    assert "neither a file nor a folder" in refusal(lambda: read(tmp_path / "pipe"))
    (tmp_path / "circle").symlink_to("circle")
    assert "cannot be opened" in refusal(lambda: read(tmp_path / "circle"))
    folder = save_named(tmp_path / "views", box(1, 2))
    (folder / "view_00_02.png").symlink_to("gone.png")
    assert "view_00_02.png is a link that leads nowhere" in refusal(lambda: read(folder))
    (folder / "view_00_02.png").unlink()
    (folder / "around").symlink_to(folder)
    assert len(read(folder).views) == 2
