"""All views in one file: mosaics, MATLAB, NumPy and TIFF."""

import subprocess
import sys
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fields import SAMPLES, scene
from numpy.typing import NDArray
from PIL import Image
from samples import HEIGHT, WIDTH, grid_of, picture, refusal
from scipy import sparse
from scipy.io import loadmat, savemat

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import matlab5, read

# --- mosaics ---


@pytest.mark.parametrize("grid", [(5, 5), (7, 9)])
def test_the_block_of_a_mosaic_is_found(tmp_path: Path, grid: tuple[int, int]) -> None:
    true = scene(grid, (40, 48))
    path = SAMPLES["mosaic"].write(true, tmp_path)
    found = read(path)
    assert found.grid_shape == grid
    np.testing.assert_array_equal(found.view(0, 1), true.view(0, 1))
    assert f"a block of {grid[0]} x {grid[1]} pixels" in found.notes[0]


def test_eslf_of_stanford_has_14_x_14_views_and_dark_corners(tmp_path: Path) -> None:
    true = scene((14, 14), (36, 36))
    distance = np.hypot(*(true.positions - 6.5).T)
    views = np.where((distance < 8)[:, None, None, None], true.views, true.views // 50).astype(np.uint8)
    path = SAMPLES["mosaic"].write(replace(true, views=views), tmp_path)
    found = read(path)
    assert found.grid_shape == (14, 14)
    assert len(found.views) == (distance < 8).sum()
    np.testing.assert_allclose(np.hypot(*(found.positions - 6.5).T).max(), distance[distance < 8].max())
    assert any("recorded nothing of use" in note for note in found.notes)


def test_transparent_pixels_of_a_mosaic_are_masked_in_their_views(tmp_path: Path) -> None:
    path = SAMPLES["mosaic"].write(scene((5, 5), (40, 48)), tmp_path)
    image = Image.open(path).convert("RGBA")
    image.putpixel((5 * 30 + 4, 5 * 20 + 1), (0, 0, 0, 0))  # of the view in row 1, column 4
    image.save(path)
    found = read(path)
    assert found.valid is not None
    assert np.argwhere(~found.valid[found.index_of(1, 4)]).tolist() == [[20, 30]]


def test_pictures_are_no_mosaics(tmp_path: Path, true: LightField) -> None:
    Image.fromarray(np.kron(true.views[0], np.ones((4, 4, 1), np.uint8))[:150, :187]).save(tmp_path / "a.png")
    assert "no block of pixels repeats" in refusal(lambda: read(tmp_path / "a.png", format="mosaic"))
    text = refusal(lambda: read(tmp_path / "a.png", format="mosaic", grid=(100, 3)))
    assert "187 x 150 pixels; they do not hold 100 x 3 views" in text
    found = read(tmp_path / "a.png", format="mosaic", grid=(4, 4))
    assert any("do not fill a block" in note for note in found.notes)


# --- MATLAB, NumPy, TIFF ---


def test_weights_of_the_light_field_toolbox(tmp_path: Path, true: LightField) -> None:
    grid = grid_of(true).astype(np.uint16) * 257
    weight = np.full((*grid.shape[:4], 1), 65535, np.uint16)
    weight[0, 1, :, :8] = 100
    weight[4, 4] = 0
    savemat(tmp_path / "a.mat", {"LF": np.concatenate([grid, weight], axis=4)})
    found = read(tmp_path / "a.mat")
    assert (len(found.views), found.missing, found.views.dtype) == (24, ((4, 4),), np.uint16)
    assert not found.valid[found.index_of(0, 1), :, :8].any()
    assert found.valid[found.index_of(0, 1), :, 8:].all()
    np.testing.assert_array_equal(found.view(0, 1), grid[0, 1])


def without_a_middle() -> np.ndarray:
    """Views with weights, of which that of the middle view is 0."""
    views = np.ones((2, 2, 4, 5, 4))
    views[1, 1, :, :, 3] = 0
    return views


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"x": np.zeros((2, 2))}, "no variable LF [t, s, v, u, c] of 1 to 4 colours; it holds x (2, 2)"),
        ({"LF": np.zeros((2, 2, 4, 5, 3), np.int32)}, "LF holds int32"),
        ({"LF": without_a_middle()}, "nothing of the middle view is valid"),
        ({"LF": np.full((2, 2, 4, 5, 3), np.nan)}, "NaN or infinite"),
        ({"LF": np.full((2, 2, 4, 5, 3), 200.0)}, "scale float views to [0, 1]"),
    ],
)
def test_matlab_files_that_are_refused(tmp_path: Path, variables: dict[str, Any], words: str) -> None:
    savemat(tmp_path / "a.mat", variables)
    text = refusal(lambda: read(tmp_path / "a.mat"))
    assert words in text
    assert "a.mat" in text


def test_numpy_arrays_of_all_arrangements(tmp_path: Path) -> None:
    grid = np.stack([picture(index) for index in range(6)]).reshape(2, 3, HEIGHT, WIDTH, 3)
    for array, shape, options in (
        (grid, (2, 3), {}),
        (grid[..., 0], (2, 3), {"axes": "vuyx"}),
        (grid.reshape(6, HEIGHT, WIDTH, 3), (2, 3), {"grid": (2, 3)}),
        (grid.reshape(6, HEIGHT, WIDTH, 3)[..., 0], (3, 2), {"grid": (3, 2)}),
        (grid.reshape(6, HEIGHT, WIDTH, 3)[:4], (2, 2), {}),
        (grid.astype(">u2"), (2, 3), {}),
        (grid.astype(np.float64) / 255, (2, 3), {}),
    ):
        np.save(tmp_path / "a.npy", array)
        found = read(tmp_path / "a.npy", **options)  # type: ignore[arg-type]
        assert found.grid_shape == shape
        assert found.views.dtype.isnative
    assert "Float64 values rounded to float32." in found.notes
    np.save(tmp_path / "a.npy", grid.reshape(6, HEIGHT, WIDTH, 3))
    assert "6 views in one row of files or pages; say how they stand" in refusal(lambda: read(tmp_path / "a.npy"))
    assert "not a grid of 2 x 2" in refusal(lambda: read(tmp_path / "a.npy", grid=(2, 2)))
    np.save(tmp_path / "a.npy", grid)
    assert "has a grid of 2 x 3 views" in refusal(lambda: read(tmp_path / "a.npy", grid=(3, 2)))


def test_numpy_files_that_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{}], object), allow_pickle=True)
    assert "holds Python objects" in refusal(lambda: read(tmp_path / "a.npy"))
    for array, words in (
        (np.zeros((3, 3), np.uint8), "views must be [v, u, y, x, c]"),
        (np.zeros((2, 2, 4, 5, 3), np.int64), "int64 values"),
        (np.full((2, 2, 4, 5, 3), np.inf), "NaN or infinite"),
        (np.full((4, 40, 50, 3), [np.inf, -np.inf, 1]), "NaN or infinite"),  # of which a mean is not defined
        (np.zeros((2, 2, 4, 5, 3), [("a", "u1")]), "holds records"),
    ):
        np.save(tmp_path / "a.npy", array)
        assert words in refusal(lambda: read(tmp_path / "a.npy"))
    np.savez(tmp_path / "b.npz", pictures=np.zeros((2, 2, 4, 5, 3)))
    assert "no array 'views'; it holds pictures" in refusal(lambda: read(tmp_path / "b.npz"))


def npy_claiming(shape: tuple[int, ...]) -> bytes:
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(100)


def test_claims_that_would_exhaust_memory_are_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(npy_claiming((9, 9, 100_000, 100_000, 3)))
    assert "which a file of 228 bytes cannot hold" in refusal(lambda: read(tmp_path / "a.npy"))
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("views.npy", npy_claiming((9, 9, 100_000, 100_000, 3)))
    assert "cannot hold" in refusal(lambda: read(tmp_path / "b.npz"))
    with (tmp_path / "a.npy").open("r+b") as file:
        file.truncate(1 << 40)  # a sparse file: the claim fits, the machine does not have it
    assert "does not fit into memory" in refusal(lambda: read(tmp_path / "a.npy"))


def test_tiff_stacks(tmp_path: Path, true: LightField) -> None:
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, grid_of(true), photometric="rgb")  # with its shape in the description
    assert read(path).grid_shape == (5, 5)
    six = np.stack([picture(index, 1)[..., 0] for index in range(6)])
    tifffile.imwrite(path, six, imagej=True)
    assert "say how they stand" in refusal(lambda: read(path))
    found = read(path, grid=(2, 3))
    np.testing.assert_array_equal(found.views[..., 0], six)
    tifffile.imwrite(path, np.moveaxis(true.views, 3, 1), photometric="rgb", planarconfig="separate", metadata=None)
    np.testing.assert_array_equal(read(path).views, true.views)
    with tifffile.TiffWriter(path) as writer:
        writer.write(six[0])
        writer.write(six[1, :3])
    assert "pages that are not alike" in refusal(lambda: read(path))
    tifffile.imwrite(path, true.views, photometric="rgb", metadata=None)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert str(path) in refusal(lambda: read(path, format="tiff-stack"))


def test_pages_of_a_tiff_in_a_circle_come_to_an_end(tmp_path: Path, true: LightField) -> None:
    """In a process of its own, which may not come to an end."""
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "circle.tif"
    views = true.views[:9, :8, :8]
    tifffile.imwrite(path, views, photometric="rgb", imagej=True)
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        offsets, order = [page.offset for page in file.pages], {">": "big", "<": "little"}[file.byteorder]
    link = offsets[4] + 2 + 12 * int.from_bytes(data[offsets[4] : offsets[4] + 2], order)
    data[link : link + 4] = offsets[2].to_bytes(4, order)
    path.write_bytes(data)
    for told in ([], ["--format=tiff-stack", "--grid=3x3"]):
        command = [sys.executable, "-m", "lfgpu", "info", str(path), *told]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
        assert done.returncode == 1, done
        assert "Traceback" not in done.stderr
    assert "linked in a circle" in refusal(lambda: read(path))


_SHAPE = (3, 3, 6, 5, 3)


def grid(dtype: Any, rng: np.random.Generator) -> NDArray[Any]:
    values = rng.random(_SHAPE)
    return values.astype(dtype) if np.dtype(dtype).kind == "f" else (values * np.iinfo(dtype).max).astype(dtype)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_numbers_are_those_that_scipy_reads(tmp_path: Path, rng: np.random.Generator, dtype: Any, packed: bool) -> None:
    file = tmp_path / "a.mat"
    kinds = {"text": "text", "info": "a struct", "flag": "logical", "wave": "complex numbers", "whole": "int64"}
    beside = {
        "text": "words",
        "cells": np.array([1, "a"], object),
        "info": {"a": 1, "b": {"c": np.ones(3)}},
        "thin": sparse.eye(4).tocsc(),
        "flag": np.ones((2, 2), bool),
        "wave": np.ones((2, 2)) + 1j,
        "none": np.zeros((0, 0)),
        "whole": np.arange(12, dtype=np.int64).reshape(3, 4),
    }
    savemat(file, {**beside, "LF": grid(dtype, rng), "after": 1.0}, do_compression=packed, long_field_names=True)
    found = {variable.name: variable for variable in matlab5.variables(file)}
    assert set(found) == {*beside, "LF", "after"}
    assert {name: found[name].kind for name in kinds} == kinds
    loaded = matlab5.load(file, found["LF"])
    assert loaded.dtype == dtype
    np.testing.assert_array_equal(loaded, loadmat(file)["LF"])
    for name in set(beside) - {"none"}:
        assert f"{name} holds" in refusal(lambda name=name: matlab5.load(file, found[name]))


def element(kind: int, data: bytes, order: str = "<") -> bytes:
    return np.array([kind, len(data)], f"{order}u4").tobytes() + data + b"\0" * (-len(data) % 8)


def made(
    stored: NDArray[Any], *, kind: int, number: int, name: bytes = b"LF", shape: Any = _SHAPE, order: str = "<"
) -> bytes:
    """A file by hand: `stored` as type `kind` of a variable of class `number`."""
    flags = np.array([number, 0], f"{order}u4").tobytes()
    short = np.array([len(name) << 16 | 1], f"{order}u4").tobytes() + name.ljust(4, b"\0")
    data = stored.astype(stored.dtype.newbyteorder(order)).tobytes(order="F")
    inside = element(6, flags, order) + element(5, np.array(shape, f"{order}i4").tobytes(), order) + short
    version = b"\0\1IM" if order == "<" else b"\1\0MI"
    return b"MATLAB 5.0 MAT-file".ljust(124) + version + element(14, inside + element(kind, data, order), order)


@pytest.mark.parametrize("order", ["<", ">"])
def test_numbers_that_are_stored_in_fewer_bytes(tmp_path: Path, rng: np.random.Generator, order: str) -> None:
    stored = grid(np.uint8, rng)
    (tmp_path / "a.mat").write_bytes(made(stored, kind=2, number=11, order=order))
    views = read(tmp_path / "a.mat").views
    assert views.dtype == np.uint16
    np.testing.assert_array_equal(views.reshape(_SHAPE), stored)
    (tmp_path / "b.mat").write_bytes(made(stored, kind=2, number=6, order=order))
    assert read(tmp_path / "b.mat").views.dtype == np.uint8  # whole doubles
    (tmp_path / "c.mat").write_bytes(made(grid(np.uint16, rng), kind=4, number=9, order=order))
    assert "is uint8, but stored as uint16" in refusal(lambda: read(tmp_path / "c.mat"))


def test_types_that_do_not_exist_do_not_end_the_process(tmp_path: Path, rng: np.random.Generator) -> None:
    """In a process of its own, which may die."""
    files = []
    for kind in (0, 8, 20, 200, 70_000, 0xFFFFFFFF):
        files.append(tmp_path / f"{kind}.mat")
        files[-1].write_bytes(made(grid(np.uint8, rng), kind=kind, number=9))
    run = """
import sys
from lfgpu import LightFieldError, read
for name in sys.argv[1:]:
    try:
        read(name)
    except LightFieldError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", run, *map(str, files)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done
    assert done.stdout.count("damaged") == len(files)


def test_little_data_cannot_become_much(tmp_path: Path) -> None:
    bomb = zlib.compress(made(np.zeros((1,), np.uint8), kind=2, number=9)[128:-16] + element(2, bytes(1 << 26)), 9)
    header = made(np.zeros((1,), np.uint8), kind=2, number=9)[:128]
    (tmp_path / "a.mat").write_bytes(header + np.array([15, len(bomb)], "<u4").tobytes() + bomb)
    assert "claims 810 numbers in 67108864 bytes" in refusal(lambda: read(tmp_path / "a.mat"))


def test_any_damage_is_no_other_error(tmp_path: Path, rng: np.random.Generator) -> None:
    file = tmp_path / "a.mat"
    savemat(file, {"info": {"a": 1}, "LF": grid(np.uint8, rng)})
    sound, sentences = file.read_bytes(), list[str]()
    for _ in range(300):
        data = bytearray(sound[: int(rng.integers(1, len(sound) + 1))] if rng.random() < 0.3 else sound)
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(min(len(data), 400)))
            data[at] = int(rng.integers(256))
        file.write_bytes(data)
        try:
            for variable in matlab5.variables(file):
                matlab5.load(file, variable)
        except LightFieldError as error:
            sentences.append(str(error))
    assert sentences, "nothing was damaged"
    assert [sentence for sentence in sentences if str(file) not in sentence] == []


def test_what_a_variable_lf_may_be_instead_of_an_array(tmp_path: Path) -> None:
    views = np.zeros((3, 3, 8, 9, 3), np.uint8)
    savemat(tmp_path / "a.mat", {"LF": {"data": views}})
    assert "LF is a struct, not an array; in MATLAB, save the array in it" in refusal(lambda: read(tmp_path / "a.mat"))
    savemat(tmp_path / "b.mat", {"LF": views[..., 0]})
    assert "say which, with --axes vuyx for grey views" in refusal(lambda: read(tmp_path / "b.mat"))
    assert read(tmp_path / "b.mat", axes="vuyx").grid_shape == (3, 3)
    savemat(tmp_path / "c.mat", {"LF": np.zeros((20, 24, 3, 4, 3), np.uint8)})
    assert "--axes yxvuc" in refusal(lambda: read(tmp_path / "c.mat"))
    assert read(tmp_path / "c.mat", axes="yxvuc").grid_shape == (3, 4)
