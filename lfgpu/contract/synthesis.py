"""The forward model of a light field: the squared error of the splat, and the splat with occlusions."""

from collections.abc import Sequence
from typing import Protocol

from lfgpu.contract.arrays import Array, Scalar


class DataTerm(Protocol):
    """Squared error of the views that a disparity map predicts, planned once for light fields of one kind."""

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        """Take the data that later calls compare.

        Parameters
        ----------
        image
            Reference image [y, x, c].
        recorded
            Views [n, y, x, c], as stored.
        valid
            Field [n, y, x], 0 where a recorded pixel does not count; None counts all.
        """

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        """Sum the squared differences over views, valid pixels and channels.

        `disparity` and `gradient_out` are fields [y, x]; `gradient_out` is the gradient by the disparity.
        """

    def curvature(self, curvature_out: Array) -> None:
        """Approximate the second derivative of the sum by the disparity of each pixel.

        curvature_out [y, x] = 2 Σ_n |offset_n|² Σ_c image². It is exact where the loaded image lands in the middle
        between pixels that show what is predicted, and does not depend on the disparity.
        """


class Synthesis(Protocol):
    """Views predicted from the reference view and its disparity map.

    The plain splat is L(d) = A(d) I: L(x, y) = sum_p I(p) Λ(x - x_p + d du) Λ(y - y_p + d dv).
    """

    def data_term(self, shape: Sequence[int], offsets: Array, *, scale: float, softness: float) -> DataTerm:
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
        """Views [n, y, x, c] as means of what lands on a pixel, the nearer the more, and the coverage.

        Let T_p(q) = Λ(x - x_p + d_p du) Λ(y - y_p + d_p dv) be what pixel p of the reference image [y, x, c] gives to
        pixel q = (x, y) of a view, and let p reach q if T_p(q) > 1e-20. Over all p that reach q,
        L(q) = sum_p T_p w_p I_p / sum_p T_p w_p with w_p = exp(`sharpness` (d_p - max_p d_p)), and 0 where none does.
        The coverage [n, y, x] is sum_p T_p. `sharpness` is in view steps per pixel, >= 0: at 0, L is the plain mean.
        """
