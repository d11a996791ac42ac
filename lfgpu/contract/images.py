"""Views as images: intensities, lines of views, local contrast, smoothed and reduced views."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.arrays import Array

WHITE = 65535
"""Stored value of intensity 1 in smoothed and reduced views, which are uint16."""

SMOOTHING_REACH = 3
"""Rows and columns from a pixel to the farthest ones that `Images.smooth_views` averages."""

REDUCTION = 4
"""Pixels of a view along a side of a pixel of a reduced view."""


def bridged(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Add the pixels to a mask [y, x] that `Images.intensities` bridges."""
    around = np.pad(mask, 1)
    return mask | around[1:-1, :-2] & around[1:-1, 2:] | around[:-2, 1:-1] & around[2:, 1:-1]


class Normalization(Protocol):
    """Local contrast normalisation of views of one shape, planned once."""

    def __call__(self, views: Array, valid: Array | None, detail_out: Array) -> None:
        """Views [n, y, x, c] (as stored) without their local mean and in units of their local contrast.

        With I = scale * views and G_s the Gaussian mean of standard deviation s (cut off after 2.5 s, rounded to the
        nearest whole pixel; the image is mirrored at its borders, its border pixels repeated), D = I - G_sigma I and
        detail = D / sqrt(G_(2 sigma) mean_c D^2 + floor^2). Where `valid` [n, y, x] (a field) is 0 a pixel has no part
        in means, which are of the valid pixels around, 0 where their share of the Gaussian is below 1e-6.
        sigma = 0 gives detail = I.
        """


class Images(Protocol):
    """Preparation of views before they are compared."""

    def intensities(
        self, views: Array, index: int, valid: Array | None, *, scale: float, fill: float, image_out: Array
    ) -> None:
        """image [y, x, c] = scale * views[index], where `valid` [n, y, x] is not 0 in view `index`.

        A pixel where it is 0 is bridged if those at its left and right are valid, or those above and below it: it is
        their mean, or that of all four. Elsewhere it is `fill`. Broken pixels and lines of a sensor are no gaps.
        """

    def line_of_views(
        self,
        views: Array,
        line: Sequence[int],
        *,
        vertical: bool,
        epis_out: Array,
        corner: tuple[int, int] = (0, 0),
    ) -> None:
        """epis [u, y, x, c] = views[line[u], y + top, x + left, c]; if `vertical` views[line[u], x + top, y + left, c].

        (top, left) is the `corner`; the views reach as far as the EPIs, or farther.
        A field [n, y, x] in place of the views gives fields.
        """

    def normalization(
        self, shape: Sequence[int], device: str, *, scale: float, sigma: float, floor: float
    ) -> Normalization:
        """Plan the local contrast normalisation of views of `shape` [n, y, x, c]."""

    def smooth_views(
        self,
        views: Array,
        valid: Array | None,
        *,
        scale: float,
        deviation: float,
        views_out: Array,
        chosen: Sequence[int] | None = None,
    ) -> None:
        """Means of pixels that look alike, uint16 [n, y, x, c] with `WHITE` for 1, rounded; 0 to 1 is kept.

        They are those of the `chosen` views, in this order, or of all.
        With I = scale * views [n, y, x, c] and G its mean over 3 x 3 pixels, the frame's border repeated, the mean at p
        is over the pixels q of the frame at most SMOOTHING_REACH rows and columns away, with the weights

            exp(-|q - p|^2 / 8) / (1 + mean_c (G_q - G_p)^2 / deviation^2)^2.

        `deviation` is an intensity > 0. Pixels where `valid` [n, y, x] is 0 have no part in any of these means,
        whatever they hold. At such a pixel the weights are exp(-|q - p|^2 / 8), and the result is 0 if all weights are.
        """

    def reduce_views(
        self, views: Array, valid: Array | None, *, scale: float, views_out: Array, valid_out: Array | None
    ) -> None:
        """Means over REDUCTION x REDUCTION pixels of scale * views [n, y, x, c], uint16 with `WHITE` for 1, rounded.

        Both sides of the views are at least REDUCTION pixels. Rows and columns that are left over have no part.
        Means are of the pixels where `valid` [n, y, x] is not 0, whatever the others hold; 0 where there is none.
        `valid_out` [n, y, x] is 1 where all of a block's pixels are valid, else 0; it is None if `valid` is.
        """

    def resample(self, pictures: Array, places: Array, tones: Array, *, white: float, views_out: Array) -> None:
        """Views [n, y, x, c] of pictures [n, h, w, c], looked up by cubic convolution; both as stored, of one type.

        `places` [n, y, x, 3] holds for each pixel the place (x, y) in the picture and q, by which `tones` [n, 3, c]
        = (gain, offset, falloff) counts there. With I the picture at (x, y), by the kernel of Keys (a = -1/2, pixels
        beyond the border are those of the border), as stored,

            view = min(max((I - offset) / max(gain + falloff q, 0.05), 0), white),

        rounded to a nearest whole number where such are stored. It is 0 where (x, y) is NaN, or farther than half a
        pixel outside of the picture's outermost centres; what is nearer is moved to them.
        """
