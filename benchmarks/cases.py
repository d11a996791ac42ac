"""Sizes of light fields, and files that hold ray-cast light fields of these sizes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.errors import BenchmarkError
from lfgpu import GroundTruth, LightField, scenes

_SCENE = "boxes"


@dataclass(frozen=True)
class Case:
    """A light field of `grid` (rows, columns) of views of `size` (height, width) pixels in colour."""

    grid: tuple[int, int]
    size: tuple[int, int]
    default: bool = True
    """True if the case is measured when none is named."""
    tiny: bool = False
    """True if the case is small enough for the reference backend (float64 NumPy, written to be read)."""
    span: float = 3.0
    """Pixels per view step from the farthest to the nearest disparity."""

    @property
    def name(self) -> str:
        """Rows x columns x height x width, and @span if that is not the usual one."""
        return "x".join(map(str, (*self.grid, *self.size))) + ("" if self.span == Case.span else f"@{self.span:g}")

    def make(self, scene: str, **options: Any) -> LightField:
        """Make a scene of the package in this size; `options` are further ones of `scenes.make`."""
        ends = -self.span / 2, self.span / 2
        return scenes.make(scene, grid=self.grid, size=self.size, disparity_range=ends, **options)


CASES = (
    Case((3, 3), (48, 48), default=False, tiny=True),  # to see whether everything runs
    Case((5, 5), (128, 128), tiny=True),
    Case((5, 5), (256, 256)),
    Case((7, 7), (375, 375)),  # the paper's
    Case((9, 9), (512, 512)),  # the HCI benchmark's
    Case((9, 9), (960, 1280), default=False),
    Case((17, 17), (960, 1280), default=False),
)


def parse(name: str) -> Case:
    """Return the case "7x7x375x375" or "7x7x375x375@16", as it is listed in `CASES` or not; else BenchmarkError."""
    sizes, _, span = name.partition("@")
    try:
        rows, columns, height, width = (int(part) for part in sizes.split("x"))
        case = Case((rows, columns), (height, width), span=float(span or Case.span))
    except ValueError:
        raise BenchmarkError(
            f"{name!r} is no case: it must be ROWSxCOLUMNSxHEIGHTxWIDTH, or that with @SPAN."
        ) from None
    return next((listed for listed in CASES if listed.name == case.name), case)


def cast(case: Case, path: Path) -> None:
    """Cast the light field of a case and write it to `path` (.npz)."""
    lf = case.make(_SCENE)
    assert lf.truth is not None
    np.savez(path, views=lf.views.reshape(*case.grid, *lf.views.shape[1:]), truth=lf.truth.disparity)


def load(path: Path) -> LightField:
    """Read the light field in such a file; the truth is that of its reference view."""
    with np.load(path) as arrays:
        views, truth = arrays["views"], arrays["truth"]
    lf = LightField.from_grid(views, name=_SCENE)
    u, v = lf.positions[lf.reference_index].tolist()
    return replace(lf, truth=GroundTruth(truth, (u, v)))
