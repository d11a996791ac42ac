"""Maps as OpenEXR (extra `exr`): float32 channels, and the metadata in the header."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.about import KEY, UNKNOWN_IS_NAN, map_about, map_of, parse_about
from lfgpu.io.exr import read_channels


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
