"""The non-local-means prior: its weights and what they do to maps and volumes."""

from collections.abc import Sequence
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.arrays import Array

OverPatch: TypeAlias = Literal["mean", "sum"]
"""Reduction of the distance of two patches over their pixels: mean or sum."""

PatchGradients: TypeAlias = Literal["central", "patch"]
"""Gradient of a patch pixel: its central difference, or its difference from the middle of the patch."""


class NlmWeights(Protocol):
    """Non-local-means weights of images of one shape, planned once."""

    def __call__(self, image: Array, weights_out: Array) -> None:
        """Weights [k, y, x] of each pixel p with q = p + half_window(window)[k]; 0 where q lies outside, else >= floor.

        w = exp(-D) with D the mean or the sum, over those pixels p' of the patch around p whose q' = p' + q - p lies in
        the image, too, of |I(p') - I(q')|^2 / sigma_color^2 + |G(p') - G(q')|^2 / sigma_gradient^2. |.|^2 is the mean
        of squares over the channels. G is the central difference in x and in y, the border pixel beyond the border, or
        with `gradients` "patch" G(p') = I(p) - I(p') and G(q') = I(q) - I(q'). `image` is float32 [y, x, c].
        """


class Prior(Protocol):
    """Sums over windows with weights by likeness."""

    def nlm_weights(
        self,
        shape: Sequence[int],
        device: str,
        *,
        window: int,
        patch: int,
        sigma_color: float,
        sigma_gradient: float,
        floor: float,
        over_patch: OverPatch = "mean",
        gradients: PatchGradients = "central",
    ) -> NlmWeights:
        """Plan the weights of images of `shape` [y, x, c]; sigmas > 0, `floor` >= 0."""

    def nlm_neighbors(self, weights: Array, values: Array, *, window: int, sums_out: Array) -> None:
        """W v: the weighted sum [y, x] of `values` [y, x] over each pixel's window, itself (weight 1) included."""

    def nlm_laplacian(
        self, weights: Array, values: Array, *, window: int, laplacian_out: Array, diagonal: Array | None = None
    ) -> None:
        """L v with (L v)_p = sum_q w_pq (v_p - v_q): then sum_pq w_pq (v_p - v_q)^2 = 2 v^T L v.

        With a `diagonal` c [y, x] it is (L + diag(c)) v.
        """

    def nlm_ratio(
        self,
        weights: Array,
        guide: Array,
        numerator: Array,
        denominator: Array,
        *,
        window: int,
        support: float,
        floor: float,
        ratio_out: Array,
    ) -> None:
        """sum_q v_pq numerator_q / sum_q v_pq (denominator_q + floor) over each pixel's window, fields [y, x].

        v_pq = w_pq / (1 + (guide_q - guide_p)^2 / support^2), and 1 for the pixel itself: only what lies on the same
        surface of the `guide`, a disparity map, is taken together. `support` is in the guide's unit, > 0, and
        denominator + floor > 0 everywhere; `ratio_out` is none of the inputs.
        """

    def nlm_plane(
        self,
        weights: Array,
        values: Array,
        certainty: Array,
        *,
        window: int,
        support: float,
        ridge: float,
        plane_out: Array,
    ) -> None:
        """Compute the plane through the values around each pixel, at that pixel; fields [y, x].

        It is a where (a, s) minimise sum_q u_q [(a + s . (q - p) - values_q)^2 + ridge |s|^2] over the window, p
        included, with u_q = v_pq certainty_q and v_pq as in `nlm_ratio`, the guide being the values. `certainty` is
        > 0 and `ridge` > 0, pixels squared: a window too small to tell a slope gives the mean. `plane_out` is none of
        the inputs.
        """

    def nlm_on_surface(self, weights: Array, guide: Array, *, window: int, support: float, weights_out: Array) -> None:
        """v_pq of `nlm_ratio` as weights [k, y, x]; `weights_out` may be `weights`."""

    def nlm_average(self, weights: Array, volume: Array, *, window: int, average_out: Array) -> None:
        """Average each slice over each pixel's window with the non-local-means weights, itself with weight 1.

        average_p = (volume_p + sum_q w_pq volume_q) / (1 + sum_q w_pq) over all q of the window that lie in the image.
        """


def half_window(window: int) -> NDArray[np.int64]:
    """Return the offsets (dy, dx) [k, 2] after the centre, in row order, of a window of odd side `window`.

    Weights are symmetric, w(p, q) = w(q, p), so one half says all.
    """
    radius = window // 2
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1)
    after = (dy > 0) | ((dy == 0) & (dx > 0))
    return np.stack([dy[after], dx[after]], axis=1)
