"""The row of raw captures in the table of formats: recognised, read, and kept decoded for the next time."""

import hashlib
import json
import os
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.data import Inside, LightField
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.io import lytro, pillow
from lfgpu.io.atomic import atomic_write
from lfgpu.io.folders import IMAGE_SUFFIXES
from lfgpu.io.images import read_image
from lfgpu.io.lenslet import capture
from lfgpu.io.lytro.container import is_container

_ROOM = 2**30  # bytes of all that are kept; the ones that were used longest ago go first


def folder() -> Path:
    """Return where captures are kept: `lfgpu` in $XDG_CACHE_HOME, or in ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lfgpu" / "decoded"


def kept(path: Path, make: Callable[[], LightField]) -> LightField:
    """Return what the same code made of the same contents and name before, or make it and keep it.

    What cannot be kept, or read again, is made: nothing is lost but time.
    """
    try:
        place = folder() / f"{_digest(path)}.npz"
    except OSError:
        return make()  # which says what is wrong
    with suppress(OSError, ValueError, KeyError, zipfile.BadZipFile, LfgpuError):
        found = _read(place)
        os.utime(place)
        return found
    light_field = make()
    with suppress(OSError, LfgpuError):
        place.parent.mkdir(parents=True, exist_ok=True)
        _write(light_field, place)
        _make_room(place.parent)
    return light_field


def _digest(path: Path) -> str:
    found = hashlib.sha256(path.stem.encode())
    for file in (path, *sorted(Path(__file__).parent.glob("*.py"))):
        found.update(str(file.stat().st_size).encode())
        found.update(file.read_bytes())
    return found.hexdigest()


def _write(lf: LightField, path: Path) -> None:
    about = {"reference": lf.reference_index, "grid_shape": lf.grid_shape, "name": lf.name, "notes": lf.notes}
    masks: dict[str, Any] = {} if lf.valid is None else {"valid": lf.valid}
    with atomic_write(path) as file:
        np.savez(file, views=lf.views, positions=lf.positions, about=np.array(json.dumps(about)), **masks)


def _read(path: Path) -> LightField:
    with np.load(path, allow_pickle=False) as held:
        about = json.loads(str(held["about"]))
        about |= {name: tuple(about[name]) for name in ("grid_shape", "notes")}
        return LightField(held["views"], held["positions"], valid=held.get("valid"), **about)


def _make_room(place: Path) -> None:
    files = sorted(place.glob("*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
    sizes = np.cumsum([file.stat().st_size for file in files])
    for file, size in zip(files[1:], sizes[1:], strict=True):  # the newest one stays, whatever its size
        if size > _ROOM:
            file.unlink(missing_ok=True)


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
    if not (path.suffix.lower() in IMAGE_SUFFIXES and _may_be_a_sensor(path)):
        return None
    lattice = _lattice(path)
    return None if lattice is None else f"it is a grey picture of microlenses, {lattice}"


def read_lenslet(path: Path) -> LightField:
    """Read the light field of a raw capture, decoded as by `decode.decode` or kept from the last time."""
    from lfgpu.io.lenslet.decode import decode  # scipy is not for those who read something else

    return kept(path, lambda: decode(path).light_field)


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
