"""Rendered images as files: one as PNG or TIFF, many as GIF, MP4 or a folder of PNGs."""

import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lfgpu.contract import Float32Array
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_folder, atomic_write, check_no_others
from lfgpu.io.damage import require
from lfgpu.io.png import quantised, write_png

_FPS = 15.0
_QUALITY = 8  # of 10
_FRAME = "frame_{:03d}.png"
_FRAMES = re.compile(r"frame_\d+\.png")


def write_image(image: Float32Array, path: str | os.PathLike[str], *, dtype: Any = np.uint8) -> None:
    """Write an image, float32 [y, x, c] in [0, 1], as .png (`dtype` uint8, uint16) or .tif; whole or not at all."""
    path = named(path)
    check_image_path(path)
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".png":
            write_png(temporary, quantised(image, dtype))
        else:
            import tifffile

            grey = image.shape[2] == 1
            tifffile.imwrite(temporary, image[..., 0] if grey else image, photometric="minisblack" if grey else "rgb")


def check_image_path(path: str | os.PathLike[str]) -> None:
    """Raise LightFieldError if `write_image` could not write such a file."""
    path = named(path)
    if path.suffix.lower() not in (".png", ".tif", ".tiff"):
        raise LightFieldError(f"{path} cannot be written: an image is stored as .png or .tif; choose one of these.")
    if path.suffix.lower() != ".png":
        require("tifffile", "tiff", path)


def write_frames(
    frames: Iterable[Float32Array], path: str | os.PathLike[str], *, fps: float = _FPS, dtype: Any = np.uint8
) -> None:
    """Write images of one size, float32 [y, x, c] in [0, 1], as a film; whole or not at all.

    A path is .gif, which repeats for ever; .mp4 (H.264), which cuts an odd row or column off; or without a suffix a
    folder of frame_000.png and so on, of a `dtype`. LightFieldError if the folder holds more frames of another film.
    """
    path = named(path)
    check_frames_path(path)
    if not 0.1 <= fps <= 100:
        raise LightFieldError(f"frames per second must be 0.1 to 100, not {fps}.")
    if path.suffix:
        writer = _FILMS[path.suffix.lower()]
        with atomic_write(path) as temporary:
            writer(frames, temporary, fps)
        return
    with atomic_folder(path) as folder:
        for index, frame in enumerate(frames):
            write_png(folder / _FRAME.format(index), quantised(frame, dtype))
        check_no_others(path, {file.name for file in folder.iterdir()}, _FRAMES)


def check_frames_path(path: str | os.PathLike[str], count: int | None = None) -> None:
    """Raise LightFieldError if `write_frames` could not write such a file, or a folder of `count` frames."""
    path = named(path)
    if path.suffix and path.suffix.lower() not in _FILMS:
        raise LightFieldError(
            f"{path} cannot be written: a film is stored as .gif or .mp4, or without a suffix as a folder of PNGs."
        )
    if not path.suffix and count is not None:
        check_no_others(path, {_FRAME.format(index) for index in range(count)}, _FRAMES)
    if path.suffix.lower() == ".mp4":
        require("imageio_ffmpeg", "video", path)


def _write_gif(frames: Iterable[Float32Array], path: Path, fps: float) -> None:
    # Of the ways to choose 256 colours the one that keeps rare ones: a small yellow thing stays yellow.
    pictures = [Image.fromarray(_colour(frame)).quantize(256, Image.Quantize.MAXCOVERAGE) for frame in frames]
    duration = max(20, 10 * round(100 / fps))  # ms; GIF counts in hundredths of a second
    pictures[0].save(path, format="GIF", save_all=True, append_images=pictures[1:], duration=duration, loop=0)


def _write_mp4(frames: Iterable[Float32Array], path: Path, fps: float) -> None:
    from imageio import v2 as imageio  # slow to import, and rarely needed

    coding: dict[str, Any] = {"codec": "libx264", "pixelformat": "yuv420p", "quality": _QUALITY, "macro_block_size": 2}
    film: Any = imageio.get_writer(path, format="FFMPEG", fps=fps, ffmpeg_log_level="fatal", **coding)
    with film:
        for frame in frames:
            if min(frame.shape[:2]) < 2:
                raise LightFieldError(f"{path} cannot be written: its images are 1 px wide or high; write .gif.")
            try:
                film.append_data(_colour(frame)[: len(frame) // 2 * 2, : frame.shape[1] // 2 * 2])
            except OSError:  # ffmpeg has ended
                break
    if not (path.exists() and b"moov" in path.read_bytes()):  # its table of contents, which ffmpeg writes last
        raise OSError(None, "ffmpeg could not finish it; perhaps the disk is full")


_FILMS: dict[str, Callable[[Iterable[Float32Array], Path, float], None]] = {".gif": _write_gif, ".mp4": _write_mp4}


def _colour(image: Float32Array) -> NDArray[np.uint8]:
    return np.ascontiguousarray(np.broadcast_to(quantised(image, np.uint8), (*image.shape[:2], 3)))
