"""Videos, decoded by ffmpeg in a process of its own, and those of a camera that moves along a rail (extra `video`)."""

from collections.abc import Generator
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import field_of, grid_shape, positions
from lfgpu.io.damage import check_memory, require
from lfgpu.io.folders import head

_CONTAINERS = "matroska,webm,mov,mp4,avi"  # MKV and WebM; MP4 and MOV; AVI


def frames(file: Path, *, name: Path | None = None, demuxer: str | None = None) -> Generator[NDArray[np.uint8]]:
    """Yield the frames of a video, uint8 [y, x, 3]; messages say `name`; `demuxer` is ffmpeg's for a bare stream."""
    path = name or file
    ffmpeg = require("imageio_ffmpeg", "video", path)
    # Nothing but files, and no playlists: what is in the file must not reach out to others.
    inputs = ["-protocol_whitelist", "file", "-format_whitelist", demuxer or _CONTAINERS]
    inputs += ["-f", demuxer] if demuxer else []
    reader = ffmpeg.read_frames(str(file.resolve()), input_params=inputs, output_params=["-fps_mode", "passthrough"])
    try:
        width, height = next(reader)["size"]
        for data in reader:
            yield np.frombuffer(data, np.uint8).reshape(height, width, 3)
    except LightFieldError:
        raise
    except Exception as error:  # what ffmpeg writes on damaged files is long: the last line says why
        reason = str(error).strip().splitlines()[-1:] or [type(error).__name__]
        raise LightFieldError(
            f"{path} cannot be read as a video: {' '.join(reason[0].split()).rstrip('.')}."
        ) from error
    finally:
        reader.close()


_ADVICE = "take one frame of several with every=10 (--every 10 on the command line)"


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a video; None if it is not."""
    start = head(path, 12)
    if start[4:8] == b"ftyp":
        return "it begins as MP4 and MOV files do"
    if start[:4] == b"\x1a\x45\xdf\xa3":
        return "it begins as MKV and WebM files do"
    return "it begins as AVI files do" if start[:4] == b"RIFF" and start[8:] == b"AVI " else None


def read_video(path: Path, *, grid: tuple[int, int] | None = None, every: int | None = None) -> LightField:
    """Read the frames of a video whose camera moves right in equal steps, down with a grid (n, 1); one of `every`."""
    if recognise(path) is None:
        raise LightFieldError(f"{path} is not a video file that can be read; known are MP4, MOV, MKV, WebM and AVI.")
    taken: list[NDArray[np.uint8]] = []
    for frame in islice(frames(path), 0, None, every or 1):
        check_memory(path, 2 * (len(taken) + 1) * frame.nbytes, advice=_ADVICE)  # twice: they are stacked
        taken.append(frame)
    if len(taken) < 2:
        raise LightFieldError(f"{path} has {len(taken)} frames to take; depth needs at least two views of the scene.")
    shape = (1, len(taken)) if grid is None else grid_shape(path, len(taken), grid)
    note = f"Frames are taken for a camera that moves {'down' if shape[1] == 1 else 'to the right'} in equal steps."
    return field_of(path, np.stack(taken), positions(shape), grid_shape=shape, notes=(note,))
