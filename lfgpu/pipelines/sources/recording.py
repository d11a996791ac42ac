"""Frames written as they come, so that they can be played again: `lfgpu live FOLDER`."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.data import interop
from lfgpu.data.lightfield import LightField
from lfgpu.io.atomic import atomic_folder
from lfgpu.io.description import DEFAULT_NAME, write_description
from lfgpu.pipelines.sources.base import Frames

_NAME = "frame_{:06d}"
VIEWS_FILE = "views.npz"


def recorded(frames: Frames, first: LightField, folder: Path, *, wanted: Callable[[], bool] = lambda: True) -> Frames:
    """The same frames; each is written before it is handed on, to a folder of its own in `folder`, whole or not at all.

    Cameras without a picture are left out. Frames that do not fit to the first one, or lack the picture of its
    reference view, are handed on, but not written; neither are those before which `wanted` returns False.
    """
    for number in itertools.count():
        try:
            frame = next(frames)
        except StopIteration:
            return
        lf = _light_field(frame, first) if wanted() else None
        if lf is not None:
            with atomic_folder(folder / _NAME.format(number)) as place:
                masks: dict[str, Any] = {} if lf.valid is None else {"valid": lf.valid}
                np.savez(place / VIEWS_FILE, views=lf.views, positions=lf.positions, **masks)
                write_description(lf, place / DEFAULT_NAME, source={"path": place / VIEWS_FILE, "format": "numpy"})
        yield frame


def _light_field(frame: Any, first: LightField) -> LightField | None:
    """A frame as a light field, without truth; None if it does not fit to the first one."""
    if isinstance(frame, LightField):
        return replace(frame, truth=None)
    views, valid = frame if isinstance(frame, tuple) and len(frame) == 2 else (frame, None)
    try:
        found = interop.on_host("views", views).reshape(first.views.shape)
        there = np.ones(len(found), bool) if valid is None else np.asarray(valid, bool)
        if found.dtype != first.views.dtype or not there[first.reference_index]:
            return None
        whole = replace(first, views=found, truth=None, files=())
        return whole if there.all() else whole.subset([int(index) for index in np.flatnonzero(there)])
    except Exception:  # whatever is wrong with it, the stream says so
        return None
