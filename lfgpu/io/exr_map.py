"""Maps as OpenEXR (extra `exr`): float32 channels, and the metadata in the header."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.about import KEY, UNKNOWN_IS_NAN, map_about, map_of, parse_about
from lfgpu.io.exr import complaints

_MAGIC = b"\x76\x2f\x31\x01"


def write(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """float32 channels `disparity`, `confidence`, `uncertainty` and `Z` (depth in metres), as far as they are known."""
    import OpenEXR

    channels = {
        "disparity": values.disparity,
        "confidence": values.confidence,
        "uncertainty": values.uncertainty,
        "Z": values.depth,
    }
    said = {} if values.depth is None else {"channels": {"Z": "metres along the optical axis"}}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        KEY: map_about(values, **said, invalid=UNKNOWN_IS_NAN),
    }
    kept = {name: np.ascontiguousarray(a, np.float32) for name, a in channels.items() if a is not None}
    try:
        with OpenEXR.File(header, kept) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(None, str(error).partition(f"{path}")[2].strip(' ".') or str(error)) from error


def read(path: Path) -> DisparityMap:
    """An OpenEXR file with a channel `disparity`, or with one channel; what else of ours is there comes along."""
    import OpenEXR

    with path.open("rb") as start:
        if start.read(4) != _MAGIC:  # the library tells that on stderr, too
            raise LightFieldError(f"{path} is not an OpenEXR file, or its beginning is damaged.")
    try:
        with complaints() as said, OpenEXR.File(str(path)) as file:
            if said():
                raise ValueError("its pixels are damaged")
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
    return map_of(path, parse_about(path, text), disparity, channels.get("confidence"), channels.get("uncertainty"))
