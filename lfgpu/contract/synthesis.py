"""The forward model of a light field: splats, their adjoints and derivatives, and data terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Protocol, TypeAlias

from lfgpu.contract.arrays import Array, Scalar


class DataTerm(Protocol):
    """How far the predicted views are from the recorded ones, planned for light fields of one kind."""

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        """Take a reference image [y, x, c] and `recorded` views [n, y, x, c]: what is compared from now on.

        `valid` [n, y, x] is a field, 0 where a recorded pixel does not count; None counts all.
        """

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        """The sum of `data_term` or `z_buffered_data_term`, over views and pixels where recorded views are valid.

        `disparity` and `gradient_out` are fields [y, x]; the gradient with respect to the disparity is written.
        """


class SplatDataTerm(DataTerm, Protocol):
    """The data term of the plain splat, which knows how it curves."""

    def curvature(self, curvature_out: Array) -> None:
        """2 Σ_n |offset_n|² Σ_c image² [y, x]: about the second derivative of the sum by each pixel's disparity.

        It is that of the loaded image landing in the middle between pixels that show what is predicted, and does not
        depend on the disparity.
        """


Loss: TypeAlias = Literal["squares", "charbonnier", "geman-mcclure"]
"""How much a residual counts, see `KernelSet.z_buffered_data_term`."""


class Synthesis(Protocol):
    """Views predicted from the reference view and its disparity map.

    The plain splat is L(d) = A(d) I: L(x, y) = sum_p I(p) Λ(x - x_p + d du) Λ(y - y_p + d dv).
    """

    def splat(
        self,
        image: Array,
        disparity: Array,
        offsets: Array,
        *,
        softness: float,
        views_out: Array,
        coverage_out: Array,
    ) -> None:
        """Views [n, y, x, c] predicted from the reference image [y, x, c], and the weight [n, y, x] that landed."""

    def splat_transpose(
        self, views: Array, disparity: Array, offsets: Array, *, softness: float, image_out: Array
    ) -> None:
        """A(d)^T: what views [n, y, x, c] say about the reference image [y, x, c]."""

    def splat_jvp(
        self,
        image: Array,
        disparity: Array,
        tangent: Array,
        offsets: Array,
        *,
        softness: float,
        views_out: Array,
    ) -> None:
        """J t: how the predicted views [n, y, x, c] change when the disparity changes by `tangent` [y, x]."""

    def splat_vjp(
        self,
        image: Array,
        disparity: Array,
        residual: Array,
        offsets: Array,
        *,
        softness: float,
        gradient_out: Array,
    ) -> None:
        """J^T r: the gradient [y, x] with respect to the disparity that residuals [n, y, x, c] give."""

    def data_term(self, shape: Sequence[int], offsets: Array, *, scale: float, softness: float) -> SplatDataTerm:
        """Plan ||A(d) I - scale * recorded||^2 and its gradient for recorded views of `shape` [n, y, x, c]."""

    def seen_by_reference(
        self, disparity: Array, offsets: Array, known: Array | None, valid: Array | None, *, seen_out: Array
    ) -> None:
        """1 where the reference view knows what a pixel of another view shows, else 0: a field [n, y, x].

        Pixel (x, y) of the view at (du, dv) shows what lies at (x + d du, y + d dv) of the reference with d the
        disparity [y, x] at (x, y). Known is what lies in the frame and whose nearest pixel has `known` [y, x] not 0
        (None: all); and `valid` [n, y, x], if given, must not be 0 at (x, y). Halves round to even.
        """

    # --- the z-buffered splat: what is nearer hides what is behind it ---

    def splat_z_buffered(
        self,
        image: Array,
        disparity: Array,
        offsets: Array,
        *,
        softness: float,
        sharpness: float,
        views_out: Array,
        coverage_out: Array,
    ) -> None:
        """Views [n, y, x, c] as means of what lands on a pixel, the nearer the more, and the coverage of `splat`.

        Let T_p(q) = Λ(x - x_p + d_p du) Λ(y - y_p + d_p dv) be what pixel p of the reference image [y, x, c] gives to
        pixel q = (x, y) of a view, and let p reach q if T_p(q) > 1e-20. Over all p that reach q,
        L(q) = sum_p T_p w_p I_p / sum_p T_p w_p with w_p = exp(`sharpness` (d_p - max_p d_p)), and 0 where none does.
        The coverage [n, y, x] is sum_p T_p. `sharpness` is in view steps per pixel, >= 0: at 0, L is the plain mean.
        """

    def z_buffered_data_term(
        self,
        shape: Sequence[int],
        offsets: Array,
        *,
        scale: float,
        softness: float,
        sharpness: float,
        least_coverage: float,
        loss: Loss,
        loss_scale: float,
    ) -> DataTerm:
        """Plan the loss of L - scale * recorded for views of `shape` [n, y, x, c], with L of `splat_z_buffered`.

        A pixel q counts if it is valid and its coverage is at least `least_coverage` (> 0); others show what no pixel
        of the reference tells. The value is the sum of ρ over all that count, of one residual for all channels,
        r² = sum_c (L_c(q) - scale * recorded_c(q))², and with s = `loss_scale` (intensity, > 0; squares have none)

            "squares"        ρ = r²
            "charbonnier"    ρ = 2 s² (√(1 + r²/s²) - 1)     (Charbonnier et al. 1997), 2 s |r| for large r
            "geman-mcclure"  ρ = s² r² / (s² + r²)           (Geman and McClure 1987), s² for large r

        all of which are r² for small r. The gradient is exact as long as the same pixels count, w_p included.

        On a surface whose landing places lie h pixels apart, coverage is 1/h in the mean and nowhere below 2 - h (up to
        the rounding of Λ), and just beyond the last pixel before a gap it falls from 1 to 0 over a pixel. So with a
        `least_coverage` of 0.5 a gap begins half a pixel after its last pixel, where that pixel ends, and surfaces
        stretched up to 1.5 times count everywhere; beyond that, only where something landed within half a pixel or so.
        """

    def visible(self, disparity: Array, offsets: Array, *, tolerance: float, visible_out: Array) -> None:
        """1 where a pixel p of the reference is seen in view n, else 0: a field [n, y, x] over p.

        With D(q) the largest disparity of all pixels that reach q (|x - x_p + d_p du| < 1 and |y - y_p + d_p dv| < 1),
        p is seen if it lands in the frame, 0 <= x_p - d_p du <= width - 1 and 0 <= y_p - d_p dv <= height - 1, and if
        any of the up to four pixels q of the frame that it reaches has D(q) <= d_p + `tolerance` (pixels per view step,
        >= 0).

        Any, as one free pixel is enough to be seen by: so what hides p ends where the hiding surface ends, up to half a
        pixel either way. What lies beside p on its own surface hides nothing as long as `tolerance` is larger than what
        the disparity changes by over one pixel of the view, that is |g| / |1 - g o| for a change of g per pixel along
        an offset o. Through surfaces that are stretched more than twice, what is behind them shines.
        """
