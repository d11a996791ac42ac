"""Search for the disparities of a scene: views of a lower resolution, compared side by side."""

from collections.abc import Sequence
from typing import Any, Protocol

from numpy.typing import NDArray

from lfgpu.contract.arrays import Array, Scalar

UNSEEN = 2.0
"""The cost of what cannot be compared, larger than any other: intensities differ by 1 at most."""


class Details(Protocol):
    """Images at a lower resolution without their local mean, planned for images of one shape."""

    def __call__(self, images: Array, details_out: Array) -> None:
        """details [n, y / factor, x / factor] of images [n, y, x], fields.

        A pixel of g is the mean over factor x factor pixels; rows and columns that are left over at the end have no
        part. detail = g - m, m the mean of g over the window x window pixels around, the border pixels of g repeated.
        What is NaN in g has no part in m, and stays NaN.
        """


class SideCosts(Protocol):
    """Differences between the reference and the views to each side at a row of disparities; planned once.

    D_n is the detail of view n, D_r that of the reference, d_l = first + l * step, l < count. The cost of a side at p
    is the mean of |D_n(q - d_l o_n) - D_r(q)| (bilinear) over its views n and the 3 x 3 pixels q around p. A term has a
    part if q and q - d_l o_n lie in the frame (0 to width - 1, 0 to height - 1) and no detail that it needs is NaN.
    Where fewer than half of the terms have one, the cost is `UNSEEN`. The shifts -d_l o_n are `sweep_shifts`.
    """

    def __call__(self, details: Array, first: float, step: float, volume_out: Array) -> None:
        """volume [m, l, y, x], one for each line: the least of the costs of its sides. `details` is [n, y, x]."""


class RangeSearch(Protocol):
    """Views compared at a low resolution, to find which disparities there are."""

    def shrink(
        self, views: Array, chosen: Sequence[int], valid: Array | None, *, scale: float, factor: int, images_out: Array
    ) -> None:
        """Some of the views [n, y, x, c], as stored, in grey and smaller: images [k, y / factor, x / factor], fields.

        A pixel is the mean of scale * views[chosen[k]] over factor x factor pixels and the channels; rows and columns
        that are left over at the end have no part. It is NaN where one of these pixels is 0 in `valid` [k, y, x], which
        is of the chosen views.
        """

    def details(self, shape: Sequence[int], device: str, *, factor: int, window: int) -> Details:
        """Plan the details of images of `shape` [n, y, x]; `factor` > 0, `window` odd."""

    def side_costs(
        self,
        shape: Sequence[int],
        offsets: NDArray[Any],
        lines: Sequence[Sequence[Sequence[int]]],
        device: str,
        *,
        reference: int,
        count: int,
    ) -> SideCosts:
        """Plan the costs of details of `shape` [n, y, x], with `offsets` [n, 2] on the host.

        A line is its sides, and a side the indices of its views. There are one or two lines; each has a side, and each
        side has a view.
        """

    def distinct_minimum(self, volume: Array, *, apart: int, found_out: Sequence[Array]) -> None:
        """Find the least cost over all lines, its place, and by how much it is less than elsewhere: five fields [y, x].

        With C_l the mean over one or two lines of min(volume [m, l, y, x], 1), and k the first l of the least C_l:
        0: k + t, t the minimum of the parabola through C_(k-1), C_k and C_(k+1), in -1 to 1, 0 where it does not bend
        upwards by more than 1e-9; 1: C_k; 2: the largest C_l, less C_k, but NaN where C_k is 1, as nothing is compared;
        3: the least C_l with |l - k| > `apart`, less C_k, `UNSEEN` if there is none; 4: the largest of the lines' costs
        at k. At k = 0 and k = count - 1, t is 0 and 4 is `UNSEEN`: the minimum may lie beyond. count >= 3, `apart` > 0.
        """

    def agreeing_disparity(
        self,
        found: Sequence[Array],
        noise: Scalar,
        *,
        least_noise: float,
        same: float,
        other: float,
        neighbors: int,
        first: float,
        step: float,
        disparity_out: Array,
    ) -> None:
        """Find the disparities of pixels that are sure of them, and whose neighbours have the same: a field [y, x].

        `found` is that of `distinct_minimum`, and s the larger one of `noise` and `least_noise`, the latter if `noise`
        is NaN. A pixel is sure if found[4] <= min(same s, 1) and found[3] >= other s; its disparity is
        first + step found[0]. Neighbours, of the eight, have the same if they are sure and theirs differs by 1.5 `step`
        at most. Where at least so many `neighbors` have it, the result is the mean over these and the pixel, else NaN.
        """
