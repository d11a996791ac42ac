"""Inputs that nobody thought of: readers give a light field or one sentence, and what is written is read back."""

import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from PIL import Image

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import FORMATS, read, read_map, read_mask, write_description, write_pfm
from lfgpu.io.damage import read_as
from lfgpu.io.images import read_image

if sys.platform == "linux":
    from tests.io import fuzz

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="memory of processes is limited as Linux does it")
EASY = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@contextmanager
def folder() -> Iterator[Path]:
    """A folder for one example: pytest's is that of all examples of a test."""
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def read_or_refused(path: Path, **options: Any) -> LightField | None:
    try:
        return read(path, **options)
    except LightFieldError as error:
        text = str(error)
        assert text.endswith("."), text
        assert "\n" not in text
        return None


# --- damage ---


@pytest.mark.thorough
@ON_LINUX
def test_the_fuzzer_finds_a_broken_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    def one(name: str, source: Path, seed: int, within: Path) -> str:
        if seed == 0:
            os._exit(7)
        return "Traceback" if seed == 1 else "refused"

    monkeypatch.setattr(fuzz, "one", one)
    tally = fuzz.run(600, names=["npy"], processes=3)
    assert sorted(tally.failures) == ["seed 0, npy: the process ended with 7", "seed 1, npy: 'Traceback'"]
    assert tally.summary()["inputs_of_each"] == {"npy": 600}  # what came after a crash is tried, too
    assert tally.refused == 598


def endless() -> None:
    while True:
        pass


def fuzzed(reading: Callable[..., None], monkeypatch: pytest.MonkeyPatch, within: Path) -> str:
    """What the fuzzer says of a reader."""
    (within / "sample").write_bytes(b"1")
    monkeypatch.setitem(fuzz.TARGETS, "slow", SimpleNamespace(read=reading))
    return fuzz.one("slow", within / "sample", 1, within)


@ON_LINUX
@pytest.mark.parametrize("reader", [endless, signal.pause])
def test_the_fuzzer_ends_what_takes_too_long(
    reader: Callable[[], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Also where a reader takes everything for damage."""

    def reading(path: Path, _: object) -> None:
        with read_as(path, "a file"):
            while True:  # a signal that is not for the fuzzer ends a pause, too
                reader()

    seconds = iter(range(1000))
    monkeypatch.setattr(fuzz, "_idle", lambda: 15 * next(seconds) if reader is signal.pause else 0)
    monkeypatch.setattr(fuzz, "SECONDS", 0.2)
    monkeypatch.setattr(fuzz, "_LOOK", 0.01)
    assert "TooLong: more than" in fuzzed(reading, monkeypatch, tmp_path)


@ON_LINUX
def test_the_fuzzer_waits_for_others_that_work_on_its_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    looks: list[int] = []

    def reading(*_: object) -> None:
        while len(looks) < 20:
            signal.pause()

    monkeypatch.setattr(fuzz, "_idle", lambda: looks.append(1) or 0)
    monkeypatch.setattr(fuzz, "_LOOK", 0.001)
    assert fuzzed(reading, monkeypatch, tmp_path) == "read"


BEGINNINGS = [
    b"", b"\x89HDF\r\n\x1a\n", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM", b"MATLAB 7.3 MAT-file".ljust(512),
    b"\x93NUMPY\x01\x00v\x00{", b"PK\x03\x04", b"II*\x00\x08\x00\x00\x00", b"MM\x00*\x00\x00\x00\x08", b"II+\x00",
    b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"RIFF\x00\x00\x00\x00AVI ", b"\x00\x00\x00\x18ftypisom",
    b"Pf\n2 2\n-1\n", b"[[views]]\n", b"{",
]  # fmt: skip
SUFFIXES = ["h5", "mat", "npy", "npz", "tif", "png", "jpg", "bmp", "toml", "json", "txt"]


@EASY
@given(st.sampled_from(BEGINNINGS), st.binary(max_size=400), st.sampled_from(SUFFIXES), st.sampled_from(FORMATS))
def test_any_bytes_are_refused_as_any_format(start: bytes, rest: bytes, suffix: str, entry: Any) -> None:
    with folder() as place:
        file = place / f"light field.{suffix}"
        file.write_bytes(start + rest)
        read_or_refused(file)
        if entry.name != "video":  # a process each; the fuzzer tries them
            read_or_refused(file, format=entry.name)
        for reader in (read_image, read_map, read_mask):
            with suppress(LightFieldError):
                reader(file)


NAMES = st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=12)


@EASY
@given(arrays.arrays(
    st.sampled_from(["u1", "<u2", ">u2", "<f4", ">f4", "<f8", "i4", "f2", "c8", "S3", "?", "M8[s]"]),
    arrays.array_shapes(min_dims=0, max_dims=6, min_side=0, max_side=5),
), st.sampled_from([None, (1, 2), (2, 2)]))  # fmt: skip
def test_any_numpy_array(array: NDArray[Any], grid: tuple[int, int] | None) -> None:
    with folder() as place:
        np.save(place / "a.npy", array)
        found = read_or_refused(place / "a.npy", grid=grid)
        if found is not None:
            np.testing.assert_array_equal(
                found.views.ravel(),
                array.reshape(*found.views.shape[:3], -1)[..., : found.channels].astype(found.views.dtype).ravel(),
            )


# --- round trips ---

LENGTHS = st.floats(1e-6, 1e6)
NUMBERS = st.floats(-1000, 1000).map(lambda number: round(number, 2))


@EASY
@given(
    name=st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
    files=st.lists(NAMES, min_size=2, max_size=4, unique_by=str.casefold),
    places=st.lists(st.tuples(NUMBERS, NUMBERS), min_size=4, max_size=4, unique=True),
    lengths=st.none() | st.tuples(LENGTHS, LENGTHS, LENGTHS | st.just(float("inf"))),
    point=st.none() | st.tuples(NUMBERS, NUMBERS),
    kind=st.sampled_from(["toml", "json"]),
)  # fmt: skip
def test_descriptions_come_back_as_they_were(
    name: str, files: list[str], places: Any, lengths: Any, point: Any, kind: str
) -> None:
    with folder() as place:
        views = np.random.default_rng(0).integers(0, 256, (len(files), 3, 4, 3), np.uint8)
        paths = [place / "views" / f"{file}.png" for file in files]
        (place / "views").mkdir()
        for path, view in zip(paths, views, strict=True):
            Image.fromarray(view).save(path, format="PNG")
        first = LightField(
            views,
            np.array(places[: len(files)]),
            reference=1,
            geometry=None if lengths is None else Geometry(*lengths, principal_point=point),
            truth=GroundTruth(np.full((3, 4), np.float32(0.1)), places[0], np.eye(3, 4, dtype=bool)),
            name=name,
            files=tuple(map(str, paths)),
        )
        (place / "deep").mkdir()
        target = place / "deep" / f"a.{kind}"
        write_description(first, target, source={})
        again = read(target)
        np.testing.assert_array_equal(again.views, views)
        np.testing.assert_array_equal(again.positions, first.positions)
        assert (again.name, again.reference, again.geometry) == (first.name, 1, first.geometry)
        np.testing.assert_array_equal(again.truth.disparity, first.truth.disparity)
        np.testing.assert_array_equal(again.truth.mask, first.truth.mask)
        assert again.truth.position == first.truth.position


@EASY
@given(arrays.arrays(np.float32, arrays.array_shapes(min_dims=2, max_dims=2, max_side=6)))
def test_maps_come_back_bit_for_bit(values: NDArray[np.float32]) -> None:
    with folder() as place:
        write_pfm(place / "a.pfm", values)
        np.savez(place / "a.npz", disparity=values)
        for name in ("a.pfm", "a.npz"):
            np.testing.assert_array_equal(read_map(place / name), values)
