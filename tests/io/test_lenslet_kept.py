"""Decoded captures in the cache of the user: made once, the same when they are read again, never in the way."""

from pathlib import Path

import numpy as np
import pytest

from lfgpu.data.lightfield import LightField
from lfgpu.io.lenslet import entry as module
from lfgpu.io.lenslet.entry import folder, kept

made: list[str] = []


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "folder", folder)  # as it is for users
    made.clear()
    return tmp_path / "cache"


def make() -> LightField:
    made.append("")
    views = np.random.default_rng(1).integers(0, 65535, (4, 6, 7, 3), dtype=np.uint16)
    valid = np.random.default_rng(2).random((4, 6, 7)) > 0.2
    places = [[0, 0], [1, 0], [0, 1], [1, 1]]
    return LightField(views, places, reference=3, grid_shape=(2, 2), valid=valid, name="raw", notes=("Green is at 0.",))


def test_it_is_made_once_and_the_same_when_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "raw.lfr").write_bytes(b"one")
    first, second = (kept(tmp_path / "raw.lfr", make) for _ in range(2))
    assert len(made) == 1
    for name in ("views", "positions", "valid"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))
    assert (second.reference_index, second.grid_shape, second.name, second.notes) == (3, (2, 2), "raw", first.notes)
    (tmp_path / "raw.lfr").write_bytes(b"two")
    kept(tmp_path / "raw.lfr", make)
    assert len(made) == 2


def test_what_cannot_be_kept_or_read_is_made(tmp_path: Path, cache: Path) -> None:
    (tmp_path / "raw.lfr").write_bytes(b"one")
    kept(tmp_path / "raw.lfr", make)
    (file,) = folder().glob("*.npz")
    file.write_bytes(file.read_bytes()[:100])
    kept(tmp_path / "raw.lfr", make)
    kept(tmp_path / "raw.lfr", make)
    assert len(made) == 2
    cache.rename(tmp_path / "gone")
    cache.write_text("no folder")
    assert kept(tmp_path / "raw.lfr", make).name == "raw"


def test_there_is_an_end_of_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_ROOM", 3000)
    for number in range(4):
        (tmp_path / "raw.lfr").write_bytes(bytes([number]))
        kept(tmp_path / "raw.lfr", make)
    assert 1 <= len(list(folder().glob("*.npz"))) < 4
