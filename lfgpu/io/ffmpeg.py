"""Frames of a video, decoded by ffmpeg in a process of its own (extra `video`)."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.extras import require

_CONTAINERS = "matroska,webm,mov,mp4,avi"  # MKV and WebM; MP4 and MOV; AVI


def check_available(path: Path) -> Any:
    """Import imageio_ffmpeg; LightFieldError that names `path` and how to install it if it is missing."""
    return require("imageio_ffmpeg", "video", path)


def frames(file: Path, *, name: Path | None = None, demuxer: str | None = None) -> Generator[NDArray[np.uint8]]:
    """Yield the frames of a video one after the other, each uint8 [y, x, 3].

    Parameters
    ----------
    file
        The video.
    name
        What sentences call it; None is `file`.
    demuxer
        ffmpeg's name of the container, "h264" for a bare stream; None lets ffmpeg find out.

    Raises
    ------
    LightFieldError
        If imageio-ffmpeg is missing, or the file is no video or damaged.
    """
    path = name or file
    ffmpeg = check_available(path)
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
