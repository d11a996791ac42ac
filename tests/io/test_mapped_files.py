"""Views that are mapped from a file, which others write meanwhile."""

import os
from pathlib import Path

import numpy as np
import pytest
from samples import refusal

import lfgpu
from lfgpu.data.lightfield import LightField
from lfgpu.io import read
from lfgpu.io.contradictions import contradictions
from lfgpu.methods.measured import exposure_of


@pytest.fixture
def mapped(tmp_path: Path) -> tuple[Path, LightField]:
    path = tmp_path / "a.npy"
    np.save(path, np.random.default_rng(0).integers(0, 255, (3, 3, 64, 64, 3), np.uint8))
    return path, read(path, lazy=True)


def _uses(lf: LightField) -> None:
    lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), device="cpu", max_memory="1GiB")


def test_a_file_that_was_cut_short(mapped: tuple[Path, LightField]) -> None:
    """Reading beyond its end would end the process (SIGBUS)."""
    path, lf = mapped
    os.truncate(path, 4096)
    uses = (lambda lf: lf.image(8), lambda lf: lf.subset([1, 2]), lambda lf: lf.downsampled(2), contradictions)
    for use in (_uses, exposure_of, *uses):
        text = refusal(lambda use=use: use(lf))  # type: ignore[misc]
        assert text == f"{path} was written anew while it was in use; read it again."


def test_a_file_that_was_written_anew(mapped: tuple[Path, LightField]) -> None:
    path, lf = mapped
    content = path.read_bytes()
    path.write_bytes(content[:128] + bytes(len(content) - 128))
    os.utime(path, ns=(1, 1))
    assert "was written anew" in refusal(lambda: lf.image(0))


def test_a_file_that_was_replaced_or_removed_is_still_there(mapped: tuple[Path, LightField]) -> None:
    path, lf = mapped
    before = lf.image(0)
    np.save(path.with_name("b.npy"), np.zeros((2, 2, 8, 8, 3), np.uint8))
    path.with_name("b.npy").replace(path)
    np.testing.assert_array_equal(lf.image(0), before)
    path.unlink()
    np.testing.assert_array_equal(lf.image(0), before)
