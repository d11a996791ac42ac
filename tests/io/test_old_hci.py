"""The old HCI formats: HDF5 and exports; how columns are counted, depth, and what is refused."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fields import SAMPLES, scene
from samples import box, refusal, save_named

from lfgpu.data.lightfield import LightField
from lfgpu.io import read, recognise


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


def damaged_hdf5(file: Any, kind: str) -> None:
    if kind == "no LF":
        del file["LF"]
    elif kind == "text":
        del file["LF"]
        file["LF"] = "hello"
    elif kind == "huge":
        del file["LF"]
        file.create_dataset("LF", (9, 9, 40000, 40000, 3), np.uint8, chunks=(1, 1, 100, 100, 3))
    elif kind == "depth":
        del file["GT_DEPTH"]
        file["GT_DEPTH"] = np.ones((3, 4))
    elif kind == "attribute":
        file.attrs["dH"] = "wide"
    elif kind == "negative":
        file.attrs["focalLength"] = -3.0
    elif kind == "anisotropic":
        file.attrs["dV"] = 1.0
    elif kind == "link":
        import h5py

        del file["LF"]
        file["LF"] = h5py.ExternalLink("/etc/other.h5", "/LF")
    elif kind == "outside":
        del file["LF"]
        file.create_dataset("LF", (2, 2, 4, 5, 3), np.uint8, external=[("/etc/hostname", 0, 10_000)])


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("no LF", "has no dataset LF; it holds GT_DEPTH"),
        ("text", "wanted is an array of numbers"),
        ("huge", "is damaged: it claims"),
        ("depth", "has shape (3, 4), which does not fit"),
        ("attribute", "the attribute dH must be a number"),
        ("negative", "must be positive"),
        ("anisotropic", "describe them in a lightfield.toml"),
        ("link", "has no dataset LF"),
        ("outside", "lies in other files"),
    ],
)
def test_hdf5_that_is_refused(tmp_path: Path, true: LightField, kind: str, words: str) -> None:
    import h5py

    path = SAMPLES["hci-hdf5"].write(true, tmp_path)
    with h5py.File(path, "r+") as file:
        damaged_hdf5(file, kind)
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


def test_views_are_not_passed_over_for_an_hdf5_file_beside_them(tmp_path: Path, true: LightField) -> None:
    SAMPLES["hci-hdf5"].write(true, save_named(tmp_path, box(2, 2)))
    assert recognise(tmp_path)[0].name == "named-views"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes in the file system here")
def test_pipes_among_the_files_of_a_format_are_not_waited_for(tmp_path: Path, true: LightField) -> None:
    folder = SAMPLES["hci"].write(true, tmp_path)
    for name in ("parameters.cfg", "gt_disp_lowres.pfm"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    assert read(folder).geometry is None
