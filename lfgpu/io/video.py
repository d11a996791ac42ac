"""A video of a camera that moves along a rail: its frames are the views of a row (extra `video`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import ffmpeg
from lfgpu.io.arrays import field_of, grid_shape, positions
from lfgpu.io.folders import head
from lfgpu.io.limits import check_memory

_ADVICE = "take one frame of several with every=10 (--every 10 on the command line)"


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a video; None if it is not."""
    start = head(path, 12)
    if start[4:8] == b"ftyp":
        return "it begins as MP4 and MOV files do"
    if start[:4] == b"\x1a\x45\xdf\xa3":
        return "it begins as MKV and WebM files do"
    return "it begins as AVI files do" if start[:4] == b"RIFF" and start[8:] == b"AVI " else None


def read_video(
    path: Path, *, allow_missing: bool = False, grid: tuple[int, int] | None = None, every: int | None = None
) -> LightField:
    """Read the frames of a video whose camera moves to the right in equal steps.

    Parameters
    ----------
    path
        An MP4, MOV, MKV, WebM or AVI file; frames become RGB of 8 bits.
    allow_missing
        Not needed.
    grid
        (1, n) for a camera that moves right, (n, 1) for down, n the number of frames taken; None is a row.
    every
        Take one frame of so many, from the first on; None takes all.

    Raises
    ------
    LightFieldError
        If imageio-ffmpeg is missing, the file is no video or damaged, or its frames do not fit into memory.
    """
    if recognise(path) is None:
        raise LightFieldError(f"{path} is not a video file that can be read; known are MP4, MOV, MKV, WebM and AVI.")
    frames = _taken(path, every or 1)
    if len(frames) < 2:
        raise LightFieldError(f"{path} has {len(frames)} frames to take; depth needs at least two views of the scene.")
    shape = (1, len(frames)) if grid is None else grid_shape(path, len(frames), grid)
    note = f"Frames are taken for a camera that moves {'down' if shape[1] == 1 else 'to the right'} in equal steps."
    return field_of(path, np.stack(frames), positions(shape), grid_shape=shape, notes=(note,))


def _taken(path: Path, every: int) -> list[NDArray[np.uint8]]:
    taken: list[NDArray[np.uint8]] = []
    for index, frame in enumerate(ffmpeg.frames(path)):
        if index % every == 0:
            check_memory(path, 2 * (len(taken) + 1) * frame.nbytes, advice=_ADVICE)  # twice: they are stacked
            taken.append(frame)
    return taken
