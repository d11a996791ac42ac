"""Maps, masks and clouds from and to files; views that are mapped from a file, and views of few bits."""

import os
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from samples import refusal, save
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.data import LightField
from lfgpu.io import read, read_map, read_mask, write_hci, write_pfm
from lfgpu.io.contradictions import contradictions
from lfgpu.methods.measured import exposure_of
from lfgpu.metrics import evaluate

MAP = np.random.default_rng(5).normal(size=(3, 7)).astype(np.float32)


def test_pfm_round_trip_and_imageio_agrees(tmp_path: Path) -> None:
    values = MAP.copy()
    values[1, 2:4] = np.nan, np.inf
    write_pfm(tmp_path / "a.PFM", values)
    np.testing.assert_array_equal(read_map(tmp_path / "a.PFM"), values)
    (tmp_path / "a.PFM").rename(tmp_path / "a.pfm")
    np.testing.assert_array_equal(iio.imread(tmp_path / "a.pfm", plugin="pillow"), values)
    iio.imwrite(tmp_path / "b.pfm", MAP, plugin="pillow")
    np.testing.assert_array_equal(read_map(tmp_path / "b.pfm"), MAP)


def test_pfm_is_stored_bottom_up_and_little_endian(tmp_path: Path) -> None:
    write_pfm(tmp_path / "a.pfm", [[1, 2], [3, 4]])
    assert (tmp_path / "a.pfm").read_bytes() == b"Pf\n2 2\n-1.0\n" + struct.pack("<4f", 3, 4, 1, 2)


@pytest.mark.parametrize("header", [b"Pf\n2 1\n1.0\n", b"Pf 2 1 1\n", b"Pf\r\n2 1\r\n1.0\r\n", b"Pf\n2\n1\n+1e0\n"])
def test_pfm_headers_of_other_writers(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "a.pfm").write_bytes(header + struct.pack(">2f", 1.5, -2.5))  # a positive scale is big endian
    np.testing.assert_array_equal(read_map(tmp_path / "a.pfm"), [[1.5, -2.5]])


def test_maps_from_numpy_and_tiff(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", MAP.astype(np.float64))
    np.savez(tmp_path / "a.npz", disparity=MAP, other=np.zeros(3))
    Image.fromarray(MAP).save(tmp_path / "a.tif")
    for name in ("a.npy", "a.npz", "a.tif"):
        found = read_map(tmp_path / name)
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, MAP)


def test_what_is_no_map_is_refused(tmp_path: Path) -> None:
    data = struct.pack("<6f", *range(6))
    np.save(tmp_path / "line.npy", np.zeros(4))
    np.save(tmp_path / "pickle.npy", np.array([{}], object), allow_pickle=True)
    np.save(tmp_path / "complex.npy", np.zeros((2, 2), complex))
    np.savez(tmp_path / "keys.npz", depth=MAP)
    save(tmp_path / "colour.tif")
    (tmp_path / "folder.npy").mkdir()
    for name, content, words in (
        ("colour.pfm", b"PF\n2 1\n-1.0\n" + data, "colour PFM"),
        ("dots.pfm", b"Pf\n2 1\n-..0\n" + data, "does not begin with"),
        ("short.pfm", b"Pf\n3 3\n-1.0\n" + data, "damaged: 3 x 3 float32 values are 36 bytes, it has 24"),
        ("long.pfm", b"Pf\n2 1\n-1.0\n" + data, "damaged"),
        ("empty.pfm", b"", "not a PFM"),
        ("text.pfm", b"hello", "not a PFM"),
        ("zero.pfm", b"Pf\n2 1\n-0.0\n" + bytes(8), "has the scale 0, whose sign cannot tell"),
        ("zeros.pfm", b"Pf\n2 1\n0e5\n" + bytes(8), "has the scale 0, whose sign cannot tell"),
        ("line.npy", None, "shape (4,)"),
        ("pickle.npy", None, "cannot be read as NumPy data"),
        ("complex.npy", None, "complex128"),
        (
            "short.npy",
            (tmp_path / "line.npy").read_bytes()[:-8],
            "cannot be read as NumPy data: it ends too early; copy it again",
        ),
        ("keys.npz", None, "no array 'disparity'; it holds depth"),
        ("broken.npz", (tmp_path / "keys.npz").read_bytes()[:100], "cannot be read as NumPy data: it ends too early"),
        ("colour.tif", None, "colour image"),
        ("map.exr", b"", "not an OpenEXR file"),
        ("map.jpg", None, "known are .pfm, .npz, .png, .tif, .exr, .npy"),
        ("map.ply", None, "known are .pfm, .npz, .png, .tif, .exr, .npy"),
        ("folder.npy", None, "cannot be read: Is a directory"),
        ("missing.pfm", None, "cannot be read: No such file"),
        ("missing.tif", None, "No such file"),
        ("missing", None, "does not exist; give a map, or a folder that lfgpu depth wrote."),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        text = refusal(lambda name=name: read_map(tmp_path / name))
        assert str(tmp_path / name) in text
        assert words in text, text


def test_masks(tmp_path: Path) -> None:
    mask = np.array([[0, 1, 255], [0, 0, 7]], np.uint8)
    save(tmp_path / "grey.png", mask[..., None])
    save(tmp_path / "colour.png", mask[..., None] * np.array([0, 1, 0], np.uint8))
    for name in ("grey.png", "colour.png"):
        found = read_mask(tmp_path / name)
        assert found.dtype == np.bool_
        np.testing.assert_array_equal(found, mask > 0)
    assert "none.png" in refusal(lambda: read_mask(tmp_path / "none.png"))


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((2, 2, 1)), np.zeros((0, 2))])
def test_only_maps_become_pfm(tmp_path: Path, values: NDArray[Any]) -> None:
    text = refusal(lambda: write_pfm(tmp_path / "a.pfm", values))
    assert "a.pfm" in text
    assert str(values.shape) in text


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
    if bits == 10:
        options = {"config": "fast", "disparity_range": (-2, 2), "device": "cpu"}
        first, second = (
            evaluate(lfgpu.estimate_depth(lf, **options).disparity, true.truth.disparity, border=2)
            for lf in (true, found)
        )
        assert second.badpix_07 <= first.badpix_07 + 1


def test_views_of_sixteen_bits_stay(tmp_path: Path) -> None:
    true = scenes.make("boxes", grid=(3, 3), size=(40, 48))
    write_hci(replace(true, views=true.views.astype(np.uint16) * 257), tmp_path / "a")
    found = read(tmp_path / "a")
    assert (found.white, found.notes) == (None, ())
    write_hci(replace(true, views=np.zeros_like(found.views)), tmp_path / "b")
    assert read(tmp_path / "b").white is None
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


def test_nor_do_those_in_names_of_outputs(tmp_path: Path) -> None:
    write_pfm(tmp_path / "map.pfm", np.zeros((20, 24), np.float32))
    out = tmp_path / "a\x1b]0;owned\x07\u202e.png"
    for command in (["convert", str(tmp_path / "map.pfm")], ["scene", "boxes", "--grid", "3x3", "--size", "40x48"]):
        done = CliRunner().invoke(app, [*command, "-o", str(out)])
        assert done.exit_code == 0, done.output
        assert r"a\x1b]0;owned\x07\u202e" in done.output
        out = out.with_suffix("")
