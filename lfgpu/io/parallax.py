"""Which way views move: the direction in which camera numbers count, told from the pictures themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField

_SMALLEST = 32  # pixels: smaller views tell nothing
_BLOCK = 4  # pixels of the shrunken views in which one disparity is taken for constant
_AROUND = 160  # pixels to which the longer side of the views is shrunk, so that most shifts are below a pixel
_SURE = 0.35  # correlation from which two sets of disparities agree, or are opposed


def measured(light_field: LightField, axis: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Rough disparities of blocks of the reference view along one axis of the cameras (0 is u, 1 is v).

    Returns
    -------
    (disparity, contrast), each [blocks y, blocks x]; None where no camera stands beside the reference on that axis, or
    the views are too small. A view at offset o is the reference moved by -d o, to first order; d follows from
    differences over gradients (Lucas and Kanade).
    """
    factor = max(1, max(light_field.size) // _AROUND)
    if min(light_field.size) < max(_SMALLEST, _BLOCK * factor):
        return None
    line = light_field.row() if axis == 0 else light_field.column()
    offsets = light_field.offsets[line, axis]
    beside = np.flatnonzero(np.abs(offsets) > 0)
    if not len(beside):
        return None
    nearest = beside[np.argmin(np.abs(offsets[beside]))]
    centre, other = (_grey(light_field, index, factor) for index in (light_field.reference_index, int(line[nearest])))
    gradient = np.gradient((centre + other) / 2, axis=1 - axis)
    bottom = _blocks(gradient**2)
    top = _blocks(gradient * (other - centre) / offsets[nearest])
    return factor * top / np.maximum(bottom, 1e-12), bottom


def agreement(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]], weight: NDArray[np.floating[Any]]) -> float:
    """Weighted correlation, -1 to 1, of two sets of disparities about zero: negative if they have opposite signs."""
    scale = np.sqrt((weight * a * a).sum() * (weight * b * b).sum())
    return float((weight * a * b).sum() / scale) if scale > 0 else 0.0


def axes_agree(light_field: LightField) -> bool | None:
    """Whether parallax along rows and along columns of cameras has one sign; None if the pictures do not tell."""
    across, down = measured(light_field, 0), measured(light_field, 1)
    if across is None or down is None:
        return None
    return _verdict(agreement(across[0], down[0], np.minimum(across[1], down[1])))


def runs_as_truth(light_field: LightField, axis: int) -> bool | None:
    """Whether parallax along an axis has the sign of the ground truth of the reference view; None if not to be told."""
    found, truth = measured(light_field, axis), light_field.reference_truth()
    if found is None or truth is None:
        return None
    factor = max(1, max(light_field.size) // _AROUND)
    disparity = np.nan_to_num(truth.disparity.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    return _verdict(agreement(found[0], _blocks(_shrunk(disparity, factor)), found[1]))


def _verdict(correlation: float) -> bool | None:
    return None if abs(correlation) < _SURE else correlation > 0


def _grey(light_field: LightField, index: int, factor: int) -> NDArray[np.float64]:
    sums = light_field.views[index].sum(axis=2, dtype=np.float64)
    return _shrunk(sums * (light_field.scale / light_field.channels), factor)


def _shrunk(image: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    height, width = (side // factor for side in image.shape)
    cut = image[: height * factor, : width * factor]
    return np.asarray(cut.reshape(height, factor, width, factor).mean(axis=(1, 3)))


def _blocks(image: NDArray[np.float64]) -> NDArray[np.float64]:
    return _shrunk(image, _BLOCK)
