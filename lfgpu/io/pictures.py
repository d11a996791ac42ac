"""Pictures of cameras of which nothing is known, as views at positions that mean nothing yet."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.folders import image_files
from lfgpu.io.views import load_views


def load_pictures(folder: str | os.PathLike[str]) -> LightField:
    """Load the pictures of a folder, or of its folder `images`, as views at positions that mean nothing yet.

    LightFieldError if there are fewer than two, or they are not alike.

    Examples
    --------
    >>> lfgpu.calibration.load_pictures("rig").views.shape
    (25, 64, 80, 3)
    """
    path = Path(folder)
    if not path.is_dir():
        raise LightFieldError(f"{path} is not a folder with pictures.")
    files = image_files(path) or (image_files(path / "images") if (path / "images").is_dir() else [])
    if len(files) < 2:
        raise LightFieldError(f"{path} holds {len(files)} pictures; at least two are needed.")
    views, valid, notes = load_views(files)
    where = np.stack([np.arange(len(files)), np.zeros(len(files))], axis=1).astype(np.float64)
    return LightField(views, where, valid=valid, name=path.resolve().name, notes=notes, files=tuple(map(str, files)))
