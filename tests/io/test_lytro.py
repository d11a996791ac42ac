"""Files of Lytro cameras and their program: raw captures, packed bits, views, and everything that can be wrong."""

import json
import struct
from pathlib import Path
from typing import Any

import lytro_samples
import numpy as np
import pytest
from conftest import real_data
from fields import SAMPLES, scene
from lenslet_samples import Camera, Sample, capture, container, eight_bit, metadata, packed, section
from PIL import Image
from samples import changed, refusal

from lfgpu.io import parallax, read, recognise
from lfgpu.io.lenslet.capture import read_capture, unpack
from lfgpu.io.lenslet.decode import decode
from lfgpu.io.lytro import inside
from lfgpu.io.lytro.container import open_container
from lfgpu.io.lytro.contents import read_contents
from lfgpu.scenes import make

IMAGES = np.random.default_rng(0).integers(0, 256, (3, 16, 24, 3), np.uint8)


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def of_views(coordinates: list[tuple[float, float]]) -> lytro_samples.Part:
    images = np.random.default_rng(1).integers(0, 256, (len(coordinates), 16, 24, 3), np.uint8)
    return lytro_samples.pictures(images, [{"coord": {"x": x, "y": y}} for x, y in coordinates])


def write_views(folder: Path, content: dict[str, Any], data: list[bytes]) -> Path:
    return write(folder / "a.lfp", lytro_samples.processed([("edofParallax", content)], data))


HEXAGON = [(0.0, 0.0), *((0.2 * np.cos(a), 0.2 * np.sin(a)) for a in np.radians(range(30, 390, 60)))]


def test_views_of_a_hexagonal_lattice(tmp_path: Path) -> None:
    path = write_views(tmp_path, *of_views(HEXAGON))
    found = read(path)
    assert recognise(path)[0].name == "lytro"
    assert (found.reference, found.grid_shape, found.size) == (0, None, (16, 24))
    np.testing.assert_allclose(np.hypot(*found.offsets[1:].T), 1)
    np.testing.assert_allclose(found.offsets[1], [np.sqrt(3) / 2, 0.5])
    assert found.notes[0] == "One view step is 0.2 in Lytro's unit, the distance of neighbouring views."


def test_a_focal_stack_is_said_to_be_one(tmp_path: Path) -> None:
    content, data = lytro_samples.focal_stack(IMAGES)
    stack = lytro_samples.processed([("refocusStack", content)], data, camera=lytro_samples.CAMERA)
    path = write(tmp_path / "a.lfp", stack)
    said = inside(path)
    facts = dict(said.facts)
    assert facts["contents"] == "a focal stack"
    assert facts["camera"] == "Lytro, Inc. F01, 2015-05-05T10:07:34.000Z"
    assert facts["lens"] == "6.53 mm, f/1.91, 0.0125 s, ISO 100"
    assert facts["microlenses"].startswith("10 px apart, turned by 0.109 degrees")
    assert said.no_depth is not None
    text = refusal(lambda: read(path))
    for sentence in (text, said.no_depth):
        assert "all show the scene from one place" in sentence
        assert "give the container with the raw picture" in sentence


def test_the_illum_says_it_in_other_words(tmp_path: Path) -> None:
    path = write(tmp_path / "a.LFP", lytro_samples.of_illum({"kind": "focusStack"}, [], camera=lytro_samples.CAMERA))
    contents = read_contents(path)
    assert contents.summary() == "a focal stack"
    assert contents.camera.microlenses is not None
    assert "from one place" in refusal(lambda: read(path))


def test_a_raw_picture_goes_before_what_was_computed_from_it(tmp_path: Path) -> None:
    data = container(packed(np.zeros((8, 20), np.uint16), 12), {**metadata((8, 20)), **lytro_samples.CAMERA})
    path = write(tmp_path / "a.lfp", data)
    assert recognise(path)[0].name == "lenslet"
    facts = dict(inside(path).facts)
    assert facts["contents"] == "a raw picture"
    assert inside(path).no_depth is None
    path = write(tmp_path / "a.lfp", lytro_samples.processed([("depthMap", {})], []))
    text = refusal(lambda: read(path))
    assert f"the raw picture '{lytro_samples.LOST}' that it names is not in this file" in text
    assert "has no raw picture" in refusal(lambda: read(path, format="lenslet"))
    path = write(tmp_path / "a.lfp", lytro_samples.processed([("hologram", {})], []))
    assert "an acceleration 'hologram', which is not known" in refusal(lambda: read(path))


# --- real files of views ---


@pytest.mark.parametrize(
    ("name", "contents"),
    [
        ("IMG_0001-stk.lfp", "a focal stack"),
        ("IMG_0002-dm.lfp", "a depth table"),
        ("flowers-stk.lfp", "a focal stack"),
        ("buddha.lfp", "a focal stack"),
        ("illum_demo.LFP", "a focal stack"),
    ],
)
def test_real_containers_without_views(name: str, contents: str) -> None:
    file = real_data(f"real/lytro/{name}")
    assert recognise(file)[0].name == "lytro"
    said = inside(file)
    assert dict(said.facts)["contents"] == contents
    assert said.no_depth is not None
    assert said.no_depth in refusal(lambda: read(file))


def test_real_views_run_against_lytros_depth() -> None:
    pytest.importorskip("imageio_ffmpeg")
    found = read(real_data("real/lytro/IMG_0002-stk.lfp"))
    assert found.views.shape == (37, 1080, 1080, 3)
    assert found.offsets[found.reference_index].tolist() == [0, 0]
    np.testing.assert_allclose(np.sort(np.hypot(*found.offsets.T))[:8], [0, 1, 1, 1, 1, 1, 1, np.sqrt(3)], atol=1e-6)
    assert parallax.axes_agree(found) is True
    container = open_container(real_data("real/lytro/IMG_0002-dm.lfp"))
    name = next(name for name, section in container.sections.items() if section.length == 4 * 330 * 330)
    table = np.frombuffer(container.data(name), "<f4").reshape(330, 330)  # λ, larger is farther
    for axis in (0, 1):
        measured = parallax.measured(found, axis)
        assert measured is not None
        disparity, weight = measured
        places = [(np.arange(side) + 0.5) * 330 / side for side in disparity.shape]
        there = table[np.ix_(*(np.floor(place).astype(int) for place in places))]
        assert parallax.agreement(disparity, -there.astype(float), weight) > 0.8


# --- views that are damaged ---


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"imageArray__0__imageRef": "sha1-x"}, "its imageRef names 'sha1-x', and there is no such section"),
        ({"imageArray__0__imageRef": None}, "its imageRef names 'None'"),
        ({"imageArray__0__width": 25}, "pictures of several sizes or kinds"),
        ({"imageArray__0__width": 10**9}, "imageArray[0].width = 1000000000, not a number from 8 to 16384"),
        ({"imageArray__1__representation": "jpeg"}, "pictures of several sizes or kinds"),
        ({"imageArray__0__coord": 3}, "a JSON int for picture.accelerationArray[0].vendorContent.imageArray[0].coord"),
        ({"imageArray__0__coord__x": 1e6}, "vendorContent.imageArray[0].coord.x = 1000000.0"),
        ({"imageArray__0__coord__x": float("nan")}, "coord.x = nan"),
        ({"imageArray": []}, "has no pictures"),
        ({"imageArray": [3]}, "has no list of objects"),
        ({"imageArray": {}}, "vendorContent.imageArray, where a list should be"),
    ],
)
def test_descriptions_of_views_that_cannot_be(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    content, data = of_views(HEXAGON)
    path = write_views(tmp_path, changed(content, **changes), data)
    assert words in refusal(lambda: read(path, format="lytro"))


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"width": 48}, "a picture in it is 24 x 16 px, where it says 48 x 16"),
        ({"width": 16384, "height": 16384}, "claims 805306368 bytes of pixels"),
        ({"representation": "jpeg"}, "a picture in it cannot be read (it is not jpeg)"),
        ({"representation": "webp"}, "pictures stored as 'webp'; known are jpeg, png and h264"),
        ({"coord": {"x": 0, "y": 0}}, "several of its views stand in one place"),
    ],
)
def test_pictures_that_are_not_what_they_are_said_to_be(said: dict[str, Any], words: str, tmp_path: Path) -> None:
    content, data = of_views(HEXAGON)
    for entry in content["imageArray"]:
        entry.update(said)
    path = write_views(tmp_path, content, data)
    assert words in refusal(lambda: read(path))


def test_one_view_is_no_light_field(tmp_path: Path) -> None:
    path = write_views(tmp_path, *of_views([(0, 0)]))
    assert "one view only" in refusal(lambda: read(path))


def test_videos_that_are_not_what_they_are_said_to_be(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    lf = scene((3, 3), (36, 34))
    good = SAMPLES["lytro"].write(lf, tmp_path)
    contents = read_contents(good)
    name = contents.views.sections[0]
    stream = contents.container.data(name)

    def says(words: str, data: bytes = stream, size: tuple[int, int] = lf.size, count: int = 9) -> None:
        each = [{"coord": {"x": 0.1 * i, "y": 0}} for i in range(count)]
        content, sections = lytro_samples.video(data, size, each)
        path = write_views(tmp_path, content, sections)
        assert words in refusal(lambda: read(path))

    says("says that its video has 10 pictures, it has 9", count=10)
    says("says that its video has 8 pictures, it has more", count=8)
    says("a picture in it is 34 x 36 px, where it says 40 x 40", size=(40, 40))
    says("cannot be read as a video", data=b"no video" * 100)


SHAPE = (8, 20)


def values(bits: int, shape: tuple[int, int] = SHAPE, seed: int = 0) -> Any:
    return np.random.default_rng(seed).integers(0, 1 << bits, shape, dtype=np.uint16)


def small(bits: int = 12, **changes: Any) -> bytes:
    """A container of few pixels; `changes` go into the metadata, see `changed`."""
    about = changed(metadata(SHAPE, bits=bits), **changes)
    return container(packed(values(bits), bits), about, illum=bits == 10)


@pytest.fixture(scope="module")
def sample() -> Sample:
    scene = make("planes", grid=(9, 9), size=(40, 42), disparity_range=(-0.6, 0.6), seed=3)
    return capture(scene, Camera(size=(280, 300)), noise=0.005)


# --- raw captures: what comes back ---


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


# --- raw captures: what is refused ---


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


HEAD = small()[:16]


def table(content: bytes) -> bytes:
    """A container that holds a table of contents only."""
    return HEAD + section(b"M", content)[0]


def without_metadata() -> bytes:
    picture, name = section(b"C", b"values")
    return table(json.dumps({"frames": [{"frame": {"imageRef": name, "metadataRef": 7}}]}).encode()) + picture


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (HEAD, "0 tables of contents"),
        (small()[: len(small()) // 2], "is cut off or damaged: a section at byte"),
        (HEAD + b"\x89LFM\r\n\x1a\n" + struct.pack(">II", 0, 0xFFFFFFFF), "claims 4294967295 bytes, of which 0 are"),
        (HEAD + b"some text that is no section", "at byte 16 there is no section"),
        (HEAD + section(b"C", b"")[0][:16] * 2000, "more than 1000 sections"),
        (table(b"{broken"), "its table of contents is not JSON"),
        (table(b"[" * 100_000), "its table of contents is not JSON"),
        (table(b"[1, 2]"), "a JSON list, not an object"),
        (table(b"\xff\xfe\xfa"), "is not JSON"),
        (table(b"{}") + section(b"M", b"{}")[0], "2 tables of contents"),
        (table(b'{"picture": {"frameArray": [], "accelerationArray": [1]}}'), "no list of objects as picture.accel"),
        (table(b'{"picture": {}}'), "it holds nothing; give the container with the raw picture"),
        (without_metadata(), "its metadataRef names '7', and there is no such section"),
    ],
    ids=range(13),
)
def test_containers_that_are_damaged_or_of_other_kinds(data: bytes, words: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.lfp", data)
    text = refusal(lambda: read(path))
    assert str(path) in text
    assert words in text


def test_a_container_of_something_else_shows_no_microlenses(tmp_path: Path) -> None:
    stored = values(12, (256, 256))
    path = write(tmp_path / "noise.lfp", container(packed(stored, 12), metadata(stored.shape)))
    assert "noise.lfp shows no microlenses" in refusal(lambda: decode(path))
    tiny = write(tmp_path / "tiny.lfp", small())
    assert "tiny.lfp" in refusal(lambda: decode(tiny))
