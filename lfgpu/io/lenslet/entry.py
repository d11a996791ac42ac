"""What the table of formats needs: is it a raw capture, and its light field."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import pillow
from lfgpu.io.images import read_image
from lfgpu.io.lenslet import capture, container

_LEAST_SIDE = 256  # pixels: no sensor under microlenses is smaller
_LOOKED_AT = 1024  # pixels along each side, in the middle of a picture


def recognise(path: Path) -> str | None:
    """Why a file is taken for a raw capture; None if it is not."""
    if not path.is_file():
        return None
    if container.is_container(path):
        return "it is a container of a Lytro camera"
    if camera := capture.bare_raw(path):
        return f"it has the name and the length of a raw file of {camera}"
    if not (capture.is_image(path) and _may_be_a_sensor(path)):
        return None
    pitch = _pitch(path)
    return None if pitch is None else f"it is a grey picture of microlenses, a hexagonal grid {pitch:.2f} px apart"


def read_lenslet(
    path: str | os.PathLike[str],
    *,
    allow_missing: bool = False,
    bayer: str | None = None,
    white: str | os.PathLike[str] | None = None,
    views: int | None = None,
) -> LightField:
    """The light field of a raw capture; parameters and errors as of `decode.decode`."""
    from lfgpu.io.lenslet.decode import decode  # scipy is not for those who read something else

    return decode(path, bayer=bayer, white=white, views=views).light_field


def _may_be_a_sensor(path: Path) -> bool:
    """Whether a picture is grey and large enough, by its header."""
    try:
        with pillow.opened(path) as image:
            return image.mode in ("L", "I;16", "I;16L", "I;16B", "I", "F") and min(image.size) >= _LEAST_SIDE
    except Exception:  # whatever is wrong with it, the reader that is asked for it says so
        return False


def _pitch(path: Path) -> float | None:
    """The pitch of the microlenses in the middle of a picture, or None if there are none, or it cannot be read."""
    from lfgpu.io.lenslet.microlenses import find_peaks

    try:
        image = read_image(path)[0][..., 0]
    except LightFieldError:
        return None
    top, left = (max(0, (side - _LOOKED_AT) // 2) for side in image.shape)
    peaks = find_peaks(image[top : top + _LOOKED_AT, left : left + _LOOKED_AT].astype(np.float32))
    return None if peaks is None else float(2 / np.sqrt(3) / np.hypot(*peaks.frequencies.T).mean())
