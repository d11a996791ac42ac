"""MATLAB files of version 5 to 7: the numbers that SciPy reads from sound ones, and a sentence about damaged ones."""

import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from samples import refusal
from scipy import sparse
from scipy.io import loadmat, savemat

from lfgpu.errors import LightFieldError
from lfgpu.io import matlab5, read

_SHAPE = (3, 3, 6, 5, 3)


def grid(dtype: Any, rng: np.random.Generator) -> NDArray[Any]:
    values = rng.random(_SHAPE)
    return values.astype(dtype) if np.dtype(dtype).kind == "f" else (values * np.iinfo(dtype).max).astype(dtype)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_numbers_are_those_that_scipy_reads(tmp_path: Path, rng: np.random.Generator, dtype: Any, packed: bool) -> None:
    file = tmp_path / "a.mat"
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
    assert {name: found[name].kind for name in ("text", "info", "flag", "wave", "whole")} == {
        "text": "text",
        "info": "a struct",
        "flag": "logical",
        "wave": "complex numbers",
        "whole": "int64",
    }
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


@pytest.mark.parametrize("kind", [0, 8, 20, 200, 70_000, 0xFFFFFFFF])
def test_types_that_do_not_exist_do_not_end_the_process(tmp_path: Path, rng: np.random.Generator, kind: int) -> None:
    """In a process of its own, which may die."""
    (tmp_path / "a.mat").write_bytes(made(grid(np.uint8, rng), kind=kind, number=9))
    done = subprocess.run(
        [sys.executable, "-m", "lfgpu", "info", str(tmp_path / "a.mat")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done
    assert "damaged" in done.stderr
    assert "Traceback" not in done.stderr


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
