"""Maps with metadata: 16-bit PNG, float TIFF, OpenEXR and .npz, each written to a path that is there to be written."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.PngImagePlugin import PngInfo

from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import pillow
from lfgpu.io.about import KEY, map_about, map_of, parse_about
from lfgpu.io.extras import how_to_install
from lfgpu.io.images import read_image
from lfgpu.io.numpy_arrays import load_arrays

NPZ_KEY = "lfgpu_map"
"""The array of an .npz that holds the metadata of a map by itself."""

_MAP_KEY = "disparity"  # the array of an .npz that is taken for the map

_UNKNOWN, _LEVELS = 0, 65534  # of a PNG: what pixels that are not known have, and the steps between the least and most
_DESCRIPTION_TAG = 270
_EXR_MAGIC = b"\x76\x2f\x31\x01"
_INVALID = "NaN is not known"


def write_png(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """16-bit grey: disparity = offset + scale * value, 0 where it is not known; the error is at most scale / 2."""
    known = np.isfinite(values.disparity)
    low, high = (float(f(values.disparity[known])) if known.any() else 0.0 for f in (np.min, np.max))
    scale = (high - low) / _LEVELS or 1.0
    stored = np.zeros(known.shape, np.uint16)
    stored[known] = 1 + np.rint((values.disparity[known].astype(np.float64) - low) / scale)
    about = map_about(
        values, scale=scale, offset=low - scale, formula="disparity = offset + scale * value", invalid="0 is not known"
    )
    text = PngInfo()
    text.add_text(KEY, about)
    Image.fromarray(stored).save(path, format="PNG", pnginfo=text)


def read_png(path: Path) -> DisparityMap:
    """What `write_png` wrote; another PNG is refused, as it does not say what its values mean."""
    stored, _ = read_image(path)
    with pillow.opened(path) as image:
        text = getattr(image, "text", {}).get(KEY)
    if text is None or stored.dtype != np.uint16 or stored.shape[2] != 1:
        raise LightFieldError(
            f"{path} is not a kind of map that can be read: a PNG has to have 16 bits, one channel and a text "
            f"{KEY!r} that says what its values mean; give a .pfm, .npy, .npz, .tif or .exr."
        )
    about = parse_about(path, text)
    try:
        disparity = float(about["offset"]) + float(about["scale"]) * stored[..., 0].astype(np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise LightFieldError(f"{path} is a damaged map of lfgpu: its metadata are incomplete.") from error
    return map_of(path, about, np.where(stored[..., 0] == _UNKNOWN, np.nan, disparity).astype(np.float32), None)


def write_tiff(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """float32, with the metadata as the description of the image."""
    tags = {_DESCRIPTION_TAG: map_about(values, invalid=_INVALID)}
    Image.fromarray(np.asarray(values.disparity, np.float32)).save(path, format="TIFF", tiffinfo=tags)


def read_tiff(path: Path) -> DisparityMap:
    """A TIFF of one channel; of others than ours nothing but the values is known."""
    stored, _ = read_image(path, finite=False)
    if stored.shape[2] != 1:
        raise LightFieldError(f"{path} is a colour image; a map has one value per pixel.")
    disparity = stored[..., 0].astype(np.float32)
    text = ""
    with suppress(UnidentifiedImageError), pillow.opened(path) as image:  # kinds that Pillow does not know are not ours
        text = str(getattr(image, "tag_v2", {}).get(_DESCRIPTION_TAG, ""))
    if f'"{KEY}"' not in text:
        return DisparityMap(disparity, name=path.name)
    return map_of(path, parse_about(path, text), disparity, None)


def write_exr(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """float32 channels `disparity`, `confidence` and `Z`, the depth in metres, as far as they are known."""
    exr = open_exr(path)
    channels = {"disparity": values.disparity, "confidence": values.confidence, "Z": values.depth}
    header = {
        "compression": exr.ZIP_COMPRESSION,
        "type": exr.scanlineimage,
        KEY: map_about(values, channels={"Z": "metres along the optical axis"}, invalid=_INVALID),
    }
    kept = {name: np.ascontiguousarray(a, np.float32) for name, a in channels.items() if a is not None}
    try:
        with exr.File(header, kept) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(None, str(error).partition(f"{path}")[2].strip(' ".') or str(error)) from error


def read_exr(path: Path) -> DisparityMap:
    """An OpenEXR file with a channel `disparity`, or with one channel; confidence and metadata if they are there."""
    exr = open_exr(path)
    with path.open("rb") as start:
        if start.read(4) != _EXR_MAGIC:  # the library tells that on stderr, too
            raise LightFieldError(f"{path} is not an OpenEXR file, or its beginning is damaged.")
    try:
        with exr.File(str(path)) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
            found = file.header().get(KEY)
            text = None if found is None else str(found)  # decoded here, as it may be damaged
    except Exception as error:  # the library raises whatever comes to it when a file is damaged
        raise LightFieldError(f"{path} cannot be read as OpenEXR: {' '.join(str(error).split())}.") from error
    name = "disparity" if "disparity" in channels or len(channels) != 1 else next(iter(channels))
    if name not in channels or channels[name].ndim != 2:
        raise LightFieldError(f"{path} has no channel 'disparity'; it holds {', '.join(channels) or 'nothing'}.")
    disparity = channels[name].astype(np.float32)
    if text is None:
        return DisparityMap(disparity, name=path.name)
    return map_of(path, parse_about(path, text), disparity, channels.get("confidence"))


def open_exr(path: Path) -> Any:
    """The OpenEXR library; LightFieldError that says how to install it if it is not there."""
    if importlib.util.find_spec("OpenEXR") is None:
        raise LightFieldError(f"{path} is an OpenEXR file, which needs OpenEXR; {how_to_install('exr')}.")
    import OpenEXR

    return OpenEXR


def write_npz(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """`disparity`, `confidence` and `depth` as far as they are known, and the metadata as a text."""
    arrays = {"disparity": values.disparity, "confidence": values.confidence, "depth": values.depth}
    kept: dict[str, NDArray[Any]] = {name: array for name, array in arrays.items() if array is not None}
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **kept, **{NPZ_KEY: np.array(map_about(values, invalid=_INVALID))})


def read_numpy(path: Path) -> DisparityMap:
    """A map in .npy, or the array `disparity` of an .npz."""
    arrays = load_arrays(path, (_MAP_KEY, NPZ_KEY, "confidence"))
    loaded = arrays[_MAP_KEY]
    if loaded.ndim != 2 or loaded.dtype.kind not in "fiu" or 0 in loaded.shape:
        raise LightFieldError(f"{path} must hold numbers [y, x]; found {loaded.dtype} of shape {loaded.shape}.")
    with np.errstate(over="ignore"):
        disparity = np.asarray(loaded, np.float32)
    if NPZ_KEY not in arrays:
        return DisparityMap(disparity, name=path.name)
    return map_of(path, parse_about(path, str(arrays[NPZ_KEY])), disparity, arrays.get("confidence"))


def check_map(path: Path, read: Callable[[Path], DisparityMap]) -> DisparityMap:
    """What a reader makes of a file, its confidence of the same size; OSErrors become sentences."""
    try:
        values = read(path)
    except OSError as error:
        raise LightFieldError(f"{path} cannot be opened: {error.strerror or error}.") from error
    if values.confidence is not None and values.confidence.shape != values.disparity.shape:
        raise LightFieldError(f"{path} is damaged: its confidence has another size than its disparity.")
    return values
