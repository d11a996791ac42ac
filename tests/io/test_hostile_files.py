"""Files that were made to do harm: to leave themselves, to take time or memory, to reach the terminal."""

import json
import os
import re
import struct
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from samples import picture, refusal, save, save_hci

from lfgpu.data import DisparityMap, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import load, read, read_map, video
from lfgpu.io.frames import write_frames
from lfgpu.printable import printable
from tests.made import thorough

_SPACE = 3 << 30  # bytes of addresses that a process may have: what is judged first never comes near


def in_little_memory(code: str, *arguments: Path | str) -> str:
    """What code writes that runs in a process of its own with little memory; LightFieldErrors are written, too."""
    program = (
        "import resource, sys, lfgpu, pathlib\n"
        f"resource.setrlimit(resource.RLIMIT_AS, ({_SPACE}, {_SPACE}))\n"
        f"try:\n    {code}\nexcept lfgpu.LightFieldError as error:\n    print('refused:', error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_tests_that_the_promises_name_are_there() -> None:
    root = Path(__file__).parents[2]
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", (root / "SECURITY.md").read_text(encoding="utf-8"))
    assert len(named) > 40
    for file, test in named:
        assert f"def {test}(" in (root / file).read_text(encoding="utf-8") or not test, test


# --- descriptions ---


def described(folder: Path, first: str = "", position: str = "[1.0, 0.0]", suffix: str = "toml") -> Path:
    """A description of two views, with something before them and a position of the second."""
    for number in range(2):
        save(folder / f"{number}.png", picture(number))
    views = [f'[[views]]\nfile = "{n}.png"\nposition = {at}\n' for n, at in enumerate(("[0.0, 0.0]", position))]
    file = folder / f"array.{suffix}"
    if suffix == "json":
        views = [f'{{"file": "{n}.png", "position": {at}}}' for n, at in enumerate(("[0, 0]", position))]
        file.write_text(f'{{{first} "views": [{", ".join(views)}]}}')
    else:
        file.write_text(first + "\n" + "".join(views))
    return file


@pytest.mark.parametrize("suffix", ["toml", "json"])
def test_whole_numbers_of_hundreds_of_digits(tmp_path: Path, suffix: str) -> None:
    many = "9" * 400
    assert "is too large a number" in refusal(lambda: read(described(tmp_path, position=f"[{many}, 0]", suffix=suffix)))
    key = f'"reference": {many},' if suffix == "json" else f"reference = {many}"
    text = refusal(lambda: read(described(tmp_path, key, suffix=suffix)))
    assert "reference must be a whole number" in text
    assert len(text) < 400


def test_numbers_and_names_that_cannot_be_written_out(tmp_path: Path) -> None:
    for name in "reference", "name":
        text = refusal(lambda key=name: read(described(tmp_path, f"{key} = 0x{'f' * 9000}")))
        assert f"{name} must be " in text
        assert "not a number of thousands of digits" in text
    file = described(tmp_path, f'name = "{"a.b" * 50}"')
    assert read(file).name == "a.b" * 50
    with (tmp_path / "array.toml").open("wb") as file:
        file.truncate(1 << 33)
    assert "has 8589934592 bytes" in refusal(lambda: read(tmp_path / "array.toml"))
    folder = save_hci(tmp_path / "hci", range(9))
    with (folder / "parameters.cfg").open("r+b") as file:
        file.truncate(1 << 33)
    assert "has 8589934592 bytes" in refusal(lambda: read(folder))


@pytest.mark.parametrize(
    "key", ["a." * 40_000 + "a = 1", "[" + "a . " * 40_000 + "a]", "x = {" + "'a'." * 100 + "a=1}"]
)
def test_dotted_keys_of_many_parts_are_refused_before_they_are_parsed(
    tmp_path: Path, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = described(tmp_path, key)
    monkeypatch.setattr(tomllib, "loads", pytest.fail)  # its time grows with the cube of the parts
    assert "a key of more parts" in refusal(lambda: read(file))


# --- positions ---


@pytest.mark.parametrize("position", ["[0.001, 0.0]", "[0.0004, -0.0004]"])
def test_cameras_in_all_but_one_place_are_refused(tmp_path: Path, position: str) -> None:
    assert "view steps apart" in refusal(lambda: read(described(tmp_path, position=position)))


# --- HDF5 ---


def test_links_in_hdf5_do_not_leave_the_file(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["LF"] = np.zeros((3, 3, 8, 8, 3), np.uint8)
    for link in (h5py.SoftLink("/outside/LF"), h5py.ExternalLink("other.h5", "/LF")):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["outside"] = h5py.ExternalLink("other.h5", "/")
            file["LF"] = link
        assert "no dataset LF" in refusal(lambda: read(tmp_path / "a.h5"))


@pytest.mark.parametrize("shape", [(0, 3, 4, 5, 3), (3, 3, 4, 0, 3), (3, 3, 4, 5, 0), (3, 3, 0, 5)])
def test_hdf5_with_an_axis_of_nothing(tmp_path: Path, shape: tuple[int, ...]) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["LF"] = np.zeros(shape, np.uint8)
    assert "there is nothing in it" in refusal(lambda: read(tmp_path / "a.h5"))


def test_playlists_do_not_reach_other_videos(tmp_path: Path, rng: np.random.Generator) -> None:
    pytest.importorskip("imageio_ffmpeg")
    write_frames(rng.random((3, 32, 48, 3), np.float32), tmp_path / "a.mp4")
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile a.mp4\n")
    assert len(list(video.frames(tmp_path / "a.mp4"))) == 3
    assert "cannot be read as a video" in refusal(lambda: list(video.frames(tmp_path / "list.mp4")))


# --- sizes ---


def test_maps_that_are_not_there_take_no_memory(tmp_path: Path) -> None:
    file = tmp_path / "a.pfm"
    file.write_bytes(b"Pf\n10 10\n-1.0\n")
    with file.open("r+b") as opened:
        opened.truncate(8 << 30)  # a hole in the file: it is on no disk
    assert "refused" in in_little_memory("lfgpu.load(sys.argv[1])", file)
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((9, 16, 16), np.float32))
    for function in (load, read_map):
        assert "has several pages" in refusal(lambda function=function: function(tmp_path / "a.tif"))


def test_maps_that_claim_more_than_they_hold(tmp_path: Path) -> None:
    file = tmp_path / "a.exr"
    DisparityMap(np.ones((8, 9), np.float32)).save(file)
    data = bytearray(file.read_bytes())
    at = data.index(b"dataWindow\0box2i\0") + 21
    assert struct.unpack("<4i", data[at : at + 16]) == (0, 0, 8, 7)
    data[at + 8 : at + 16] = struct.pack("<2i", 29_999, 29_999)
    file.write_bytes(data)
    assert "which a file of" in refusal(lambda: load(file))


@pytest.mark.parametrize("size", [(32, 6000), (6000, 33), (8, 9), (40, 170)])
def test_views_of_odd_shapes_are_read(tmp_path: Path, size: tuple[int, int]) -> None:
    """Also those that are nothing any more when they are shrunk to look at how they move."""
    np.save(tmp_path / "a.npy", np.random.default_rng(0).integers(0, 255, (3, 3, *size), np.uint8))
    assert read(tmp_path / "a.npy").size == size


# --- what is shown ---

_ESCAPE = "a\x1b[2J\x1b]0;owned\x07\u202egnp\udcff\ud800\nb"


def test_what_is_said_is_one_line_that_can_be_shown(tmp_path: Path) -> None:
    for text in ("Küche – 7", "台所", "кухня", "🍳", "می\u200cخواهم", "a\u3000b\xa0c"):
        assert printable(text) == text
    shown = printable(_ESCAPE)
    assert shown == r"a\x1b[2J\x1b]0;owned\x07\u202egnp\udcff\ud800\nb"
    assert printable(shown) == shown
    assert printable(_ESCAPE, keep="\n").endswith("\nb")
    assert len(printable("x" * 10_000, longest=100)) <= 100
    # A name with a thousand zero bytes, each of which is four characters on the screen.
    text = str(LightFieldError("the camera " + "\x00" * 900 + " is not there."))
    assert 900 < len(text) <= 1000
    assert text.startswith("the camera \\x00\\x00")
    assert text.endswith("\\x00\\x00 is not there.")
    assert printable("a\x1bb", longest=6) == "a\\x1bb"
    text = str(LightFieldError(f"{_ESCAPE * 1000}."))
    assert text.isprintable()
    assert text.endswith("b.")
    assert len(text) < 10_000
    text.encode()
    described(tmp_path, f'"name": {json.dumps(_ESCAPE)},', suffix="json")
    found = read(tmp_path / "array.json")
    assert found.name == printable(_ESCAPE)
    assert len(LightField(found.views, found.positions, name="x" * 10**6).name) <= 300


# --- results ---


def bomb(path: Path, name: str, shape: tuple[int, ...]) -> None:
    """An .npz with an array of zeros, packed."""
    header = np.lib.format.header_data_from_array_1_0(np.zeros(0, np.float32)) | {"shape": shape}
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(f"{name}.npy", "w") as file,
    ):
        np.lib.format.write_array_header_1_0(file, header)
        for _ in range(4 * int(np.prod(shape)) >> 24):
            file.write(bytes(1 << 24))


@pytest.mark.parametrize("name", ["disparity", *map(thorough, ("lfgpu", "stage_local", "else"))])
def test_results_that_unpack_to_much_are_refused_first(tmp_path: Path, name: str) -> None:
    sizes = {"lfgpu": (1 << 27,), "disparity": (1 << 13, 1 << 14), "stage_local": (1 << 13, 1 << 14)}
    bomb(tmp_path / "result.npz", name, sizes.get(name, (1 << 27,)))
    with zipfile.ZipFile(tmp_path / "result.npz", "a") as archive, archive.open("x.npy", "w") as file:
        np.lib.format.write_array(file, np.zeros(3))
    for function in (load, read_map):
        assert "claim 53687" in refusal(lambda function=function: function(tmp_path / "result.npz"))


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".pfm", ".png", ".tif", ".exr"])
def test_pipes_in_place_of_maps_are_not_waited_for(tmp_path: Path, suffix: str) -> None:
    os.mkfifo(tmp_path / f"a{suffix}")
    for function in (load, read_map):
        assert "is neither a file nor a folder" in refusal(lambda function=function: function(tmp_path / f"a{suffix}"))
