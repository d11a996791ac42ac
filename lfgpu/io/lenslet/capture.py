"""One raw capture, whatever it comes in: a Lytro container, a bare raw file of a Lytro camera, or a grey picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import read_as
from lfgpu.io.folders import IMAGE_SUFFIXES
from lfgpu.io.images import read_image
from lfgpu.io.lenslet.vignetting import Float32Array
from lfgpu.io.lytro.container import is_container
from lfgpu.io.lytro.contents import Camera, read_contents
from lfgpu.io.texts import Members

_SIDES = (8, 32768)  # pixels that a container may claim
_LEVELS = (0.1, 99.9)  # percentiles
_OFFSET = 0.5  # of the brightest values, for the darkest ones, from which they are taken for black
_PLACES = ("r", "gr", "gb", "b")


@dataclass(frozen=True, eq=False)
class Capture:
    """The picture that the sensor recorded."""

    mosaic: Float32Array  # [y, x], linear: 0 is black and 1 the white level of the sensor
    bayer: str | None  # the pattern if the file says which one it is
    balance: tuple[float, float, float]
    """Gains of red, green and blue that make white of white, if the file has them; else 1."""
    source: str  # the kind of its file, for people
    notes: tuple[str, ...] = ()
    camera: Camera | None = None  # the camera, as far as the file describes it


@dataclass(frozen=True)
class _Camera:
    """The format of the bare raw files of a camera, which say nothing about themselves but by their length."""

    name: str
    shape: tuple[int, int]
    bits: int
    bayer: str
    black: int

    @property
    def length(self) -> int:
        return self.shape[0] * self.shape[1] * self.bits // 8


_CAMERAS = (
    _Camera("the first Lytro", (3280, 3280), 12, "bggr", 168),
    _Camera("the Lytro Illum", (5368, 7728), 10, "grbg", 64),
)


def bare_raw(path: Path) -> str | None:
    """Return the camera that a bare raw file is of, by its suffix and length; None if it is none."""
    camera = _camera(path) if path.suffix.lower() == ".raw" else None
    return camera.name if camera else None


def read_capture(path: Path) -> Capture:
    """Read a capture; LightFieldError if the file is none, or damaged."""
    if is_container(path):
        return _from_container(path)
    if path.suffix.lower() == ".raw":
        return _from_bare_raw(path)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return _from_image(path)
    raise LightFieldError(
        f"{path} is not a raw capture: neither a Lytro container (.lfp, .lfr), nor a raw file of a Lytro camera "
        f"(.raw), nor a picture ({', '.join(sorted(IMAGE_SUFFIXES))})."
    )


def unpack(data: bytes, shape: tuple[int, int], bits: int) -> NDArray[np.uint16]:
    """Unpack numbers [y, x] of 12 or 10 bits, from as many bytes as they take.

    12 bits: three bytes hold two numbers, the high bits first ("big"). 10 bits: four bytes hold the high eight bits of
    a number each, a fifth one the low bits of all four, those of the first number lowest ("little").
    """
    packed = np.frombuffer(data, np.uint8)
    values = np.empty((len(packed) * 8 // bits), np.uint16)
    if bits == 12:
        first, middle, last = (packed[i::3].astype(np.uint16) for i in range(3))
        values[0::2] = first << 4 | middle >> 4
        values[1::2] = (middle & 15) << 8 | last
    else:
        low = packed[4::5].astype(np.uint16)
        for i in range(4):
            values[i::4] = packed[i::5].astype(np.uint16) << 2 | low >> (2 * i) & 3
    return values.reshape(shape)


def _from_image(path: Path) -> Capture:
    image, _ = read_image(path)
    if image.shape[2] != 1:
        raise LightFieldError(
            f"{path} is a colour picture; a raw capture is grey, with the mosaic of the sensor in it: save it without "
            "demosaicing."
        )
    mosaic, notes = scaled(image[..., 0])
    return Capture(mosaic, None, (1.0, 1.0, 1.0), f"grey picture, {image.dtype}", notes)


def scaled(image: NDArray[Any]) -> tuple[Float32Array, tuple[str, ...]]:
    """Scale a grey picture to black at 0 and white at 1; returns it and what was assumed of these levels.

    Between microlenses it is dark. Where a picture is not, as those of thermal sensors are, its values have an offset.
    """
    whole = image.dtype != np.float32
    low, high = (float(level) for level in np.percentile(image, _LEVELS))
    black, white = 0.0, float(np.iinfo(image.dtype).max) if whole else 1.0
    of_white = low <= _OFFSET * high and (whole or (low >= 0.0 and high <= 1.0))
    if not of_white:
        black = low if low < 0.0 or low > _OFFSET * high else 0.0
        white = max(float(image.max()), black + 1e-6)
    mosaic = (image.astype(np.float32) - np.float32(black)) / np.float32(white - black)
    note = f"Black level {black:g} and white level {white:g} are assumed: the picture's values are no shares of white."
    return np.clip(mosaic, 0.0, 1.0), () if of_white else (note,)


def _camera(path: Path) -> _Camera | None:
    try:
        length = path.stat().st_size
    except OSError:
        return None
    return next((camera for camera in _CAMERAS if camera.length == length), None)


def _from_bare_raw(path: Path) -> Capture:
    camera = _camera(path)
    if camera is None:
        known = " or ".join(f"{camera.length} ({camera.name})" for camera in _CAMERAS)
        found = path.stat().st_size if path.is_file() else 0
        raise LightFieldError(f"{path} is not a raw file of a Lytro camera: it has {found} bytes, not {known}.")
    with read_as(path):
        values = unpack(path.read_bytes(), camera.shape, camera.bits)
    white = (1 << camera.bits) - 1
    note = (
        f"Black level {camera.black} and white level {white} are assumed, as is the mosaic: a bare raw file has none."
    )
    mosaic = _levelled(values, np.full((2, 2), camera.black), np.full((2, 2), white))
    return Capture(mosaic, camera.bayer, (1.0, 1.0, 1.0), f"raw file of {camera.name}", (note,))


def _from_container(path: Path) -> Capture:
    contents = read_contents(path)
    if contents.raw is None:
        lost = f", and names {contents.missing!r}, for which there is no such section" if contents.missing else ""
        raise LightFieldError(
            f"{path} has no raw picture: it is a Lytro container with {contents.summary()}{lost}; give the one that "
            "the camera wrote."
        )
    image = Members(path, contents.raw.metadata).object("image")
    # The first Lytro keeps what it says of raw data apart.
    details = image.object("rawDetails") if "rawDetails" in image.values else image
    width, height = (image.integer(key, *_SIDES) for key in ("width", "height"))
    packing = details.object("pixelPacking")
    bits, endianness = packing.integer("bitsPerPixel", 8, 16), packing.text("endianness")
    if (bits, endianness) not in {(12, "big"), (10, "little")}:
        raise LightFieldError(f"{path} has values of {bits} bits, {endianness} endian, which cannot be read.")
    stored = contents.container.length(contents.raw.section)
    if stored * 8 != width * height * bits:
        raise LightFieldError(
            f"{path} is damaged: {width} x {height} values of {bits} bits are {width * height * bits // 8} bytes, "
            f"its raw picture has {stored}."
        )
    values = unpack(contents.container.data(contents.raw.section), (height, width), bits)
    places = _places(path, details.object("mosaic"))
    levels = details.object("pixelFormat")
    black, white = (
        np.array([[levels.object(key).number(place, 0, 65535) for place in row] for row in places])
        for key in ("black", "white")
    )
    if (white <= black).any():
        raise LightFieldError(f"{path} is damaged: its white level is not above its black level.")
    turned = image.values.get("orientation", 1) != 1
    return Capture(
        _levelled(values, black, white),
        "".join(place[0] for row in places for place in row),
        _balance(image),
        f"Lytro container, {width} x {height} of {bits} bits",
        ("The camera was held turned, the views are as the sensor saw them.",) if turned else (),
        contents.camera,
    )


def _places(path: Path, mosaic: Members) -> list[list[str]]:
    """Return [2][2], names of the places of the mosaic, from the tile "r,gr:gb,b" and the name of the first pixel."""
    tile = [row.split(",") for row in mosaic.text("tile").split(":")]
    first = mosaic.text("upperLeftPixel")
    if sorted(place for row in tile for place in row) != sorted(_PLACES) or [len(row) for row in tile] != [2, 2]:
        raise LightFieldError(f"{path} has an unknown mosaic {mosaic.text('tile')!r}; known is 'r,gr:gb,b'.")
    if first not in _PLACES:
        raise LightFieldError(f"{path} has an unknown first pixel {first!r}; known are {', '.join(_PLACES)}.")
    top = 0 if first in tile[0] else 1
    left = tile[top].index(first)
    return [[tile[(top + i) % 2][(left + j) % 2] for j in (0, 1)] for i in (0, 1)]


def _balance(image: Members) -> tuple[float, float, float]:
    """Return the camera's white balance where it has one; green is 1."""
    color = image.values.get("color")
    if not isinstance(color, dict) or "whiteBalanceGain" not in color:
        return 1.0, 1.0, 1.0
    gains = image.object("color").object("whiteBalanceGain")
    red, green, blue = (gains.number(place, 0.05, 50) for place in ("r", "gr", "b"))
    return red / green, 1.0, blue / green


def _levelled(values: NDArray[np.uint16], black: NDArray[Any], white: NDArray[Any]) -> Float32Array:
    mosaic = np.empty(values.shape, np.float32)
    for i in (0, 1):
        for j in (0, 1):
            low, high = np.float32(black[i, j]), np.float32(white[i, j])
            mosaic[i::2, j::2] = (values[i::2, j::2] - low) / (high - low)
    return np.clip(mosaic, 0.0, 1.0, out=mosaic)
