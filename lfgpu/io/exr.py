"""OpenEXR files of many channels (extra `exr`)."""

from __future__ import annotations

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

from lfgpu.errors import LightFieldError
from lfgpu.io.extras import require
from lfgpu.io.folders import head
from lfgpu.io.git_lfs import check_fetched
from lfgpu.io.limits import check_claim

_MAGIC = b"\x76\x2f\x31\x01"
_MOST_CHANNELS = 100
_OUTPUTS = threading.Lock()


def read_channels(path: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """The channels of an OpenEXR file by name, each float32 [y, x] as stored (NaN and infinities included); its header.

    LightFieldError if OpenEXR is missing, or the file is none, damaged, or claims more than it can hold.
    """
    exr = require("OpenEXR", "exr", path)
    if head(path, 4) != _MAGIC:  # the library tells that on stderr, too
        check_fetched(path)
        raise LightFieldError(f"{path} is not an OpenEXR file, or its beginning is damaged.")
    try:
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
    except LightFieldError:
        raise
    except Exception as error:  # the library raises whatever comes to it when a file is damaged
        raise LightFieldError(
            f"{path} cannot be read as OpenEXR: {' '.join(str(error).split()).rstrip('.')}."
        ) from error


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


def _pixels(channel: Any, shape: tuple[int, int]) -> NDArray[np.float32]:
    values = np.asarray(channel.pixels)
    if values.shape != shape:
        raise ValueError(f"a channel is {values.shape}, not {shape}")
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32)
