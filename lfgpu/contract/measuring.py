"""Measurements of noise: quantiles, and differences in windows that show little else."""

from typing import Protocol

from lfgpu.contract.arrays import Array, Scalar

GRAIN_WINDOW = 7
"""Rows and columns of the windows of `Measuring.window_grain`."""


class Measuring(Protocol):
    """Measurements of views before they are compared."""

    def quantile(
        self,
        values: Array,
        share: float,
        *,
        quantile_out: Scalar,
        among: Array | None = None,
        least: Scalar | None = None,
    ) -> None:
        """Find the value below which a share of the values of a field lies; `share` is within 0 to 1.

        With v_0 <= v_1 <= .. those of the n values that count, p = share (n - 1) and k = floor(p), it is
        v_k + (p - k) (v_(k+1) - v_k), rounded to the type of fields; NaN if none counts. NaN does not count, nor does a
        value where `among`, a field of the same shape, is not at least `least`.
        """

    def window_grain(
        self, image: Array, limits: Array, *, least: float, differences_out: Array, limited_out: Array, grain_out: Array
    ) -> None:
        """Average differences in windows of an image [y, x, c] that noise alone would make: fields [y - 4, x - 4].

        With f = (1, -4, 6, -4, 1), `differences` [y, x] is the mean over the channels of
        sqrt(pi / 2) / sum(f^2) |sum_ij f_i f_j image[y + i, x + j]|; `limited` is 1 where one of these 5 x 5 pixels has
        in some channel the value limits[0, c] or limits[1, c], else 0. `grain` is the mean of the differences over
        GRAIN_WINDOW x GRAIN_WINDOW pixels around, mirrored at the borders (the border pixel is repeated). It is NaN
        where one of these is NaN, and where it is at most `least` and one of these pixels is limited. Both sides of
        the image are at least GRAIN_WINDOW + 4.
        """
