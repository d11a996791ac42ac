"""Refocused and all-in-focus images, made from all views."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.cameras.looking import checked_map
from lfgpu.cameras.points import visible
from lfgpu.contract import Float32Array
from lfgpu.data import DepthResult, DisparityMap, LightField, check_light_field
from lfgpu.data.layout import farthest
from lfgpu.data.light_field_checks import check_number
from lfgpu.errors import LightFieldError
from lfgpu.viz.splines import CUBIC, LINEAR, colours, shifted, spline, valid_at

_HIDDEN = 0.6  # pixels in the farthest view: a surface hides only points that are farther by more
_UNLIKE = 0.05  # intensity: scale of the robust weight of colour differences
_LARGEST = 1e4  # px per view step
_SAME_CAMERA = 1e-6  # view steps


def refocus(
    lf: LightField,
    disparity: float,
    *,
    aperture: float | None = None,
    order: int = CUBIC,
) -> Float32Array:
    """Refocus on one disparity by shift and add: the image of a lens as wide as the camera array.

    Parameters
    ----------
    lf
        The light field.
    disparity
        The disparity that is in focus, pixels per view step, within ±10000.
    aperture
        Radius of the lens, view steps, >= 0: views whose cameras are farther from the reference camera are left out.
        Default None: all views.
    order
        How colours between pixels are found: 3 (default), cubic splines; 1, bilinear, faster and a little softer.

    Returns
    -------
    float32 [y, x, c] in [0, 1], of the reference view: the mean over the views whose frame and mask hold the pixel,
    each shifted by -disparity * (du, dv). Intensities are averaged as they are stored. 0 where no view is valid.

    Raises
    ------
    LightFieldError
        If the disparity is not finite, or an option is out of its range.

    Examples
    --------
    >>> lfgpu.refocus(lf, 1.2, aperture=1.5).shape
    (64, 80, 3)
    """
    check_light_field(lf)
    check_number("the disparity to focus on", disparity, -_LARGEST, _LARGEST)
    _check_order(order)
    total, count = np.zeros((*lf.size, lf.channels), np.float32), np.zeros(lf.size, np.float32)
    for n in within(lf, aperture):
        move = tuple(-disparity * lf.offsets[n, axis] for axis in (1, 0))
        picture = lf.views[n] if order == LINEAR else np.moveaxis(spline(lf.image(n)), 0, 2)
        where, colour = shifted(picture, move, order)
        if lf.valid is not None:
            seen = shifted(lf.valid[n][..., None], move, LINEAR)[1][..., 0] > 1 - 1e-3
            colour *= seen[..., None]
            count[where] += seen
        else:
            count[where] += 1
        total[where] += colour * np.float32(lf.scale if order == LINEAR else 1)
    return np.clip(total / np.maximum(count, 1)[..., None], 0, 1).astype(np.float32)


def all_in_focus(
    lf: LightField,
    result: DepthResult | DisparityMap,
    *,
    order: int = CUBIC,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Float32Array:
    """Render the reference view from all views: sharp everywhere, and with less noise than the recorded view.

    Parameters
    ----------
    lf
        The light field.
    result
        The map of its reference view.
    order
        As for `refocus`.
    backend, device
        As for `estimate_depth`; they find occlusions.

    Returns
    -------
    float32 [y, x, c] in [0, 1]: the mean over the views that see a pixel, each looked up where its disparity says.
    Colours r that are unlike that of the reference view, by the root mean square over the channels, weigh
    1 / (1 + (r / 0.05)²)²: a map is wrong here and there. 0 where no view is valid.

    Raises
    ------
    LightFieldError
        If the map is not of the reference view, or an option is out of its range.
    BackendError
        If the backend or the device is missing.

    Examples
    --------
    >>> lfgpu.all_in_focus(lf, result).shape
    (64, 80, 3)
    """
    check_light_field(lf)
    _check_order(order)
    disparity = checked_map(lf, result)
    place = open_device(backend, device)
    known = np.isfinite(disparity)
    disparity = np.where(known, disparity, np.float32(0))
    rows, columns = np.indices(lf.size)
    with place.asking():
        seen = visible(disparity, lf.offsets, rows, columns, place, tolerance=_HIDDEN / farthest(lf.offsets))
    reference = lf.image(lf.reference_index)
    trusted = np.ones(known.shape, np.bool_) if lf.valid is None else lf.valid[lf.reference_index]
    y, x = rows.astype(np.float32), columns.astype(np.float32)
    total, weights = np.zeros_like(reference), np.zeros(known.shape, np.float32)
    for n, sees in enumerate(seen):
        du, dv = lf.offsets[n].astype(np.float32)
        at = np.stack([y - disparity * dv, x - disparity * du])
        weight = np.where(known, sees, n == lf.reference_index).astype(np.float32)
        if lf.valid is not None:
            weight = weight * valid_at(lf.valid[n], at)
        picture = np.moveaxis(lf.image(n), 2, 0) if order == LINEAR else spline(lf.image(n))
        colour = colours(picture, at, order)
        away = colour - reference
        unlike = np.where(trusted, np.einsum("yxc,yxc->yx", away, away) / np.float32(lf.channels * _UNLIKE**2), 0)
        weight = weight / (1 + unlike) ** 2
        total += weight[..., None] * colour
        weights += weight
    return np.clip(total / np.maximum(weights, 1e-12)[..., None], 0, 1).astype(np.float32)


def within(lf: LightField, aperture: float | None) -> NDArray[np.intp]:
    """Choose the views of a lens of a radius in view steps, None for all; returns indices, the reference among them."""
    if aperture is None:
        return np.arange(len(lf.views))
    check_number("aperture (view steps)", aperture, 0)
    return np.flatnonzero(np.hypot(*lf.offsets.T) <= aperture + _SAME_CAMERA)


def _check_order(order: int) -> None:
    if order not in (LINEAR, CUBIC):
        raise LightFieldError(f"order must be {LINEAR} (bilinear) or {CUBIC} (cubic splines), not {order}.")
