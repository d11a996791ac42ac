"""The light fields of the pipelines: ray-cast, with exact truth, made once for all backends."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.cases import Case
from lfgpu import GroundTruth, LightField, scenes

_SCENE = "boxes"


def make(case: Case, path: Path) -> None:
    """Cast the case's light field and write it to `path` (.npz)."""
    lf = scenes.make(_SCENE, grid=case.grid, size=case.size)
    assert lf.truth is not None
    np.savez(path, views=lf.views.reshape(*case.grid, *lf.views.shape[1:]), truth=lf.truth.disparity)


def load(path: Path) -> LightField:
    """The light field in such a file; the truth is that of its reference view."""
    with np.load(path) as arrays:
        views, truth = arrays["views"], arrays["truth"]
    lf = LightField.from_grid(views, name=_SCENE)
    u, v = lf.positions[lf.reference_index]
    return LightField.from_grid(views, name=_SCENE, truth=GroundTruth(truth, (float(u), float(v))))
