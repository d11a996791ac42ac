"""Views of 10 or 12 bits in files of 16 give the map of 8 bits, and a note says so."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.io import read, write_hci
from lfgpu.metrics import evaluate


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_views_of_few_bits_are_as_bright_as_they_are(tmp_path: Path, bits: int) -> None:
    true = scenes.make("boxes", grid=(3, 3), size=(40, 48))
    dark = np.rint(true.views / 255 * ((1 << bits) - 1)).astype(np.uint16)
    write_hci(replace(true, views=dark), tmp_path / "dark")
    found = read(tmp_path / "dark")
    np.testing.assert_array_equal(found.views, dark)
    assert found.white == (1 << bits) - 1
    assert any(f"taken for {bits} bits" in note for note in found.notes)
    np.testing.assert_allclose(found.image(0), true.image(0), atol=0.003)
    np.testing.assert_allclose(found.downsampled(2).image(0), true.downsampled(2).image(0), atol=0.003)
    maps = [
        lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), backend="reference").disparity
        for lf in (true, found)
    ] if bits == 10 else []  # fmt: skip
    if maps:
        assert true.truth is not None
        first, second = (evaluate(values, true.truth.disparity, border=2) for values in maps)
        assert second.badpix_07 <= first.badpix_07 + 1


def test_views_of_sixteen_bits_stay(tmp_path: Path) -> None:
    true = scenes.make("boxes", grid=(3, 3), size=(40, 48))
    write_hci(replace(true, views=true.views.astype(np.uint16) * 257), tmp_path / "a")
    found = read(tmp_path / "a")
    assert (found.white, found.notes) == (None, ())
    write_hci(replace(true, views=np.zeros_like(found.views)), tmp_path / "b")
    assert read(tmp_path / "b").white is None


def test_white_is_a_number() -> None:
    true = scenes.make("boxes", grid=(3, 3), size=(40, 48))
    with pytest.raises(lfgpu.LightFieldError, match="white must be"):
        replace(true, white=0)


def test_escape_sequences_in_names_do_not_reach_the_terminal(tmp_path: Path) -> None:
    folder = tmp_path / "a\x1b]0;owned\x07\x1b[2J"
    write_hci(scenes.make("boxes", grid=(3, 3), size=(40, 48)), folder)
    (folder / "b\x1b[2J.png").write_bytes(b"none")
    for command in (["info", str(folder)], ["info", str(folder / "nothing")], ["info", str(folder / "b\x1b[2J.png")]):
        done = CliRunner().invoke(app, command)
        assert "\x1b" not in done.output
        assert "\x07" not in done.output
        assert r"\x1b[2J" in done.output
