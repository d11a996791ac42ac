"""One image file as an array: what is kept, what is converted with a remark, what is refused."""

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.TiffImagePlugin import TiffImageFile

from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io import pillow
from lfgpu.io.damage import check_claim, check_fetched, read_as
from lfgpu.io.exr import read_picture
from lfgpu.io.png import decode_fast
from lfgpu.io.tiff_pages import MAGICS, check_pages, further_pictures

ALPHA_DROPPED = "alpha channel dropped"
TURNED = "turned upright as its EXIF orientation says"
INVERTED = "inverted, as it is stored with white as 0"
FLOAT64_ROUNDED = "float64 values rounded to float32"

_WIDTH_TAG, _HEIGHT_TAG, _BITS_TAG, _INTERPRETATION_TAG, _ORIENTATION_TAG, _PLANAR_TAG = 256, 257, 258, 262, 274, 284
_WHITE_IS_ZERO = 0
_UPRIGHT: dict[int, Callable[[NDArray[Any]], NDArray[Any]]] = {
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: a.swapaxes(0, 1)[:, ::-1],
    7: lambda a: a.swapaxes(0, 1)[::-1, ::-1],
    8: lambda a: a.swapaxes(0, 1)[::-1],
}
"""From pixels as they are stored to those that are shown, by the EXIF orientation."""
_OTHER_BYTE = {"16B": "16L", "16L": "16B", "16N": "16B" if np.little_endian else "16L"}


def read_image(path: str | os.PathLike[str], *, finite: bool = True) -> tuple[NDArray[Any], frozenset[str]]:
    """Read an image file without transparency; otherwise as `read_view`, whose image and remarks it returns."""
    image, alpha, remarks = read_view(path, finite=finite)
    return image, remarks if alpha is None else remarks | {ALPHA_DROPPED}


def read_view(
    path: str | os.PathLike[str], *, finite: bool = True
) -> tuple[NDArray[Any], NDArray[np.bool_] | None, frozenset[str]]:
    """Read an image file, its values as they are stored, upright as its EXIF orientation says.

    Returns the image [y, x, c], c = 1 or 3, uint8, uint16 or float32, palettes as colours; bool [y, x], False where it
    is more transparent than not, None without transparency; and what was converted: `TURNED`, `INVERTED`,
    `FLOAT64_ROUNDED`, and what `read_picture` says. With `finite`, NaN and infinities are refused, but for OpenEXR.
    """
    path = named(path)
    with read_as(path, "an image"):
        try:
            image, converted = _decode(path)
        except UnidentifiedImageError as error:
            check_fetched(path)
            raise LightFieldError(
                f"{path} cannot be read as an image: it is none of PNG, BMP, JPEG, TIFF, WebP and PPM, or its "
                "beginning is damaged."
            ) from error
    return _normalised(path, image, converted, finite=finite)


def read_mask(path: str | os.PathLike[str]) -> NDArray[np.bool_]:
    """Read an image as a mask: bool [y, x], True where any of its colours is not zero."""
    image, _ = read_image(path)
    return np.asarray((image != 0).any(axis=2))


def mask_beside(path: Path, size: tuple[int, int]) -> NDArray[np.bool_] | None:
    """Read a mask of the size of the views where there is such a file."""
    if not path.is_file():
        return None
    mask = read_mask(path)
    check_size(path, mask, size)
    return mask


def check_size(path: Path, array: NDArray[Any], size: tuple[int, int]) -> None:
    """Raise LightFieldError unless what a file holds has the (height, width) of the views."""
    if array.shape != size:
        raise LightFieldError(
            f"{path} has {array.shape[1]} x {array.shape[0]} pixels, but the views have {size[1]} x {size[0]}; "
            "remove it or put the right one there."
        )


def image_size(path: Path) -> tuple[int, int] | None:
    """Return (height, width) by the header of an image; None if it cannot be read, as `read_image` explains."""
    try:
        with pillow.opened(path) as image:
            turned = _orientation(image) >= 5 and not isinstance(image, TiffImageFile)
            return (image.width, image.height) if turned else (image.height, image.width)
    except Exception:  # decoders raise whatever comes to them when a file is damaged
        return None


def _decode(path: Path) -> tuple[NDArray[Any], set[str]]:
    """Decode an image file to [y, x] or [y, x, c] with c = 1 to 4, in whatever dtype the file has."""
    if path.suffix.lower() == ".exr":
        return read_picture(path)
    try:
        with pillow.opened(path) as image:
            turn = _UPRIGHT.get(_orientation(image))
            remarks = set() if turn is None else {TURNED}
            inverted = False
            if isinstance(image, TiffImageFile):  # Pillow turns it, but takes grey pixels for stored as they are shown
                image._size = (image.tag_v2[_WIDTH_TAG], image.tag_v2[_HEIGHT_TAG])
                turn = None
                is_white_zero = image.tag_v2.get(_INTERPRETATION_TAG) == _WHITE_IS_ZERO
                inverted = is_white_zero and image.mode not in ("1", "L")  # which Pillow inverts
            if (pixels := decode_fast(path, image)) is None:
                if _is_misread_by_pillow(image):
                    return _decode_tiff(path)
                if isinstance(image, TiffImageFile):
                    _check_one_page(path)
                pixels = _pixels(path, image)
                if pixels.dtype == np.uint16 and "transparency" in image.info:
                    pixels = _with_alpha(pixels, image.info["transparency"])
                if inverted:
                    pixels = _inverted(pixels)
                    remarks.add(INVERTED)
            return (pixels if turn is None else turn(pixels)), remarks
    except UnidentifiedImageError:
        with path.open("rb") as file:
            if file.read(4) in MAGICS:
                return _decode_tiff(path)
        raise


def _orientation(image: Image.Image) -> int:
    """Return the orientation that an image has to be turned by, 1 to 8."""
    if isinstance(image, TiffImageFile):
        return int(image.tag_v2.get(_ORIENTATION_TAG, 1))
    if not image.info.get("exif"):
        return 1
    exif = Image.Exif()
    exif.load(image.info["exif"])
    found = exif.get(_ORIENTATION_TAG, 1)
    return found if isinstance(found, int) else 1


def _inverted(image: NDArray[Any]) -> NDArray[Any]:
    top = 1.0 if image.dtype.kind == "f" else np.iinfo(image.dtype).max
    return np.asarray(image.dtype.type(top) - image)


def _pixels(path: Path, image: Image.Image) -> NDArray[Any]:
    if getattr(image, "is_animated", False) and image.format in ("WEBP", "PNG"):
        count = getattr(image, "n_frames", 0)
        raise LightFieldError(f"{path} is an animation of {count} images; a view is one image: save it as one.")
    deep = "16" in _raw_mode(image)
    if image.mode in ("L", "RGB") and "transparency" in image.info and not deep:  # one value that is transparent
        return np.asarray(image.convert(f"{image.mode}A"))
    if image.mode in ("1", "P", "PA"):
        grey = image.mode == "1"
        return np.asarray(image.convert("L" if grey else "RGBA" if image.has_transparency_data else "RGB"))
    stored = image.tile[0][3] if image.format == "PPM" else ""  # type: ignore[attr-defined]  # raw mode, largest value
    if image.mode == "RGB" and isinstance(stored, tuple) and int(stored[1]) > 255:
        raise LightFieldError(f"{path} is a PPM of 16-bit colour, which cannot be read; save it as PNG or TIFF.")
    if image.mode == "I" and image.format in ("PNG", "PPM"):  # Pillow gives 16-bit grey in 32 bits
        return np.asarray(image).astype(np.uint16)
    if image.mode not in ("L", "LA", "RGB", "RGBA", "I;16", "I;16L", "I;16B", "F"):
        bits = "signed 16" if "16" in _raw_mode(image) else "32"
        kind = f"{bits}-bit integers" if image.mode == "I" else f"colour mode {image.mode}"
        raise LightFieldError(f"{path} has {kind}; views must be grey or RGB of 8 or 16 bits or float32: convert it.")
    if image.mode in ("RGB", "RGBA") and (raw := _raw_mode(image)).endswith(tuple(_OTHER_BYTE)):
        return _sixteen_bit_colour(path, image, raw)
    return np.asarray(image)


def _with_alpha(pixels: NDArray[Any], transparent: int | tuple[int, ...]) -> NDArray[Any]:
    """Append an alpha channel to 16-bit pixels, one value of which is transparent."""
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    alpha = (pixels != transparent).any(axis=2, keepdims=True) * np.uint16(np.iinfo(np.uint16).max)
    return np.concatenate([pixels, alpha], axis=2)


def _raw_mode(image: Image.Image) -> str:
    """Return in Pillow's words how the file stores its pixels, "RGB;16B" for example; "" where Pillow does not say."""
    tiles = getattr(image, "tile", None)
    arguments = tiles[0][3] if tiles else ""
    return str(arguments[0] if isinstance(arguments, tuple) else arguments)


def _sixteen_bit_colour(path: Path, image: Image.Image, raw: str) -> NDArray[np.uint16]:
    """Decode 16-bit colour, of which Pillow keeps the high bytes; those of the other byte order are the low ones."""
    if raw.startswith("LA"):
        raise LightFieldError(f"{path} is 16-bit grey with transparency; save it without transparency.")
    other = raw[:-3] + _OTHER_BYTE[raw[-3:]]
    with pillow.opened(path) as again:
        make: Any = getattr(type(again.tile[0]), "_make", tuple)  # named tuples since Pillow 11
        again.tile = [
            make((codec, extents, offset, (other, *raw_mode[1:]) if isinstance(raw_mode, tuple) else other))
            for codec, extents, offset, raw_mode in again.tile
        ]
        low = np.asarray(again)
    return (np.asarray(image).astype(np.uint16) << 8) | low


def _is_misread_by_pillow(image: Image.Image) -> bool:
    """Tell whether an image is a TIFF of a kind that Pillow 13 decodes without complaint to wrong values."""
    if not isinstance(image, TiffImageFile):
        return False
    sixteen_bit_planes = image.tag_v2.get(_PLANAR_TAG) == 2 and max(image.tag_v2.get(_BITS_TAG, (1,))) > 8
    big_endian_compressed_float = image.tile[0][0] == "libtiff" and _raw_mode(image).endswith("BF")
    return sixteen_bit_planes or big_endian_compressed_float


def _check_one_page(path: Path) -> None:
    if others := further_pictures(path):
        raise LightFieldError(
            f"{path} has {1 + others} pages of one size, but a view is one page: save the page that is the view alone, "
            "or as one page of RGB if the pages are its colours."
        )


def _decode_tiff(path: Path) -> tuple[NDArray[Any], set[str]]:
    """Decode a TIFF that Pillow does not know (float colour, float64) or misreads, by way of the optional tifffile."""
    if importlib.util.find_spec("tifffile") is None:
        raise LightFieldError(
            f"{path} cannot be read as an image: it is a damaged or an unusual TIFF (float colour, float64, separate "
            "planes); run 'pip install tifffile' to read the latter, or save it as PNG."
        )
    import imageio.v3 as iio  # only here, so that nobody else waits for it
    from tifffile import TiffFile

    check_pages(path)
    _check_one_page(path)
    with TiffFile(path) as file:
        for page in file.pages:
            check_claim(path, page.shape, page.dtype or np.uint8)
        tags = file.pages.first.tags
        turn = _UPRIGHT.get(tags[_ORIENTATION_TAG].value if _ORIENTATION_TAG in tags else 1)
        inverted = _INTERPRETATION_TAG in tags and tags[_INTERPRETATION_TAG].value == _WHITE_IS_ZERO
    image = np.asarray(iio.imread(path, plugin="tifffile"))
    planes_first = image.ndim == 3 and image.shape[0] in (3, 4) and image.shape[2] > 4
    image = np.moveaxis(image, 0, 2) if planes_first else image
    image, remarks = (_inverted(image), {INVERTED}) if inverted else (image, set[str]())
    return (image, remarks) if turn is None else (turn(image), remarks | {TURNED})


def _normalised(
    path: Path, image: NDArray[Any], remarks: set[str], *, finite: bool
) -> tuple[NDArray[Any], NDArray[np.bool_] | None, frozenset[str]]:
    valid = None
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] > 4 or 0 in image.shape:
        raise LightFieldError(f"{path} has the shape {image.shape}; a view must be one grey or RGB image.")
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise LightFieldError(f"{path} has {image.dtype} values; views must be uint8, uint16 or float32: convert it.")
    if image.shape[2] in (2, 4):
        image, valid = image[..., :-1], opaque(image[..., -1])
    if image.dtype == np.float64:
        image = image.astype(np.float32)
        remarks.add(FLOAT64_ROUNDED)
    if finite and image.dtype == np.float32 and not np.isfinite(image).all():
        raise LightFieldError(f"{path} has NaN or infinite values; the values of a view must be finite.")
    return image, valid, frozenset(remarks)


def opaque(alpha: NDArray[Any]) -> NDArray[np.bool_]:
    """Mark where an alpha channel is at least half of the largest value of its type."""
    return np.asarray(alpha >= (0.5 if alpha.dtype.kind == "f" else (np.iinfo(alpha.dtype).max + 1) // 2))
