"""The output files of a depth estimate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfgpu.errors import LightFieldError
from lfgpu.io import DEPTH_FILE, DISPARITY_FILE, REPORT_FILE, RESULT_FILE, VIEWS_FILE, save, writable_format

if TYPE_CHECKING:
    from lfgpu.contract import Float32Array
    from lfgpu.data import DepthResult, ViewsResult

PICTURE_FILE, CONFIDENCE_FILE = "disparity.png", "confidence.png"

_MEANING = {
    DISPARITY_FILE: "float32 map, px per view step, larger is nearer",
    PICTURE_FILE: "the same as a colour picture",
    CONFIDENCE_FILE: "confidence of each pixel, 0 to 1",
    DEPTH_FILE: "float32 map, metres along the optical axis",
    RESULT_FILE: "all maps and stages, parameters, versions, timings",
}
NAMES = (*_MEANING, VIEWS_FILE, REPORT_FILE)
"""The names of all files that a run may write by itself; those of an earlier run that a new one lacks are removed."""


def write_outputs(folder: Path, result: DepthResult) -> list[tuple[str, str]]:
    """Write a result into an existing folder; returns the files as pairs (name, meaning)."""
    import numpy as np

    from lfgpu.io import write_pfm
    from lfgpu.viz.pictures import write_confidence, write_disparity

    write_pfm(folder / DISPARITY_FILE, result.disparity)
    write_disparity(result.disparity, folder / PICTURE_FILE, name=result.name)
    known = np.where(np.isnan(result.disparity), np.float32(np.nan), result.confidence)
    write_confidence(known, folder / CONFIDENCE_FILE, name=result.name)
    if result.depth is not None:
        write_pfm(folder / DEPTH_FILE, result.depth)
    save(result, folder / RESULT_FILE)
    return [(name, meaning) for name, meaning in _MEANING.items() if (folder / name).exists()]


def write_view_maps(folder: Path, result: ViewsResult) -> list[tuple[str, str]]:
    """Write the maps of all views into an existing folder; returns the files as pairs (name, meaning)."""
    save(result, folder / VIEWS_FILE)
    return [(VIEWS_FILE, f"consistent maps of all {len(result.disparities)} views")]


def check_names(option: str, names: Sequence[str]) -> None:
    """Raise LightFieldError if a name has no known suffix, names a folder, or is the name of another output."""
    for name in names:
        writable_format(name)
        if Path(name).name != name:
            raise LightFieldError(
                f"{option} must be a file name without folders, not {name!r}; the file goes into the folder of -o."
            )
        if name.lower() in NAMES:
            raise LightFieldError(
                f"{option} must not be {name!r}, because another output has that name; choose another name."
            )


def write_saved(folder: Path, names: Sequence[str], result: DepthResult, image: Float32Array) -> list[tuple[str, str]]:
    """Write a result under further names; returns the files as pairs (name, meaning)."""
    for name in names:
        save(result, folder / name, image=image)
    return [(name, writable_format(name).description) for name in names]
