"""Many image files as one array of views, in memory or on disk, refused if they are not alike."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import check_no_inputs
from lfgpu.io.disk import Collected
from lfgpu.io.folders import image_files
from lfgpu.io.images import read_view
from lfgpu.io.reporting import listener, within
from lfgpu.threads import in_threads

_DECODED = 2**28  # bytes that decoders may take at once,
_COPIES = 3  # of which each has a view so many times

_OUTPUTS: ContextVar[Collection[Path]] = ContextVar("files that will be written", default=())


def before_writing(outputs: Collection[Path]) -> AbstractContextManager[object]:
    """Have readers in this block raise LightFieldError, before they decode a view, if an output would replace one."""
    return within(_OUTPUTS, outputs)


def load_views(
    files: Sequence[Path], needed: Iterable[int] | None = None
) -> tuple[NDArray[Any], NDArray[np.bool_] | None, tuple[str, ...]]:
    """Read image files, by default all, alike in size, colour and type, into one array in their order.

    Returns views [n, y, x, c] as stored; bool [n, y, x], False where they are transparent, None if nothing is, or
    everything; and a sentence for each kind of conversion.
    """
    check_no_inputs(_OUTPUTS.get(), files)
    files = files if needed is None else [files[index] for index in needed]
    first, alpha, remarks = read_view(files[0])
    masks: list[NDArray[np.bool_] | None] = [None] * len(files)
    masks[0] = alpha
    try:
        views = Collected(files[0].parent, len(files), first)
    except MemoryError as error:
        raise LightFieldError(
            f"{files[0].parent}: {len(files)} views, each {_kind(first)}, do not fit into memory; read fewer views."
        ) from error
    views.put(0, first)

    tell, done = listener(), count(2)  # threads of a pool have no listener of their own

    def read(index: int) -> frozenset[str]:
        image, masks[index], remarks = read_view(files[index])
        if image.shape != first.shape or image.dtype != first.dtype:
            raise LightFieldError(
                f"the views in {files[index].parent} are not alike: {files[0].name} is {_kind(first)}, "
                f"{files[index].name} is {_kind(image)}; all views must have one size, colour and depth of bits."
            )
        views.put(index, image)
        tell(f"{next(done)} of {len(files)} views")
        return remarks

    counts = Counter(remarks)
    at_once = max(1, _DECODED // (_COPIES * first.nbytes))
    for remarks in in_threads(read, range(1, len(files)), most=at_once):
        counts.update(remarks)
    notes = tuple(
        f"{remark[0].upper()}{remark[1:]} in {often} of {len(files)} views." for remark, often in sorted(counts.items())
    )
    if all(mask is None or mask.all() for mask in masks):
        return views.array(), None, notes
    valid = np.stack([np.ones(views.shape[1:3], np.bool_) if mask is None else mask for mask in masks])
    if not valid.any():
        return views.array(), None, (*notes, "All pixels are transparent, so transparency is not taken for a mask.")
    return views.array(), valid, (*notes, f"Transparent pixels are not valid: {100 * (1 - valid.mean()):.1f} %.")


def _kind(image: NDArray[Any]) -> str:
    height, width, channels = image.shape
    return f"{width} x {height} {'grey' if channels == 1 else 'RGB'} {image.dtype}"


def load_pictures(folder: str | os.PathLike[str]) -> LightField:
    """Load the pictures of a folder, or of its folder `images`, as views at positions that mean nothing yet.

    LightFieldError if there are fewer than two, or they are not alike.

    Examples
    --------
    >>> lfgpu.calibration.load_pictures("rig").views.shape
    (25, 64, 80, 3)
    """
    path = named(folder)
    if not path.is_dir():
        raise LightFieldError(f"{path} is not a folder with pictures.")
    files = image_files(path) or (image_files(path / "images") if (path / "images").is_dir() else [])
    if len(files) < 2:
        raise LightFieldError(f"{path} holds {len(files)} pictures; at least two are needed.")
    views, valid, notes = load_views(files)
    where = np.stack([np.arange(len(files)), np.zeros(len(files))], axis=1).astype(np.float64)
    return LightField(views, where, valid=valid, name=path.resolve().name, notes=notes, files=tuple(map(str, files)))
