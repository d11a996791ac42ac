"""`lfgpu decode`, and `depth` and `info` straight from a raw capture."""

import re
from pathlib import Path

import numpy as np
import pytest
from lenslet_samples import Camera, capture, eight_bit
from PIL import Image
from typer.testing import CliRunner, Result

from lfgpu.cli import app
from lfgpu.io import read, read_map
from lfgpu.scenes import make


def lfgpu(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raw capture and its white image beside it."""
    folder = tmp_path_factory.mktemp("capture")
    sample = capture(make("planes", grid=(9, 9), size=(50, 54), disparity_range=(-0.6, 0.6)), Camera(size=(360, 390)))
    Image.fromarray(eight_bit(sample.white)).save(folder / "white.png")
    Image.fromarray(eight_bit(sample.raw)).save(folder / "raw.png")
    return folder / "raw.png"


def test_decode_writes_what_is_read_again(raw: Path, tmp_path: Path) -> None:
    outcome = lfgpu("decode", raw, "-o", tmp_path / "views", "--white", raw.with_name("white.png"), "--views", 5)
    assert outcome.exit_code == 0, outcome.stderr
    said = " ".join(outcome.stdout.split())
    for words in ("25 of 25 in a 5 x 5 grid", "grey picture, uint8", "bggr", "grid and vignetting from white.png"):
        assert words in said
    assert len(list((tmp_path / "views").iterdir())) == 26
    assert read(tmp_path / "views").views.dtype == np.uint16


def test_depth_and_info_take_the_raw_file(raw: Path, tmp_path: Path) -> None:
    said = " ".join(lfgpu("info", raw).stdout.split())
    assert "lenslet, because it is a grey picture of microlenses, a hexagonal lattice 9." in said
    outcome = lfgpu("depth", raw, "-o", tmp_path / "out", "--preset", "fast", "--disparity-range=-1,1")
    assert outcome.exit_code == 0, outcome.stderr
    assert read_map(tmp_path / "out" / "disparity.pfm").shape == read(raw).size


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--bayer", "rgbg"], "the Bayer pattern must be one of"),
        (["--views", "1"], "the number of views must be 2 to 31"),
        (["--white", "nowhere.png"], "nowhere.png does not exist"),
    ],
)
def test_what_is_refused_leaves_nothing(options: list[str], words: str, raw: Path, tmp_path: Path) -> None:
    outcome = lfgpu("decode", raw, "-o", tmp_path / "views", *options)
    assert outcome.exit_code == 1
    assert re.fullmatch(r"lfgpu: [^\n]*\.\n", outcome.stderr)
    assert words in outcome.stderr
    assert not (tmp_path / "views").exists()


def test_what_is_no_file_is_said(tmp_path: Path) -> None:
    for path, words in ((tmp_path / "nowhere.lfp", "does not exist"), (tmp_path, "is not a raw capture")):
        outcome = lfgpu("decode", path, "-o", tmp_path / "views")
        assert outcome.exit_code == 1
        assert words in outcome.stderr
