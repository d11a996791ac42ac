"""Views as images: intensities, lines of views, local contrast."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from lfgpu.contract.arrays import Array


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
    """What is done to views before they are compared."""

    def intensities(
        self, views: Array, index: int, valid: Array | None, *, scale: float, fill: float, image_out: Array
    ) -> None:
        """image [y, x, c] = scale * views[index], but `fill` where `valid` [n, y, x] is 0 in view `index`."""

    def line_of_views(self, views: Array, line: Sequence[int], *, vertical: bool, epis_out: Array) -> None:
        """epis [u, y, x, c] = views[line[u], y, x, c], or views[line[u], x, y, c] if `vertical`."""

    def normalization(
        self, shape: Sequence[int], device: str, *, scale: float, sigma: float, floor: float
    ) -> Normalization:
        """Plan the local contrast normalisation of views of `shape` [n, y, x, c]."""

    def resample(self, pictures: Array, places: Array, tones: Array, *, white: float, views_out: Array) -> None:
        """Views [n, y, x, c] of pictures [n, h, w, c], looked up by cubic convolution; both as stored, of one type.

        `places` [n, y, x, 3] holds for each pixel the place (x, y) in the picture and q, by which `tones` [n, 3, c]
        = (gain, offset, falloff) counts there. With I the picture at (x, y), by the kernel of Keys (a = -1/2, pixels
        beyond the border are those of the border), as stored,

            view = min(max((I - offset) / max(gain + falloff q, 0.05), 0), white),

        rounded to a nearest whole number where such are stored. It is 0 where (x, y) is NaN, or farther than half a
        pixel outside of the picture's outermost centres; what is nearer is moved to them.
        """
