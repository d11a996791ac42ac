"""Light in views: pixels and corners that recorded none, and white of fewer bits than the type has."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.data.mapping import each_view
from lfgpu.io.arrays import without_dark_views
from lfgpu.io.damage import naming

_DARK = 0.5  # share of the middle view's brightness below which a pixel counts as dark
_AROUND = 16  # brightness is that of a window of a 16th of the shorter side: parallax must not look like shadow


def without_dark_parts(path: Path, light_field: LightField, valid: NDArray[np.bool_] | None = None) -> LightField:
    """Mask what is less than half as bright as the reference view is around the same place, or, if that is given, what
    is not `valid`; what the light field masks already stays masked.

    Views of which nothing is left are left out, and the middle one of the others is the reference; errors name `path`.
    """
    from scipy import ndimage  # not for those who read something else

    window = max(5, min(light_field.size) // _AROUND)

    def brightness(index: int) -> NDArray[np.float32]:
        grey = light_field.image(index).mean(axis=2)
        return np.asarray(ndimage.uniform_filter(grey, window, mode="nearest"))

    if valid is None:
        least = _DARK * brightness(light_field.reference_index)
        valid = np.stack([brightness(index) >= least for index in range(len(light_field.views))])
    valid = valid.reshape(light_field.views.shape[:3])
    with naming(path):
        known = valid if light_field.valid is None else valid & light_field.valid
        masked = without_dark_views(replace(light_field, valid=known))
    return replace(masked, reference=None)


_BITS = (8, 10, 12, 14)  # of what is stored in 16


def with_white(light_field: LightField) -> LightField:
    """Set `white`, with a note, where uint16 views use fewer bits than they have.

    Parameters of the methods are in units of intensity: in views that are taken for 16 times darker than they are,
    everything is noise to them.
    """
    found = _fewer_bits(light_field)
    if found is None:
        return light_field
    largest, bits = found
    white = (1 << bits) - 1
    note = (
        f"The values go up to {largest} of 65535: they are taken for {bits} bits, {white} for white. If they are dark "
        "pictures of 16 bits, nothing is lost by that."
    )
    return replace(light_field, white=white, notes=(*light_field.notes, note))


def ask_for_white(light_field: LightField) -> str | None:
    """Ask for `white` where uint16 views without it use fewer bits than they have; None elsewhere."""
    found = _fewer_bits(light_field)
    if found is None:
        return None
    largest, bits = found
    return (
        f"The values go up to {largest} of 65535, as those of {bits} bits do: give the light field "
        f"white={(1 << bits) - 1} if that is white, or the views are taken for dark, and much in them for noise."
    )


def _fewer_bits(light_field: LightField) -> tuple[int, int] | None:
    """Find the largest value of uint16 views without `white`, and the bits that it takes; None for all 16, or none."""
    views = light_field.views
    if views.dtype != np.uint16 or light_field.white is not None:
        return None
    if views[light_field.reference_index].max() >= 1 << _BITS[-1]:  # a look at one view is enough
        return None
    highest = np.zeros(len(views), np.int64)

    def look(index: int, view: NDArray[Any]) -> None:
        highest[index] = view.max()

    each_view(views, range(len(views)), look)
    largest = int(highest.max())
    bits = next((bits for bits in _BITS if largest < 1 << bits), None)
    return None if bits is None or largest == 0 else (largest, bits)


_BLACK = 0.016  # intensity: 4 of 255
_LEAST, _MOST = 1e-4, 0.3  # share of all pixels: fewer black ones are no vignette, and more are a dark scene
_RIM = 2  # pixels: width of the darkened rim around the black region


def without_black_corners(lf: LightField) -> LightField:
    """Mask the black corners of a light field, and add a note.

    Black corners do not move from view to view, so matching would give them disparity 0. A region of black pixels is
    masked if it is connected to pixels that are black in all views, and these are connected to a corner. All four
    corners must be black. A light field that has a mask, or no black corners, is returned unchanged.
    """
    corners = (0, 0, -1, -1), (0, -1, 0, -1)
    threshold = _BLACK / lf.scale
    if lf.valid is not None or np.any(lf.views[(slice(None), *corners)] > threshold):
        return lf
    from scipy.ndimage import binary_dilation, label  # slow to import, and rarely needed

    black = np.empty(lf.views.shape[:3], np.bool_)

    def look(index: int, view: NDArray[Any]) -> None:
        black[index] = np.all(view <= threshold, axis=2)

    each_view(lf.views, range(len(black)), look)
    always = _connected(label(black.all(0))[0], corners)
    if not _LEAST <= always.mean() <= _MOST:
        return lf
    rim = np.ones((2 * _RIM + 1, 2 * _RIM + 1), np.bool_)
    valid = np.stack([~binary_dilation(_connected(label(view)[0], np.nonzero(always)), rim) for view in black])
    note = f"The corners are black: {100 * (1 - valid.mean()):.1f} % of the pixels are not used."
    return replace(lf, valid=valid, notes=(*lf.notes, note))


def _connected(labels: NDArray[np.int32], seeds: Any) -> NDArray[np.bool_]:
    """Select the labelled regions that contain the pixels `seeds`."""
    found = np.unique(labels[seeds])
    return np.isin(labels, found[found > 0])
