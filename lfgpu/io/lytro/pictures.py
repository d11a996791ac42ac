"""Pictures and tables in the sections of a container, as arrays."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io import pillow, video
from lfgpu.io.damage import check_claim
from lfgpu.io.lytro.container import Container
from lfgpu.io.lytro.contents import DepthTable, Pictures, across

_STILL = {"jpeg": "JPEG", "png": "PNG"}
"""Representations of single pictures, and Pillow's names of them."""


def decoded(container: Container, pictures: Pictures) -> Iterator[NDArray[np.uint8]]:
    """Decode the pictures one after the other, each uint8 [y, x, 3].

    Raises
    ------
    LightFieldError
        If they are damaged, of another size or number than the container says, of a kind that is not known, or if
        imageio-ffmpeg is missing, which videos need.
    """
    check_claim(container.path, (*pictures.size, 3), np.uint8)
    if pictures.representation in _STILL:
        return (_still(container, name, pictures) for name in pictures.sections)
    if pictures.representation == "h264":
        return _video(container, pictures)
    raise LightFieldError(
        f"{container.path} has pictures stored as {pictures.representation!r}; known are jpeg, png and h264."
    )


def depth_table(container: Container, table: DepthTable) -> NDArray[np.float32]:
    """Read λ, float32 [y, x]; NaN where the file has no finite number."""
    return _table(container, table.section, table.size)


def confidence_table(container: Container, table: DepthTable) -> NDArray[np.float32] | None:
    """Read the confidence of each cell, float32 [y, x]; None if the container has none."""
    return None if table.confidence is None else _table(container, table.confidence, table.size)


def _table(container: Container, name: str, size: tuple[int, int]) -> NDArray[np.float32]:
    values = np.frombuffer(container.data(name), "<f4").reshape(size).astype(np.float32)
    values[~np.isfinite(values)] = np.nan
    return values


def _still(container: Container, name: str, pictures: Pictures) -> NDArray[np.uint8]:
    try:
        with pillow.decoding(container.data(name), _STILL[pictures.representation]) as image:
            found = (image.height, image.width)
            if found == pictures.size:
                return np.asarray(image.convert("RGB"))
    except Exception as error:  # decoders raise whatever comes to them when data are damaged
        reason = " ".join(str(error).split()).rstrip(".")
        if "BytesIO" in reason:
            reason = f"it is not {pictures.representation}"
        raise LightFieldError(f"{container.path} is damaged: a picture in it cannot be read ({reason}).") from error
    raise LightFieldError(
        f"{container.path} is damaged: a picture in it is {across(found)} px, where it says {across(pictures.size)}."
    )


def _video(container: Container, pictures: Pictures) -> Iterator[NDArray[np.uint8]]:
    video.check_available(container.path)
    count = 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pictures.h264"
        file.write_bytes(container.data(pictures.sections[0]))
        for frame in video.frames(file, name=container.path, demuxer="h264"):
            if frame.shape[:2] != pictures.size:
                raise LightFieldError(
                    f"{container.path} is damaged: a picture in it is {across(frame.shape[:2])} px, where it says "
                    f"{across(pictures.size)}."
                )
            count += 1
            if count > pictures.count:
                break
            yield frame
    if count != pictures.count:
        more = "more" if count > pictures.count else str(count)
        raise LightFieldError(
            f"{container.path} is damaged: it says that its video has {pictures.count} pictures, it has {more}."
        )
