"""Views resampled once: where each pixel comes from, cubic splines, and what lies outside of the picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.threads import in_threads

_CUBIC = 3


def pixels(height: int, width: int) -> Float64Array:
    """float64 [y, x, 2], (x, y) of each pixel."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    return np.stack([x, y], axis=-1)


def through(homography: Float64Array, at: Float64Array) -> Float64Array:
    """Places [..., 2] mapped by a homography [3, 3]."""
    mapped = at @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def looked_up(image: Float32Array, at: Float64Array) -> tuple[Float32Array, NDArray[np.bool_]]:
    """Colours of an image [y, x, c] at places (x, y) [h, w, 2] by cubic splines, and whether they lie in it, [h, w].

    NaN places lie outside; what is outside is the nearest pixel of the border.
    """
    from scipy import ndimage

    height, width = image.shape[:2]
    # Half a pixel beyond the outermost centres is still inside their pixels.
    with np.errstate(invalid="ignore"):
        inside = (
            (at[..., 0] >= -0.5) & (at[..., 0] <= width - 0.5) & (at[..., 1] >= -0.5) & (at[..., 1] <= height - 0.5)
        )
    where = np.nan_to_num(np.moveaxis(at[..., ::-1], -1, 0)).astype(np.float32)
    where[0] = where[0].clip(0, height - 1)
    where[1] = where[1].clip(0, width - 1)
    planes = [
        ndimage.map_coordinates(
            np.ascontiguousarray(image[..., c]), where, order=_CUBIC, mode="mirror", output=np.float32
        )
        for c in range(image.shape[2])
    ]
    return np.stack(planes, axis=-1), np.asarray(inside)


def resampled(
    lf: LightField,
    places: Callable[[int], Float64Array | None],
    tone: Callable[[Float32Array, int, Float64Array | None], Float32Array] | None = None,
) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """All views of a light field, looked up where `places` says, and which of their pixels are valid.

    Parameters
    ----------
    lf
        The light field.
    places
        Of a view's index the places (x, y) [y, x, 2] to look it up at; None where it is as it should be.
    tone
        Called with a view in [0, 1], its index and the places: what to show instead; None shows it as it is.

    Returns
    -------
    Views [n, y, x, c] in the stored type, and bool [n, y, x], None if all is valid.
    """
    import scipy.ndimage  # noqa: F401 - slow, so not at the top; here, as threads should import nothing

    views = np.empty_like(lf.views)
    valid = np.ones(lf.views.shape[:3], np.bool_) if lf.valid is None else lf.valid.copy()

    def work(n: int) -> None:
        at = places(n)
        view = lf.image(n)
        if at is not None:
            view, inside = looked_up(view, at)
            valid[n] = inside
            if lf.valid is not None:
                share, _ = looked_up(lf.valid[n][..., None].astype(np.float32), at)
                valid[n] &= share[..., 0] > 0.99
        if tone is not None:
            view = tone(view, n, at)
        views[n] = stored(view, lf)

    in_threads(work, range(len(lf.views)))
    return views, None if valid.all() else valid


def stored(view: Float32Array, lf: LightField) -> NDArray[Any]:
    """A view in [0, 1] in the type that the light field is stored in."""
    view = np.clip(view, 0, 1)
    return view if lf.views.dtype == np.float32 else np.rint(view / lf.scale).astype(lf.views.dtype)
