"""Decoded captures that are kept in the user's cache: to decode one takes seconds, and it is looked at often."""

import hashlib
import json
import os
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LfgpuError
from lfgpu.io.atomic import atomic_write

_ROOM = 2**30  # bytes of all that are kept; the ones that were used longest ago go first


def folder() -> Path:
    """Return where captures are kept: `lfgpu` in $XDG_CACHE_HOME, or in ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lfgpu" / "decoded"


def kept(files: list[Path], options: object, make: Callable[[], LightField]) -> LightField:
    """Return what was made of the contents of these files before by the same code and options, or make it and keep it.

    What cannot be kept, or read again, is made: nothing is lost but time.
    """
    try:
        place = folder() / f"{_digest(files, options)}.npz"
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


def _digest(files: list[Path], options: object) -> str:
    found = hashlib.sha256(repr(options).encode())
    for file in (*files, *sorted(Path(__file__).parent.glob("*.py"))):
        found.update(str(file.stat().st_size).encode())
        found.update(file.read_bytes())
    found.update(files[0].stem.encode())  # the name of the light field
    return found.hexdigest()


def _write(lf: LightField, path: Path) -> None:
    about = {"reference": lf.reference_index, "grid_shape": lf.grid_shape, "name": lf.name, "notes": lf.notes}
    valid = np.zeros(0, np.uint8) if lf.valid is None else np.packbits(lf.valid)
    with atomic_write(path) as file:
        np.savez(file, views=lf.views, positions=lf.positions, valid=valid, about=np.array(json.dumps(about)))


def _read(path: Path) -> LightField:
    with np.load(path, allow_pickle=False) as held:
        about, views, packed = json.loads(str(held["about"])), held["views"], held["valid"]
        shape = views.shape[:3]
        valid = np.unpackbits(packed, count=int(np.prod(shape))).reshape(shape).astype(bool) if packed.size else None
        return LightField(
            views,
            held["positions"],
            reference=about["reference"],
            grid_shape=tuple(about["grid_shape"]),
            valid=valid,
            name=about["name"],
            notes=tuple(about["notes"]),
        )


def _make_room(place: Path) -> None:
    files = sorted(place.glob("*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
    sizes = np.cumsum([file.stat().st_size for file in files])
    for file, size in zip(files[1:], sizes[1:], strict=True):  # the newest one stays, whatever its size
        if size > _ROOM:
            file.unlink(missing_ok=True)
