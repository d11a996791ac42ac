"""Resampling of views, each once: places of pixels, cubic splines, masks of places outside of the picture."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data import LightField
from lfgpu.threads import in_threads

_CUBIC = 3


def pixels(height: int, width: int) -> Float64Array:
    """float64 [y, x, 2], (x, y) of each pixel."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    return np.stack([x, y], axis=-1)


def through(homography: Float64Array, at: Float64Array) -> Float64Array:
    """Map places [..., 2] by a homography [3, 3]."""
    mapped = at @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def looked_up(image: Float32Array, at: Float64Array) -> tuple[Float32Array, NDArray[np.bool_]]:
    """Look up an image [y, x, c] at places (x, y) [h, w, 2] by cubic splines; True [h, w] for places inside of it.

    NaN places lie outside; a place outside shows the nearest pixel of the border.
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
    tone: Callable[[Float32Array, int, Float64Array], Float32Array] | None = None,
) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """Look up all views of a light field at given places; returns views [n, y, x, c] as stored, and their masks.

    `places` gives the places (x, y) [y, x, 2] of the view with an index, None to leave it. `tone` changes a view in [0,
    1], given its index and the places.
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
            view = tone(view, n, pixels(*lf.size) if at is None else at)
        views[n] = stored(view, lf)

    in_threads(work, range(len(lf.views)))
    return views, None if valid.all() else valid


def stored(view: Float32Array, lf: LightField) -> NDArray[Any]:
    """Convert a view in [0, 1] to the type that the light field is stored in."""
    view = np.clip(view, 0, 1)
    return view if lf.views.dtype == np.float32 else np.rint(view / lf.scale).astype(lf.views.dtype)
