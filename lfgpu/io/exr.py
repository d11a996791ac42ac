"""OpenEXR files of many channels, and maps in them (extra `exr`): float32 channels, metadata in the header."""

import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.about import KEY, UNKNOWN_IS_NAN, map_about, map_of, parse_about
from lfgpu.io.damage import check_claim, check_fetched, read_as, require
from lfgpu.io.folders import head

LINEAR, CUT = "linear colours brought to sRGB", "values brighter than white, more than 1 % of all, cut off"
UNKNOWN = "pixels that are NaN or infinite taken for transparent"

_MAGIC = b"\x76\x2f\x31\x01"
_MANY = 0.01  # of the values of a picture, so bright that surfaces may be lost
_LAYERS = ("", "Combined", "Image", "RGBA", "Depth")  # of Blender
_MOST_CHANNELS = 100
_OUTPUTS = threading.Lock()


def read_channels(path: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Read the channels by name, float32 [y, x] with NaN and infinities as they are stored, and the header."""
    exr = require("OpenEXR", "exr", path)
    if head(path, 4) != _MAGIC:  # the library tells that on stderr, too
        check_fetched(path)
        raise LightFieldError(f"{path} is not an OpenEXR file, or its beginning is damaged.")
    with read_as(path, "OpenEXR"):
        with complaints(), exr.File(str(path), separate_channels=True, header_only=True) as file:
            header = file.header()
            low, high = ([int(place) for place in corner] for corner in header["dataWindow"])
            names = len(header["channels"])
        shape = (high[1] - low[1] + 1, high[0] - low[0] + 1)
        if names > _MOST_CHANNELS or min(shape) < 1:
            raise ValueError(f"it claims {names} channels of {shape[1]} x {shape[0]} px")
        check_claim(path, (names, *shape), np.float32)
        with complaints() as said, exr.File(str(path), separate_channels=True) as file:
            if said():
                raise ValueError("its pixels are damaged")
            return {name: _pixels(channel, shape) for name, channel in file.channels().items()}, dict(file.header())


def channel(channels: dict[str, NDArray[np.float32]], *names: str) -> NDArray[np.float32] | None:
    """Return the channel of one of these names, by itself or in a layer that Blender gives it."""
    for layer in _LAYERS:
        for name in names:
            for full, values in channels.items():
                *before, last = full.split(".")
                if last == name and (before[-1:] or [""])[0] == layer:
                    return values
    return None


def read_picture(path: Path) -> tuple[NDArray[np.uint16], set[str]]:
    """Return the colours of an OpenEXR file, linear on [0, 1], by the transfer function of sRGB (IEC 61966-2-1).

    [y, x, c], c = 1 (Y), 3 (R, G, B), and one more for its alpha A, which stays linear, and what was converted. Pixels
    that are NaN or infinite are transparent, with an alpha of 0. What is brighter than white is cut off.
    LightFieldError as `read_channels`, or if it has no such channels, or no finite pixel.
    """
    channels, _ = read_channels(path)
    planes = [channel(channels, name) for name in "RGB"]
    if any(plane is None for plane in planes):
        planes = [channel(channels, "Y")]
    if any(plane is None for plane in planes):
        raise LightFieldError(f"{path} has no channels R, G and B; it has {', '.join(list(channels)[:8]) or 'none'}.")
    alpha = channel(channels, "A")
    values = np.stack([plane for plane in (*planes, alpha) if plane is not None], axis=-1)
    known = np.asarray(np.isfinite(values).all(axis=-1))
    if not known.any():
        raise LightFieldError(f"{path} has no pixel whose values are all finite numbers; render it again.")
    if alpha is None and not known.all():
        values = np.concatenate([values, np.ones_like(values[..., :1])], axis=-1)
    finite = np.where(known[..., None], values, 0.0)
    linear = np.clip(finite, 0.0, 1.0)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    if values.shape[-1] in (2, 4):
        coded[..., -1] = linear[..., -1]
    found = {LINEAR: True, UNKNOWN: not known.all(), CUT: (finite > 1).mean() > _MANY}
    return np.rint(coded * 65535).astype(np.uint16), {remark for remark, holds in found.items() if holds}


@contextmanager
def complaints() -> Iterator[Callable[[], bool]]:
    """Keep what the library prints and writes on stderr while the block runs; yields whether there was something.

    Where pixels are damaged the library says so there and goes on, with whatever it has decoded. Both belong to the
    whole process: one thread at a time, and what others write meanwhile is lost.
    """
    with _OUTPUTS, tempfile.TemporaryFile() as file, redirect_stdout(StringIO()) as printed, ExitStack() as back:
        if sys.stderr is not None:
            sys.stderr.flush()
        with suppress(OSError):  # a process without stderr
            before = os.dup(2)
            back.callback(os.close, before)
            back.callback(os.dup2, before, 2)
            os.dup2(file.fileno(), 2)
        yield lambda: bool(printed.getvalue()) or os.fstat(file.fileno()).st_size > 0


def write_map(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """Write float32 channels `disparity`, `confidence`, `uncertainty` and `Z` (depth in metres), as far as known."""
    import OpenEXR

    maps = values.known_maps
    said = {"channels": {"Z": "metres along the optical axis"}} if "depth" in maps else {}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        KEY: map_about(values, **said, invalid=UNKNOWN_IS_NAN),
    }
    kept = {"Z" if name == "depth" else name: np.ascontiguousarray(a, np.float32) for name, a in maps.items()}
    try:
        with OpenEXR.File(header, kept) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(None, str(error).partition(f"{path}")[2].strip(' ".') or str(error)) from error


def read_map(path: Path) -> DisparityMap:
    """Read an OpenEXR file with a channel `disparity`, or with one channel; what else of ours is there comes along."""
    with path.open("rb"):  # errors of the system are said by the caller
        pass
    channels, header = read_channels(path)
    name = "disparity" if "disparity" in channels or len(channels) != 1 else next(iter(channels))
    if name not in channels:
        raise LightFieldError(f"{path} has no channel 'disparity'; it holds {', '.join(channels) or 'nothing'}.")
    disparity = channels[name]
    if KEY not in header:
        return DisparityMap(disparity, name=path.name)
    if not isinstance(text := header[KEY], str):
        raise LightFieldError(f"{path} is a damaged map of lfgpu: its metadata are no text.")
    return map_of(path, parse_about(path, text), disparity, channels.get("confidence"), channels.get("uncertainty"))


def _pixels(channel: Any, shape: tuple[int, int]) -> NDArray[np.float32]:
    values = np.asarray(channel.pixels)
    if values.shape != shape:
        raise ValueError(f"a channel is {values.shape}, not {shape}")
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32)
