"""Raw captures in the files of cameras: containers, packed bits, and everything that can be wrong with them."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lenslet_samples import Camera, Sample, capture, container, eight_bit, metadata, packed, section
from PIL import Image
from samples import changed, refusal

from lfgpu.io import read, recognise
from lfgpu.io.lenslet.capture import read_capture, unpack
from lfgpu.io.lenslet.decode import decode
from lfgpu.scenes import make

SHAPE = (8, 20)


def values(bits: int, shape: tuple[int, int] = SHAPE, seed: int = 0) -> Any:
    return np.random.default_rng(seed).integers(0, 1 << bits, shape, dtype=np.uint16)


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def small(bits: int = 12, **changes: Any) -> bytes:
    """A container of few pixels; `changes` go into the metadata, see `changed`."""
    about = changed(metadata(SHAPE, bits=bits), **changes)
    return container(packed(values(bits), bits), about, illum=bits == 10)


@pytest.fixture(scope="module")
def sample() -> Sample:
    scene = make("planes", grid=(9, 9), size=(40, 42), disparity_range=(-0.6, 0.6), seed=3)
    return capture(scene, Camera(size=(280, 300)), noise=0.005)


# --- what comes back ---


@pytest.mark.parametrize("bits", [12, 10])
def test_packed_values_come_back(bits: int) -> None:
    assert np.array_equal(unpack(packed(values(bits), bits), SHAPE, bits), values(bits))


def test_values_are_packed_and_bare(tmp_path: Path) -> None:
    assert unpack(bytes([0xAB, 0xCD, 0xEF]), (1, 2), 12).tolist() == [[0xABC, 0xDEF]]
    assert unpack(bytes([0xFF, 0, 0x80, 1, 0b11_10_01_00]), (1, 4), 10).tolist() == [[1020, 1, 514, 7]]
    stored = np.zeros((3280, 3280), np.uint16)
    stored[:8, :20] = values(12)
    path = write(tmp_path / "IMG.RAW", packed(stored, 12))
    assert recognise(path)[1] == "it has the name and the length of a raw file of the first Lytro"
    found = read_capture(path)
    assert np.abs(found.mosaic[:8, :20] - np.clip((values(12) - 168.0) / 3927, 0, 1)).max() < 1e-6
    assert "assumed" in found.notes[0]
    short = write(tmp_path / "short.raw", bytes(1000))
    assert "it has 1000 bytes, not 16137600 (the first Lytro)" in refusal(lambda: read(short, format="lenslet"))
    assert "is not a light field of a known format" in refusal(lambda: read(short))


@pytest.mark.parametrize("bits", [12, 10])
def test_a_container_is_read(bits: int, tmp_path: Path) -> None:
    path = write(tmp_path / "a.lfr", small(bits))
    found = read_capture(path)
    black, white = (168, 4095) if bits == 12 else (64, 1023)
    expected = np.clip((values(bits) - float(black)) / (white - black), 0, 1)
    assert np.abs(found.mosaic - expected).max() < 1e-6
    assert (found.bayer, found.balance, found.notes) == ("bggr", (1, 1, 1), ())
    entry, reason = recognise(path)
    assert (entry.name, reason) == ("lenslet", "it is a container of a Lytro camera")


@pytest.mark.parametrize(("first", "pattern"), [("b", "bggr"), ("gr", "grbg"), ("gb", "gbrg"), ("r", "rggb")])
def test_the_mosaic_begins_where_it_is_said(first: str, pattern: str, tmp_path: Path) -> None:
    about = metadata(SHAPE, first=first)
    about["image"]["rawDetails"]["pixelFormat"]["black"]["gr"] = 1000
    found = read_capture(write(tmp_path / "a.lfp", container(packed(values(12), 12), about)))
    assert found.bayer == pattern
    place = {"b": (1, 0), "gr": (0, 0), "gb": (1, 1), "r": (0, 1)}[first]
    assert np.argwhere(found.mosaic == 0).size
    of_gr = found.mosaic[place[0] :: 2, place[1] :: 2]
    raw = values(12)[place[0] :: 2, place[1] :: 2]
    assert np.array_equal(of_gr > 0, raw > 1000)


def test_white_balance_and_orientation(tmp_path: Path) -> None:
    data = small(image__color={"whiteBalanceGain": {"r": 1.5, "gr": 1.0, "gb": 1.0, "b": 2}}, image__orientation=6)
    found = read_capture(write(tmp_path / "a.lfp", data))
    assert found.balance == (1.5, 1.0, 2.0)
    assert any("held turned" in note for note in found.notes)
    plain = read_capture(write(tmp_path / "b.lfp", small(image__color=None)))
    assert plain.balance == (1.0, 1.0, 1.0)


def test_a_capture_in_a_container_is_the_capture_in_a_picture(sample: Sample, tmp_path: Path) -> None:
    Image.fromarray(eight_bit(sample.raw)).save(tmp_path / "raw.png")
    from_picture = read(tmp_path / "raw.png")
    for bits, black, white in ((12, 168, 4095), (10, 64, 1023)):
        stored = np.rint(black + eight_bit(sample.raw) / 255 * (white - black)).astype(np.uint16)
        about = metadata(stored.shape, bits=bits)
        path = write(tmp_path / f"{bits}.lfp", container(packed(stored, bits), about, illum=bits == 10))
        light_field = read(path)
        assert light_field.views.shape == from_picture.views.shape
        off = np.abs(light_field.views.astype(float) - from_picture.views).mean() / 65535
        assert off < (0.001 if bits == 12 else 0.003)


def test_imageio_reads_the_same_pixels_from_a_whole_picture(tmp_path: Path) -> None:
    """imageio knows the first Lytro's files of full size only; here it is a reader that is not ours."""
    iio = pytest.importorskip("imageio.v2")
    shape = (3280, 3280)
    stored = np.random.default_rng(1).integers(0, 4096, shape, dtype=np.uint16)
    path = write(tmp_path / "full.lfp", container(packed(stored, 12), metadata(shape)))
    theirs = iio.imread(path, format="lytro-lfp") * 4095
    assert np.array_equal(np.rint(theirs), stored)
    ours = read_capture(path).mosaic
    assert np.abs(ours - np.clip((theirs - 168) / (4095 - 168), 0, 1)).max() < 1e-5


# --- what is refused ---


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"image__width": 21}, "21 x 8 values"),
        ({"image__width": 10**9}, "image.width = 1000000000, not a number from"),
        ({"image__width": 10**400}, "image.width"),
        ({"image__width": -20}, "image.width = -20"),
        ({"image__width": 20.5}, "image.width = 20.5"),
        ({"image__width": True}, "image.width = True"),
        ({"image__height": "8"}, "a JSON str for image.height"),
        ({"image__height": None}, "nothing for image.height"),
        ({"image__rawDetails": []}, "a JSON list for image.rawDetails"),
        ({"image": None}, "nothing for image,"),
        ({"image__rawDetails__pixelPacking": {"endianness": "little", "bitsPerPixel": 12}}, "12 bits, little endian"),
        ({"image__rawDetails__pixelPacking": {"endianness": "big", "bitsPerPixel": 9}}, "9 bits, big endian"),
        ({"image__rawDetails__mosaic": {"tile": "r,g:g,b", "upperLeftPixel": "b"}}, "unknown mosaic 'r,g:g,b'"),
        ({"image__rawDetails__mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "w"}}, "unknown first pixel 'w'"),
        ({"image__rawDetails__pixelFormat__white": dict.fromkeys(("r", "gr", "gb", "b"), 100)}, "white level"),
        ({"image__rawDetails__pixelFormat__black": {"r": 1}}, "nothing for image.rawDetails.pixelFormat.black.b"),
        ({"image__color": {"whiteBalanceGain": {"r": 0, "gr": 1, "b": 1}}}, "whiteBalanceGain.r = 0"),
    ],
)
def test_metadata_that_cannot_be(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.lfp", small(**changes))
    text = refusal(lambda: read(path))
    assert str(path) in text
    assert words in text


def test_containers_that_are_damaged_or_of_other_kinds(tmp_path: Path) -> None:
    good = small()

    def says(data: bytes, words: str) -> None:
        path = write(tmp_path / "a.lfp", data)
        text = refusal(lambda: read(path))
        assert str(path) in text
        assert words in text

    head = good[:16]
    says(head, "0 tables of contents")
    says(good[: len(good) // 2], "is cut off or damaged: a section at byte")
    says(
        head + b"\x89LFM\r\n\x1a\n" + struct.pack(">II", 0, 0xFFFFFFFF), "claims 4294967295 bytes, of which 0 are there"
    )
    says(head + b"some text that is no section", "at byte 16 there is no section")
    says(head + section(b"C", b"")[0][:16] * 2000, "more than 1000 sections")
    says(head + section(b"M", b"{broken")[0], "its table of contents is not JSON")
    says(head + section(b"M", b"[" * 100_000)[0], "its table of contents is not JSON")
    says(head + section(b"M", b"[1, 2]")[0], "a JSON list, not an object")
    says(head + section(b"M", b"\xff\xfe\xfa")[0], "is not JSON")
    says(head + 2 * section(b"M", b"{}")[0], "2 tables of contents")
    refocused = json.dumps({"picture": {"frameArray": [], "accelerationArray": [1]}}).encode()
    says(head + section(b"M", refocused)[0], "has no list of objects as picture.accelerationArray")
    nothing = json.dumps({"picture": {}}).encode()
    says(head + section(b"M", nothing)[0], "it holds nothing; give the container with the raw picture")
    picture, name = section(b"C", b"values")
    lost = json.dumps({"frames": [{"frame": {"imageRef": name, "metadataRef": 7}}]}).encode()
    says(head + section(b"M", lost)[0] + picture, "its metadataRef names '7', and there is no such section")


def test_a_container_of_something_else_shows_no_microlenses(tmp_path: Path) -> None:
    stored = values(12, (256, 256))
    path = write(tmp_path / "noise.lfp", container(packed(stored, 12), metadata(stored.shape)))
    assert "noise.lfp shows no microlenses" in refusal(lambda: decode(path))
    tiny = write(tmp_path / "tiny.lfp", small())
    assert "tiny.lfp" in refusal(lambda: decode(tiny))
