"""The images of views: what is kept of them, and which are refused."""

import re
import struct
import threading
import time
import warnings
import zlib
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from fields import write_exr
from numpy.typing import NDArray
from PIL import Image
from samples import HEIGHT, WIDTH, box, picture, refusal, save, save_named

import lfgpu
from lfgpu.io import read, read_map
from lfgpu.io.images import read_image, read_view
from lfgpu.io.png import decode_fast, write_png


@pytest.mark.parametrize(
    ("suffixes", "channels", "dtype"),
    [
        ("png bmp pgm tif webp", 1, np.uint8),
        ("png bmp ppm tif webp", 3, np.uint8),
        ("png pgm tif", 1, np.uint16),
        ("tif", 1, np.float32),
    ],
)
def test_values_are_kept(tmp_path: Path, suffixes: str, channels: int, dtype: Any) -> None:
    for suffix in suffixes.split():
        for column in range(2):
            image = picture(column, channels, dtype).squeeze()
            file = tmp_path / suffix / f"0_{column}.{suffix}"
            file.parent.mkdir(exist_ok=True)
            Image.fromarray(image).save(file, **({"lossless": True} if suffix == "webp" else {}))
        views = read(tmp_path / suffix).views
        assert views.dtype == dtype
        expected = picture(1, channels, dtype)
        np.testing.assert_array_equal(views[1], np.broadcast_to(expected, views[1].shape))  # WebP is always in colour
        np.testing.assert_array_equal(views[1].squeeze(), iio.imread(file, plugin="pillow"))


@pytest.mark.parametrize("channels", [1, 3])
def test_the_fast_decoder_of_png_gives_what_pillow_gives(tmp_path: Path, channels: int) -> None:
    """And nothing for damaged files, which Pillow describes."""
    pytest.importorskip("imagecodecs")
    path, want = tmp_path / "a.png", picture(0, channels)
    save(path, want)
    with Image.open(path) as image:
        np.testing.assert_array_equal(decode_fast(path, image), want.squeeze())
    data = path.read_bytes()
    wrong = bytearray(data)
    wrong[len(data) // 2] ^= 0x55
    for damaged in (data[: len(data) // 2], bytes(wrong)):
        path.write_bytes(damaged)
        with Image.open(path) as image:
            assert decode_fast(path, image) is None


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_bytes(width: int, height: int, depth: int, colour: int, rows: bytes) -> bytes:
    """A PNG of unfiltered rows, made by hand: what is read is held against the format, not against our writer."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)


def rows_of(image: NDArray[np.uint16]) -> bytes:
    return b"".join(b"\0" + row.astype(">u2").tobytes() for row in image)


@pytest.mark.parametrize("channels", [3, 4])
def test_16_bit_colour_png_is_read_with_all_its_bits(tmp_path: Path, channels: int) -> None:
    image = picture(1, channels, np.uint16)
    (tmp_path / "a.png").write_bytes(png_bytes(WIDTH, HEIGHT, 16, {3: 2, 4: 6}[channels], rows_of(image)))
    found, remarks = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(found, image[..., :3])
    assert (channels == 4) == bool(remarks)


@pytest.mark.parametrize(("channels", "colour"), [(1, 0), (3, 2)])
def test_16_bit_png_with_a_transparent_value_is_read_with_all_its_bits(
    tmp_path: Path, channels: int, colour: int
) -> None:
    image = picture(1, channels, np.uint16)
    data = png_bytes(WIDTH, HEIGHT, 16, colour, rows_of(image))
    transparent = png_chunk(b"tRNS", image[1, 2].astype(">u2").tobytes())
    (tmp_path / "a.png").write_bytes(data.replace(data[33:41], transparent + data[33:41]))  # before the pixels
    found, valid, _ = read_view(tmp_path / "a.png")
    np.testing.assert_array_equal(found, image)
    np.testing.assert_array_equal(valid, (image != image[1, 2]).any(axis=2))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_round_trip(tmp_path: Path, channels: int, dtype: Any) -> None:
    image = picture(2, channels, dtype)
    write_png(tmp_path / "a.png", image)
    found, remarks = read_image(tmp_path / "a.png")
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, image)
    assert not remarks
    if channels == 3:  # Pillow agrees as far as it goes: it reads the high bytes
        np.testing.assert_array_equal(iio.imread(tmp_path / "a.png"), image >> (8 * (image.itemsize - 1)))


def tiff_bytes(image: NDArray[Any], *, sample_format: int, planar: int = 1, order: str = "<") -> bytes:
    """An uncompressed TIFF of one strip (or one for each plane), made by hand."""
    height, width, channels = image.shape
    stored = image if planar == 1 else np.moveaxis(image, 2, 0)
    data = stored.astype(image.dtype.newbyteorder(order)).tobytes()
    strips = 1 if planar == 1 else channels
    strip = len(data) // strips
    tags = {256: [width], 257: [height], 258: [8 * image.itemsize] * channels, 259: [1]}
    tags |= {262: [1 if channels == 1 else 2], 273: [8 + index * strip for index in range(strips)], 277: [channels]}
    tags |= {278: [height], 279: [strip] * strips, 284: [planar], 339: [sample_format] * channels}
    start = 8 + len(data)
    values_at = start + 2 + 12 * len(tags) + 4
    directory, values = struct.pack(order + "H", len(tags)), b""
    for tag, numbers in tags.items():
        packed = struct.pack(f"{order}{len(numbers)}I", *numbers)
        where = packed if len(packed) <= 4 else struct.pack(order + "I", values_at + len(values))
        values += packed if len(packed) > 4 else b""
        directory += struct.pack(order + "HHI", tag, 4, len(numbers)) + where
    magic = b"II*\0" if order == "<" else b"MM\0*"
    return magic + struct.pack(order + "I", start) + data + directory + b"\0\0\0\0" + values


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("channels", [1, 3])
def test_16_bit_tiff_in_either_byte_order(tmp_path: Path, order: str, channels: int) -> None:
    image = picture(1, channels, np.uint16)
    (tmp_path / "a.tif").write_bytes(tiff_bytes(image, sample_format=1, order=order))
    found, _ = read_image(tmp_path / "a.tif")
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, image)


UNUSUAL = {
    "float colour": (picture(1, 3, np.float32), 3, 1),
    "float64": (picture(1, 1, np.float32).astype(np.float64) / 3, 3, 1),
    "separate planes": (picture(1, 3, np.uint16), 1, 2),  # Pillow reads these without complaint, but wrongly
}


@pytest.mark.parametrize(("image", "sample_format", "planar"), UNUSUAL.values(), ids=UNUSUAL)
def test_unusual_tiff_by_way_of_tifffile(
    tmp_path: Path, image: NDArray[Any], sample_format: int, planar: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(tiff_bytes(image, sample_format=sample_format, planar=planar))
    with monkeypatch.context() as context:
        context.setattr("importlib.util.find_spec", lambda name: None)
        assert "pip install tifffile" in refusal(lambda: read_image(path))
    pytest.importorskip("tifffile", reason="tifffile is not installed")
    found, remarks = read_image(path)
    if image.dtype == np.float64:
        assert remarks == {"float64 values rounded to float32"}
        image = image.astype(np.float32)
    assert found.dtype == image.dtype
    np.testing.assert_array_equal(found, image)


def test_alpha_says_which_pixels_are_valid(tmp_path: Path) -> None:
    save(tmp_path / "0_0.png", picture(0, 4))
    save(tmp_path / "0_1.png", picture(1, 3))
    light_field = read(tmp_path)
    np.testing.assert_array_equal(light_field.views[0], picture(0, 4)[..., :3])
    np.testing.assert_array_equal(light_field.valid[0], picture(0, 4)[..., 3] >= 128)
    assert light_field.valid[1].all()
    assert light_field.notes[-1].startswith("Transparent pixels are not valid")
    save(tmp_path / "grey" / "0_0.png", picture(0, 2))
    save(tmp_path / "grey" / "0_1.png", picture(1, 1))
    assert read(tmp_path / "grey").channels == 1


def test_palettes_become_colours_and_bits_grey(tmp_path: Path) -> None:
    colours = Image.fromarray(picture(0))
    for image, mode in ((colours.quantize(4), "RGB"), (colours.convert("1"), "L")):
        image.save(tmp_path / "a.png")
        found, remarks = read_image(tmp_path / "a.png")
        np.testing.assert_array_equal(found.squeeze(), np.asarray(image.convert(mode)))
        assert not remarks


@pytest.mark.parametrize(
    ("other", "found"),
    [
        (picture(1, 1), "5 x 4 grey uint8"),
        (picture(1, 1, np.uint16), "5 x 4 grey uint16"),
        (picture(1)[:3], "5 x 3 RGB uint8"),
    ],
)
def test_unlike_views_are_refused_by_name(tmp_path: Path, other: NDArray[Any], found: str) -> None:
    save_named(tmp_path, box(1, 3))
    save(tmp_path / "view_00_01.png", other)
    text = refusal(lambda: read(tmp_path))
    assert str(tmp_path) in text
    assert "view_00_00.png is 5 x 4 RGB uint8" in text
    assert f"view_00_01.png is {found}" in text


def test_many_threads_read_what_one_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In their order, the first of several bad files is named, and Python's filters of warnings are as they were."""
    values = np.random.default_rng(0).integers(0, 256, (4, 8, 30, 40, 3), np.uint8)
    for row, column in np.ndindex(4, 8):
        Image.fromarray(values[row, column]).save(tmp_path / f"{row}_{column}.png")
    before = list(warnings.filters)
    for threads in ("1", "8"):
        monkeypatch.setenv("LFGPU_THREADS", threads)
        for lazy in (False, True):
            assert np.array_equal(read(tmp_path, lazy=lazy).views, values.reshape(32, 30, 40, 3))
    for name in ("3_7.png", "1_2.png"):
        (tmp_path / name).write_bytes(b"no picture")
    for _ in range(5):
        assert "1_2.png cannot be read as an image" in refusal(lambda: read(tmp_path))
    assert list(warnings.filters) == before


def test_few_large_views_are_decoded_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that what decoders take does not grow with the number of cores."""
    save_named(tmp_path, box(3, 4))
    monkeypatch.setenv("LFGPU_THREADS", "8")
    inside, most, lock = 0, 0, threading.Lock()

    def watched(*args: Any, **options: Any) -> Any:
        nonlocal inside, most
        with lock:
            inside += 1
            most = max(most, inside)
        time.sleep(0.02)
        found = read_view(*args, **options)
        with lock:
            inside -= 1
        return found

    monkeypatch.setattr("lfgpu.io.views.read_view", watched)
    read(tmp_path)
    assert most > 2
    most = 0
    monkeypatch.setattr("lfgpu.io.views._DECODED", 2 * 3 * HEIGHT * WIDTH * 3)
    read(tmp_path)
    assert most == 2


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tif"])
@pytest.mark.parametrize("kept", [0, 10, 0.6])
def test_damaged_images_are_named(tmp_path: Path, suffix: str, kept: float) -> None:
    for column in range(2):
        path = tmp_path / f"0_{column}.{suffix}"
        Image.fromarray(np.random.default_rng(column).integers(0, 256, (60, 80, 3), dtype=np.uint8)).save(path)
    content = path.read_bytes()
    path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    text = refusal(lambda: read(tmp_path))
    assert f"0_1.{suffix} cannot be read as an image" in text
    assert text.endswith(("its beginning is damaged.", "; copy it again, or write it anew."))


@pytest.mark.parametrize("side", [12_000, 60_000])
def test_absurd_sizes_are_refused_before_memory_is_taken(tmp_path: Path, side: int) -> None:
    (tmp_path / "a.png").write_bytes(png_bytes(side, side, 8, 2, b""))
    text = refusal(lambda: read_image(tmp_path / "a.png"))
    assert f"a.png is damaged: it claims {4 * side * side} bytes" in text


def test_a_picture_is_read_that_is_larger_than_pillow_likes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As pictures of many views side by side are; the claim of a file is compared with its size."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    Image.new("RGB", (60, 80)).save(tmp_path / "a.png")
    assert read_image(tmp_path / "a.png")[0].shape == (80, 60, 3)
    assert Image.MAX_IMAGE_PIXELS == 100


def test_lack_of_memory_is_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError

    save_named(tmp_path, box(1, 2))
    monkeypatch.setattr("lfgpu.io.disk.np.empty", full)
    assert "2 views, each 5 x 4 RGB uint8, do not fit into memory" in refusal(lambda: read(tmp_path))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_undefined_values_are_refused_by_file_name(tmp_path: Path, bad: float) -> None:
    for column in range(2):
        save(tmp_path / f"0_{column}.tif", picture(column, 1, np.float32))
    image = picture(1, 1, np.float32)
    image[2, 3] = bad
    save(tmp_path / "0_1.tif", image)
    assert "0_1.tif has NaN or infinite values" in refusal(lambda: read(tmp_path))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("channels", ["RGB", "RGBA", "Y"])
def test_undefined_values_of_openexr_are_not_valid(tmp_path: Path, channels: str, bad: float) -> None:
    pytest.importorskip("OpenEXR")

    def save_exr(column: int, *wrong: Any) -> None:
        planes = {c: picture(ord(c) + column, 1, np.float32)[..., 0].copy() for c in channels}
        planes |= {"A": np.ones((HEIGHT, WIDTH), np.float32)} if "A" in channels else {}
        planes[channels[0]][wrong] = bad
        write_exr(tmp_path / f"0_{column}.exr", planes)

    save_exr(0, [], [])
    save_exr(1, 2, 3)
    light_field = read(tmp_path)
    assert np.argwhere(~light_field.valid).tolist() == [[1, 2, 3]]
    assert light_field.notes[-2:] == (
        "Pixels that are NaN or infinite taken for transparent in 1 of 2 views.",
        "Transparent pixels are not valid: 2.5 %.",
    )
    assert read_image(tmp_path / "0_1.exr")[0][0, 0].min() > 0
    save_exr(1, ...)
    assert "0_1.exr has no pixel whose values are all finite numbers" in refusal(lambda: read(tmp_path))
    write_exr(tmp_path / "0_1.exr", {c: np.full((HEIGHT, WIDTH), 1.5, np.float32) for c in channels})
    assert "Values brighter than white, more than 1 % of all, cut off in 1 of 2 views." in read(tmp_path).notes


@pytest.mark.parametrize("options", [{}, {"bigtiff": True}, {"byteorder": ">"}, {"compression": "zlib"}])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_further_pages_are_not_dropped(tmp_path: Path, options: dict[str, Any], dtype: type) -> None:
    """Nor taken for colours: Pillow decodes some of these files, tifffile the others."""
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed")
    planes = np.moveaxis(picture(), 2, 0).astype(dtype)
    for column in range(2):
        tifffile.imwrite(tmp_path / f"0_{column}.tif", planes, photometric="minisblack", **options)
    assert "0_0.tif has 3 pages of one size, but a view is one page" in refusal(lambda: read(tmp_path))


def test_copies_and_masks_in_further_pages_are_passed_over(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed")
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(picture(), photometric="rgb")
        file.write(picture(1), photometric="rgb", subfiletype=1)
        file.write(picture(2)[..., 0] > 99, photometric="mask", subfiletype=4)
        file.write(picture(3)[::2, ::2], photometric="rgb")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif")[0], picture())


def test_kinds_of_pictures_that_are_refused(tmp_path: Path) -> None:
    """Among them PPM of 16-bit colour, of which Pillow keeps half."""
    first, second = (Image.fromarray(picture(seed)) for seed in range(2))
    for name in ("a.webp", "film.png"):
        first.save(tmp_path / name, save_all=True, append_images=[second])
    first.quantize().save(tmp_path / "palette.png", save_all=True, append_images=[second.quantize()])
    deep = picture(0, 3, np.uint16).astype(">u2").tobytes()
    (tmp_path / "a.ppm").write_bytes(f"P6 {WIDTH} {HEIGHT} 65535\n".encode() + deep)
    (tmp_path / "a.png").write_bytes(png_bytes(WIDTH, HEIGHT, 16, 4, rows_of(picture(1, 2, np.uint16))))
    Image.fromarray(np.zeros((3, 3), np.int32)).save(tmp_path / "a.tif")
    first.convert("CMYK").save(tmp_path / "a.jpg")
    for name, words in {
        "a.webp": "is an animation of 2 images",
        "film.png": "is an animation of 2 images",
        "palette.png": "is an animation of 2 images",
        "a.ppm": "is a PPM of 16-bit colour",
        "a.png": "is 16-bit grey with transparency",
        "a.tif": "has 32-bit integers",
        "a.jpg": "has colour mode CMYK",
    }.items():
        assert f"{name} {words}" in refusal(lambda name=name: read_image(tmp_path / name))
    for order in "<>":
        (tmp_path / "b.tif").write_bytes(tiff_bytes(picture(0, 1, np.int16), sample_format=2, order=order))
        assert "b.tif has signed 16-bit integers" in refusal(lambda: read_image(tmp_path / "b.tif"))
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed")
    tifffile.imwrite(tmp_path / "b.tif", np.ones((8, 9, 4), np.bool_), photometric="rgb")
    assert "has bool values" in refusal(lambda: read_image(tmp_path / "b.tif"))


EPS = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 5 4
%%EndComments
(/etc/hostname) (r) file pop
showpage
%%EOF
"""


def test_a_program_that_is_named_as_a_picture_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pillow hands EPS to Ghostscript, whatever the file is called."""
    ghostscript, started = tmp_path / "bin" / "gs", tmp_path / "started"
    ghostscript.parent.mkdir()
    ghostscript.write_text(f"#!/bin/sh\ntouch {started}\n")
    ghostscript.chmod(0o755)
    monkeypatch.setenv("PATH", str(ghostscript.parent), prepend=":")
    monkeypatch.setattr("PIL.EpsImagePlugin.gs_binary", None)  # Pillow looks for it once
    folder = tmp_path / "views"
    for column in range(3):
        save(folder / f"0_{column}.png")
        (folder / f"0_{column}.png").write_bytes(EPS)
    texts = [
        refusal(lambda: read(folder)),
        refusal(lambda: read_map(folder / "0_0.png")),
        refusal(lambda: read(folder / "0_0.png", format="lenslet")),
    ]
    assert not started.exists()
    assert all("none of PNG" in text for text in texts)


def test_pictures_are_opened_in_one_place() -> None:
    """The one that knows which formats are safe."""
    package = Path(lfgpu.__file__).parent
    others = [path.name for path in package.rglob("*.py") if re.search(r"\bImage\.open\(", path.read_text())]
    assert others == ["pillow.py"]


@pytest.mark.parametrize("compression", ["tiff_lzw", "jpeg"])
def test_what_libtiff_says_of_damage_stays_out_of_the_terminal(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], compression: str
) -> None:
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)).save(
        tmp_path / "a.tif", compression=compression
    )
    data = bytearray((tmp_path / "a.tif").read_bytes())
    data[20:900:7] = bytes(byte ^ 0x5A for byte in data[20:900:7])
    (tmp_path / "a.tif").write_bytes(data)
    refusal(lambda: read_image(tmp_path / "a.tif"))
    assert capfd.readouterr() == ("", "")
