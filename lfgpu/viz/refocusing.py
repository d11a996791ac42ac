"""Pictures of the reference view from all views at once: focused where one likes, or everywhere."""

from __future__ import annotations

import math

import numpy as np

from lfgpu._backends import DEFAULT, load, pick_device
from lfgpu.contract import Float32Array
from lfgpu.data.lightfield import LightField, farthest
from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.viz.splines import colours, spline, valid_at

_HIDDEN = 0.6  # pixels in the farthest view: what is nearer by less hides nothing
_UNLIKE = 0.05  # intensity: colours that differ this much are as likely of something else as not
_LARGEST = 1e4  # px per view step


def refocus(lf: LightField, disparity: float) -> Float32Array:
    """The picture that a lens as wide as all cameras together would take, focused at one disparity (shift and add).

    Parameters
    ----------
    lf
        The light field; `lf.subset` makes the lens smaller.
    disparity
        What is sharp, pixels per view step; things at other disparities are blurred by as many pixels as they would
        move between the views.

    Returns
    -------
    float32 [y, x, c] in [0, 1], of the reference view: the mean over the views whose frame and mask hold the pixel,
    each shifted by -disparity * (du, dv) with cubic splines between pixels. Intensities are averaged as they are
    stored. 0 where no view is valid.

    Raises
    ------
    LightFieldError
        If the disparity is not finite.
    """
    if not (math.isfinite(disparity) and abs(disparity) <= _LARGEST):
        raise LightFieldError(f"the disparity to focus at must be a number within ±{_LARGEST:g}, not {disparity}.")
    height, width = lf.size
    y, x = np.mgrid[:height, :width]
    total, count = np.zeros((*lf.size, lf.channels), np.float32), np.zeros(lf.size, np.float32)
    for n, (du, dv) in enumerate(lf.offsets):
        at = np.stack([y - disparity * dv, x - disparity * du])
        inside = (at[0] >= 0) & (at[0] <= height - 1) & (at[1] >= 0) & (at[1] <= width - 1)
        if not inside.any():
            continue
        if lf.valid is not None:
            inside &= valid_at(lf.valid[n], at)
        total += np.where(inside[..., None], colours(spline(lf.image(n)), at), 0)
        count += inside
    return np.clip(total / np.maximum(count, 1)[..., None], 0, 1).astype(np.float32)


def all_in_focus(
    lf: LightField, result: DepthResult | DisparityMap, *, backend: str = DEFAULT, device: str | None = None
) -> Float32Array:
    """The reference view as all views show it together: sharp everywhere, with less noise than it has itself.

    Parameters
    ----------
    lf
        The light field.
    result
        The map of its reference view.
    backend, device
        Where is found what hides what, as for `estimate_depth`.

    Returns
    -------
    float32 [y, x, c] in [0, 1]: the mean over the views that see a pixel, each looked up where its disparity says with
    cubic splines between pixels. Colours r that are unlike that of the reference view, by the root mean square over the
    channels, weigh 1 / (1 + (r / 0.05)²)²: a map is wrong here and there. 0 where no view is valid.

    Raises
    ------
    LightFieldError
        If the map is not of the reference view.
    BackendError
        If the backend or the device is not there.
    """
    if result.disparity.shape != lf.size:
        raise LightFieldError(
            f"the map has {result.disparity.shape[0]} x {result.disparity.shape[1]} pixels, the views have "
            f"{lf.size[0]} x {lf.size[1]}; give the map of {lf.name}."
        )
    u, v = lf.positions[lf.reference_index]
    if result.position is not None and not np.allclose(result.position, (u, v), atol=1e-6):
        raise LightFieldError(
            f"the map is of the view at row {result.position[1]:g}, column {result.position[0]:g}, the reference view "
            f"is at row {v:g}, column {u:g}; choose that one with with_reference."
        )
    kernels = load(backend)
    place = pick_device(kernels, device)
    disparity = np.where(np.isfinite(result.disparity), result.disparity, 0).astype(np.float32)
    visible = kernels.zeros(lf.views.shape[:3], place)
    kernels.visible(
        kernels.field(disparity, place),
        kernels.field(lf.offsets, place),
        tolerance=_HIDDEN / farthest(lf.offsets),
        visible_out=visible,
    )
    seen = kernels.numpy(visible).astype(np.float32)
    reference = lf.image(lf.reference_index)
    trusted = np.ones(lf.size, np.bool_) if lf.valid is None else lf.valid[lf.reference_index]
    height, width = lf.size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    total, weights = np.zeros_like(reference), np.zeros(lf.size, np.float32)
    for n, (du, dv) in enumerate(lf.offsets):
        at = np.stack([y - disparity * np.float32(dv), x - disparity * np.float32(du)])
        weight = np.where(np.isfinite(result.disparity), seen[n], float(n == lf.reference_index))
        if lf.valid is not None:
            weight = weight * valid_at(lf.valid[n], at)
        colour = colours(spline(lf.image(n)), at)
        unlike = np.where(trusted, ((colour - reference) ** 2).mean(2) / np.float32(_UNLIKE**2), 0)
        weight = weight / (1 + unlike) ** 2
        total += weight[..., None] * colour
        weights += weight
    return np.clip(total / np.maximum(weights, 1e-12)[..., None], 0, 1).astype(np.float32)
