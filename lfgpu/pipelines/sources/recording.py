"""Recording of frames as they come, so that they can be played again: `lfgpu live FOLDER`."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField, interop
from lfgpu.io.atomic import atomic_folder
from lfgpu.io.description import DEFAULT_NAME, write_description
from lfgpu.pipelines.sources.base import Frames

_NAME = "frame_{:06d}"
VIEWS_FILE = "views.npz"


def recorded(frames: Frames, first: LightField, folder: Path, *, wanted: Callable[[], bool] = lambda: True) -> Frames:
    """Hand on frames; each is first written to a folder of its own in `folder`, whole or not at all.

    Cameras without a picture are left out. Frames that do not fit to the first one, or lack the picture of its
    reference view, are handed on, but not written; neither are those before which `wanted` returns False.
    """
    for number, frame in enumerate(frames):
        lf = _light_field(frame, first) if wanted() else None
        if lf is not None:
            with atomic_folder(folder / _NAME.format(number)) as place:
                masks: dict[str, Any] = {} if lf.valid is None else {"valid": lf.valid}
                np.savez(place / VIEWS_FILE, views=lf.views, positions=lf.positions, **masks)
                write_description(lf, place / DEFAULT_NAME, source={"path": place / VIEWS_FILE, "format": "numpy"})
        yield frame


def reference_view(frame: Any, first: LightField) -> NDArray[Any] | None:
    """Take the reference view [y, x, c] of a frame, on the host; None if the frame does not fit to the first one."""
    found = _pictures(frame, first)
    return None if found is None else found[0][first.reference_index]


def _light_field(frame: Any, first: LightField) -> LightField | None:
    """Make a frame a light field, without truth and files; None if it does not fit to the first one."""
    if isinstance(frame, LightField):
        return replace(frame, truth=None, files=())
    if (found := _pictures(frame, first)) is None:
        return None
    views, there = found
    try:
        whole = replace(first, views=views, truth=None, files=())
        return whole if there.all() else whole.subset([int(index) for index in np.flatnonzero(there)])
    except Exception:  # whatever is wrong with it, the stream says so
        return None


def _pictures(frame: Any, first: LightField) -> tuple[NDArray[Any], NDArray[np.bool_]] | None:
    """Take the views of a frame and their mask; None if they do not fit to the first one, or lack the reference."""
    views, valid = frame if isinstance(frame, tuple) and len(frame) == 2 else (frame, None)
    try:
        found = interop.on_host("views", views.views if isinstance(views, LightField) else views)
        found = found.reshape(first.views.shape)
        there = np.ones(len(found), bool) if valid is None else np.asarray(valid, bool)
        return (found, there) if found.dtype == first.views.dtype and there[first.reference_index] else None
    except Exception:  # whatever is wrong with it, the stream says so
        return None
