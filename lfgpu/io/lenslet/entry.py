"""The row of raw captures in the table of formats: how they are recognised and read."""

import os
from pathlib import Path

from lfgpu.data.lightfield import LightField
from lfgpu.data.reading import Inside
from lfgpu.errors import LightFieldError
from lfgpu.io import lytro, pillow
from lfgpu.io.images import read_image
from lfgpu.io.lenslet import capture
from lfgpu.io.lenslet.kept import kept
from lfgpu.io.lytro.container import is_container

_LEAST_SIDE = 256  # pixels: no sensor under microlenses is smaller
_JPEG_BLOCK, _EXACT = 8.0, 0.01  # pixels: the squares that JPEG leaves in a picture, and how exact they are
_LOOKED_AT = 1024  # pixels along each side, in the middle of a picture


def recognise(path: Path) -> str | None:
    """Say why a file is taken for a raw capture; None if it is not."""
    if not path.is_file():
        return None
    if is_container(path):
        return "it is a container of a Lytro camera"
    if camera := capture.bare_raw(path):
        return f"it has the name and the length of a raw file of {camera}"
    if not (capture.is_image(path) and _may_be_a_sensor(path)):
        return None
    lattice = _lattice(path)
    return None if lattice is None else f"it is a grey picture of microlenses, {lattice}"


def read_lenslet(
    path: str | os.PathLike[str],
    *,
    bayer: str | None = None,
    white: str | os.PathLike[str] | None = None,
    views: int | None = None,
) -> LightField:
    """Read the light field of a raw capture, decoded or kept from the last time; parameters and errors as of
    `decode.decode`.
    """
    from lfgpu.io.lenslet.decode import decode  # scipy is not for those who read something else

    files = [Path(path), *([] if white is None else [Path(white)])]
    return kept(files, (bayer, views), lambda: decode(path, bayer=bayer, white=white, views=views).light_field)


def inside(path: Path) -> Inside:
    """Describe what a container holds beside its raw picture; nothing for other files."""
    return lytro.inside(path) if is_container(path) else Inside(())


def _may_be_a_sensor(path: Path) -> bool:
    """Tell by its header whether a picture is grey and large enough."""
    try:
        with pillow.opened(path) as image:
            return image.mode in ("L", "I;16", "I;16L", "I;16B", "I", "F") and min(image.size) >= _LEAST_SIDE
    except Exception:  # whatever is wrong with it, the reader that is asked for it says so
        return False


def _lattice(path: Path) -> str | None:
    """Describe the lattice of microlenses in the middle of a picture; None if there is none, or it cannot be read."""
    from lfgpu.io.lenslet.microlenses import find_microlenses
    from lfgpu.io.lenslet.spectrum import find_peaks

    try:
        image, _ = capture.scaled(read_image(path)[0][..., 0])
    except LightFieldError:
        return None
    top, left = (max(0, (side - _LOOKED_AT) // 2) for side in image.shape)
    middle = image[top : top + _LOOKED_AT, left : left + _LOOKED_AT]
    peaks = find_peaks(middle)
    if peaks is None:
        return None
    if not peaks.square:
        return f"a hexagonal lattice {peaks.pitch:.2f} px apart"
    try:  # squares are sooner there by chance: they have to be the same ones everywhere
        lenses = find_microlenses(middle, name=str(path))
    except LightFieldError:
        return None
    of_blocks = abs(lenses.pitch - _JPEG_BLOCK) < _EXACT and abs(lenses.rotation) < _EXACT
    return None if of_blocks or not lenses.square else f"a square lattice {lenses.pitch:.2f} px apart"
