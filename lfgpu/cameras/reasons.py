"""Reasons to doubt pixels of a map, from the views: no texture, hidden, end of the range, unexplained, cameras."""

from __future__ import annotations

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import open_device
from lfgpu.cameras.looking import checked_map
from lfgpu.contract import Float32Array
from lfgpu.data.lightfield import LightField, check_light_field
from lfgpu.data.result import DepthResult, check_result
from lfgpu.data.windows import differences, window_mean
from lfgpu.methods.matching.noise import measured_grain

_WINDOW = 7  # pixels: side of the window in which texture is looked for
_TEXTURED = 3.0  # root mean square of a textured window's differences, in units of what noise makes of them
_STEP = 0.5 / 255  # intensity: what is below is no difference of 8-bit views
_NEARER = 0.5  # pixels in the view, by which what hides a pixel is nearer at least
_SEEN = 0.5  # share of the views that see a pixel which is not hidden
_END = 0.01  # of the width of the range
_EXPLAINED = 3.0  # root mean square difference to the views that see a pixel, in units of noise and interpolation
_BLUR = 0.25  # pixels: interpolated values at an edge are off as if they stood so far beside it


class Reason(IntFlag):
    """A reason to doubt a pixel of a map.

    Examples
    --------
    >>> lfgpu.Reason(5)
    <Reason.NO_TEXTURE|END_OF_RANGE: 5>
    """

    NO_TEXTURE = 1
    """Around the pixel the reference view varies no more than its noise, along the direction of the cameras."""
    HIDDEN = 2
    """Fewer than half of the views see the pixel: nearer surfaces of the map hide it, or it is outside of the frame."""
    END_OF_RANGE = 4
    """The disparity lies at an end of the range that was searched."""
    UNEXPLAINED = 8
    """The views that see the pixel show something else there: gloss, reflection, motion, or a wrong disparity."""
    CAMERAS = 16
    """The cameras are not where they should be (`DepthResult.remarks`)."""


def reasons(lf: LightField, result: DepthResult) -> NDArray[np.uint8]:
    """Tell why pixels of a map are not to be believed.

    Parameters
    ----------
    lf
        The light field.
    result
        A result of its reference view.

    Returns
    -------
    NDArray[np.uint8]
        [y, x], the sum of the values of all `Reason` that apply; 0 where none does, or the disparity is NaN. A reason
        is no proof: where the confidence is high, the map is right in spite of it.

    Raises
    ------
    LightFieldError
        If the map has another size, or belongs to another view.

    Examples
    --------
    >>> hidden = lfgpu.reasons(lf, result) & lfgpu.Reason.HIDDEN > 0
    >>> hidden.shape
    (64, 80)
    """
    check_light_field(lf)
    check_result(result)
    disparity = checked_map(lf, result)
    known = np.isfinite(disparity)
    low, high = result.disparity_range
    image = lf.image(lf.reference_index).mean(-1)
    noise = np.hypot(measured_grain(lf, open_device(device="cpu")), _STEP)
    slopes = [np.square(differences(image, axis)) for axis in (0, 1)]
    reach = np.square(lf.offsets[:, ::-1]).sum(0)  # along rows and columns of pixels, as `slopes`
    across = sum(window_mean(s, _WINDOW) * r for s, r in zip(slopes, reach / reach.sum(), strict=True))
    seen, error = _compared(lf, np.where(known, disparity, low).astype(np.float32), image)
    allowed = np.sqrt(2 * noise**2 + _BLUR**2 * np.maximum(*slopes))
    ends = np.minimum(np.abs(disparity - low), np.abs(disparity - high)) <= _END * (high - low)
    found = {
        Reason.NO_TEXTURE: np.sqrt(across) < _TEXTURED * noise / np.sqrt(2),
        Reason.HIDDEN: seen < _SEEN,
        Reason.END_OF_RANGE: ends,
        Reason.UNEXPLAINED: error > _EXPLAINED * allowed,
        Reason.CAMERAS: np.full(lf.size, bool(result.remarks)),
    }
    bits = np.zeros(lf.size, np.uint8)
    for reason, where in found.items():
        bits[where & known] |= np.uint8(reason)
    return bits


def _compared(lf: LightField, disparity: Float32Array, image: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Give the share of the other views that see each pixel, and the root mean square difference to those."""
    from scipy.ndimage import map_coordinates  # slow to import, and rarely needed

    height, width = lf.size
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    seen, total = np.zeros(lf.size, np.float32), np.zeros(lf.size, np.float32)
    others = [n for n in range(len(lf.views)) if n != lf.reference_index]
    for n in others:
        du, dv = lf.offsets[n].astype(np.float32)
        y, x = rows - disparity * dv, columns - disparity * du
        inside = (y >= 0) & (y <= height - 1) & (x >= 0) & (x <= width - 1)
        # The nearest surface at each pixel of the view; it reaches as far as its pixels are apart there.
        nearest = np.full(lf.size, -np.inf, np.float32)
        for at_y, at_x in ((np.floor(y), np.floor(x)), (np.ceil(y), np.ceil(x))):
            np.maximum.at(nearest, (at_y[inside].astype(np.intp), at_x[inside].astype(np.intp)), disparity[inside])
        place = np.rint(y).clip(0, height - 1).astype(np.intp), np.rint(x).clip(0, width - 1).astype(np.intp)
        visible = inside & ((nearest[place] - disparity) * np.abs(lf.offsets[n]).max() < _NEARER)
        if lf.valid is not None:
            visible &= lf.valid[n][place]
        view = map_coordinates(lf.image(n).mean(-1), (y, x), order=1, mode="nearest")
        seen += visible
        total += np.where(visible, np.square(view - image), 0)
    return np.divide(seen, np.float32(len(others))), np.sqrt(total / np.maximum(seen, np.float32(1)))
