"""Matching: costs of disparities, the surface of least cost, and its confidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.arrays import Array, Float64Array

GRADIENT_REACH = 2
"""Pixels on each side of one whose steps in brightness lower the weight of gradients there: as far as these see."""

REACH = 3
"""Pixels from one to the farthest ones that `Matching.refine_boundaries` looks at."""


@dataclass(frozen=True)
class Disparities:
    """Disparities d_l = first + l * step, l < count, pixels per view step.

    Volumes have room for `slices` of them. Where there are more than disparities, the further ones cost the most there
    is (`Changing`).
    """

    first: float
    step: float
    count: int
    room: int = 0

    @property
    def slices(self) -> int:
        """The slices of volumes."""
        return max(self.count, self.room)


@dataclass(frozen=True)
class SweepCost:
    """The cost of a difference between a view and the reference view; `PlaneSweep` has the formula.

    Parameters
    ----------
    truncation
        Larger differences in intensity count as this one, >= 0.
    gradient_weight
        Weight of image gradients against intensities, >= 0; at 0 only intensities are compared.
    gradient_truncation
        Larger differences in image gradients count as this one, intensity per pixel, >= 0.
    softness
        Larger differences in intensity count by their square root, >= 0; 0 counts all as they are.
    """

    truncation: float
    gradient_weight: float = 0.0
    gradient_truncation: float = 0.0
    softness: float = 0.0


@dataclass(frozen=True, eq=False)
class ViewSets:
    """The views of a sweep: their cameras, sets of them, and the views that are enough.

    Parameters
    ----------
    offsets
        A field [n, 2]: (du, dv) of each view, in view steps; NaN if it is not compared.
    members
        A field [m, n] of 1 and 0: the views of each set, m <= 32; row 0 is all 1.
    preference
        Share by which the mean cost of all views but the first set is raised, >= 0.
    tolerance
        A surface hides only what lies behind it by more, pixels per view step, >= 0.
    least
        Views that must see a pixel past a surface, >= 1.
    """

    offsets: Array
    members: Array
    preference: float
    tolerance: float
    least: int


class PlaneSweep(Protocol):
    """Matching costs of the views at each of a row of disparities, planned for one camera array.

    Plans may share what they `load`; then one of them does.

    Planned for light fields of one kind: views [n, y, x, c] and `Disparities` d_l; each call has a `SweepCost`. With
    W_n(p) = scale * recorded_n at p - d_l o_n (bilinear, the position moved into the frame), D = W_n - I and G its
    central differences in x and y, (D(p + 1) - D(p - 1)) / 2 with the border pixels of D repeated,

        c_n(p) = (r(min(mean_c |D|, truncation)) + w min(mean_(c, x, y) |G|, gradient_truncation)) / (1 + w),
        r(x) = 2 s (sqrt(1 + x / s) - 1), s = softness, w = gradient_weight.

    r(x) is nearly x while x is small beside s, and grows like its root where it is large. With a softness of 0 it is x.

    View n takes part at p if it is compared and not the reference (|o_n| > 1e-3), p - d_l o_n lies in the frame (0 to
    width - 1, 0 to height - 1) and the recorded pixel nearest to it (x + 1/2 rounded down) is valid. What no view takes
    part in costs the most there is, (r(truncation) + w gradient_truncation) / (1 + w). The shifts -d_l o_n are
    `sweep_shifts`, so that no rounding in float32 decides what lies in the frame and which pixel is nearest.
    """

    def room(self, stored: Any) -> int:
        """Count the floats of memory that `load` needs for views of a NumPy type; 0 if it has its own in any case."""

    def load(self, image: Array, recorded: Array, valid: Array | None, room: Array | None = None) -> None:
        """Take a reference image [y, x, c] and `recorded` views [n, y, x, c] with their `valid` [n, y, x] or None.

        `recorded` is copied, into the field `room` if it is large enough; it and the others must stay as they are
        until the next call.
        """

    def by_view_sets(self, cost: SweepCost, volume_out: Array) -> None:
        """volume [l, y, x]: the smallest of the mean costs over the view sets.

        The mean cost of a set is that of c_n over the views of the set that take part. The first set, all views, counts
        as it is; each other one counts times (1 + preference), plus 1e-4, so that noise does not choose it. Where a
        nearer surface hides p from some views, a set without these views still sees it.
        """

    def by_visibility(self, nearest: Array, cost: SweepCost, volume_out: Array) -> None:
        """volume [l, y, x]: the mean cost over the views that see p at d_l past the surface in `nearest` [m, y, x].

        It is the mean of c_n over the views that take part and for which d_l >= nearest_n - tolerance at the pixel
        nearest to p - d_l o_n; with fewer than `least` of them, the most there is. See `KernelSet.z_buffer`.
        """


class ZBuffer(Protocol):
    """The nearest surface that comes near each pixel of each view, planned for views of one size."""

    def __call__(self, disparity: Array, offsets: Array, nearest_out: Array, *, reach: int) -> None:
        """nearest [m, y, x]: the largest of the disparities [y, x] that come near a pixel of a view.

        Views beyond the `offsets` [n, 2], or whose offsets are NaN, are left as they are: nobody reads them.

        It is the maximum of d_p over the reference pixels p for which p - d_p o_n, rounded (x + 1/2 down), is at most
        `reach` pixels away in x and in y, also beyond the frame; where there is none, at most `reach` + 1; where
        there is still none, -1e6.
        """


class Alignment(Protocol):
    """Gauss-Newton on how well the views agree with each other at a disparity map, planned for light fields of a kind.

    With the features f(V) = (V, w V_x, w V_y), V = scale * recorded continued beyond its border by its border pixels,
    and central differences; F_n(p) = f(V_n) and G_n(p) = grad f(V_n), by central differences of f, at p - d(p) o_n,
    bilinear. View n takes part where `PlaneSweep` says and where d(p) >= nearest_n - tolerance at the pixel nearest to
    p - d(p) o_n. Its weight is k_n(r) = 1 / (1 + mean r^2 / robust^2)^2, mean over the features, 0 where it takes no
    part.

    Views whose offsets are NaN take no part. Plans may share what they `load`; then one of them does.

    w(p) is gradient_weight times what `edge_weights` is for the reference, `contrast` and GRADIENT_REACH.
    """

    def room(self, stored: Any) -> int:
        """Count the floats of memory that `load` needs for views of a NumPy type; 0 if it has its own in any case."""

    def load(self, image: Array, recorded: Array, valid: Array | None, room: Array | None = None) -> None:
        """Take a reference image [y, x, c] and `recorded` views [n, y, x, c] with their `valid` [n, y, x] or None.

        `recorded` is copied, into the field `room` if it is large enough; it and the others must stay as they are
        until the next call.
        """

    def __call__(self, disparity: Array, nearest: Array, curvature_out: Array, slope_out: Array) -> None:
        """Fields [y, x]: curvature = sum_n k_n mean F_n'^2 / N and slope = -sum_n k_n mean F_n' (F_n - F) / N.

        What the views are compared with is their own robust mean F = (f(I) + sum_n k_n F_n) / (1 + sum_n k_n), these
        k_n at F_n - f(I), those above at F_n - F: so the noise of the reference view is but one of many. The derivative
        of F_n with respect to d is taken as F_n' = -o_n . G with G = (grad f(I) + sum_n k_n G_n) / (1 + sum_n k_n),
        these k_n again at F_n - F: where the views show nothing but noise, it is next to nothing. N counts all views
        but the reference, whose |o_n| is at most 1e-3; without any other, both are 0. slope / curvature is the step
        that Gauss and Newton would take.
        """


class Matching(Protocol):
    """Plane sweeps, cost volumes [l, y, x], alignment and boundaries."""

    def plane_sweep(
        self,
        shape: Sequence[int],
        views: ViewSets,
        disparities: Disparities,
        *,
        scale: float,
        shared: PlaneSweep | None = None,
    ) -> PlaneSweep:
        """Plan a sweep over views of `shape` [n, y, x, c]; the fields in `views` are read once.

        It compares some of the views that `shared` compares and loads, at the same disparities, if that is given.
        """

    def z_buffer(self, size: Sequence[int], device: str, *, reach: int) -> ZBuffer:
        """Plan the nearest surfaces in views of a size (y, x), with a reach of up to so many pixels, 0 to 100."""

    def alignment(
        self,
        shape: Sequence[int],
        offsets: Array,
        *,
        scale: float,
        gradient_weight: float,
        contrast: float,
        robust: float,
        tolerance: float,
        shared: Alignment | None = None,
    ) -> Alignment:
        """Plan the alignment of views of `shape` [n, y, x, c].

        It compares some of the views that `shared` loads, with the same weights of gradients, if that is given.
        """

    def semi_global(
        self,
        volume: Array,
        image: Array,
        penalty_scale: Array,
        *,
        small: float,
        large: float,
        contrast: float,
        sum_out: Array,
    ) -> None:
        """Sum the costs [l, y, x] of the best paths to each pixel from eight directions r (Hirschmüller 2008).

        L_r(p, l) = C(p, l) + min(L_r(p - r, l), L_r(p - r, l -+ 1) + s, min_k L_r(p - r, k) + t) - min_k L_r(p - r, k),
        and C itself where p - r lies outside. With a = exp(-mean_c |I(p) - I(p - r)| / contrast) a step of one costs
        s = small * max(a, 0.2) and one of more t = max(large * a, 1.2 * small), both times `penalty_scale` [y, x] at p.
        `image` is float32 [y, x, c].
        """

    def edge_weights(self, image: Array, *, contrast: float, reach: int, weights_out: Array) -> None:
        """1 / (1 + (e / contrast)^2) for each pixel p of an image [y, x, c]; contrast > 0, `reach` 1 to 100.

        e is the largest difference between pixels that lie side by side or one above the other, as a mean over
        channels; both at most `reach` from p in x and in y. Without any two such pixels it is 0.
        """

    def add_reduced(self, reduced: Array, shares: Array, *, weight: float, volume_inout: Array) -> None:
        """Add weight * R to a volume [l, y, x]; R is `shares` * `reduced`, interpolated.

        `reduced` is [l, y // REDUCTION, x // REDUCTION], and `shares` [y // REDUCTION, x // REDUCTION] for all l.
        Between the centres of its pixels R is linear in y and in x, beyond them it stays what it is there.
        """

    def least_costs(self, volume: Array, *, least_out: Array) -> None:
        """Compute the least of the costs of each pixel, [y, x]."""

    def winner_takes_all(self, volume: Array, *, first: float, step: float, disparity_out: Array) -> None:
        """Compute the disparity [y, x] of least cost: first + step * (k + t), count >= 3.

        k is the first of the least costs, but at least 1 and at most count - 2; t the minimum of the parabola through
        the costs at k - 1, k and k + 1, in -1 to 1, 0 where they do not bend upwards by more than 1e-9.
        """

    def evidence(
        self,
        volume: Array,
        path_costs: Array,
        *,
        step: float,
        unit: float,
        conflict_out: Array,
        evidence_out: Array,
        cost_out: Array,
    ) -> None:
        """Derive evidence about each pixel from costs C [l, y, x] and their sums S [l, y, x] by `semi_global`.

        conflict = log(max(min S / 8 - min C, 0) / unit + 0.03): how much more the best surface through a pixel costs
        than its best disparity.
        evidence = -log(step * sum_l exp(-2 (C_l - min C) / unit)): one over the width of the disparities that are as
        good as the best one, 1 / (pixels per view step). Disparities are `step` apart.
        cost = log(max(min C / unit, 1)): how much views differ where they agree best.
        """

    def line_mean(self, values: Array, *, axis: int, reach: int, means_out: Array) -> None:
        """Compute the mean over each pixel of a map [y, x] and the `reach` >= 0 on either side along an axis, 0 or 1.

        Only pixels in the image count. `means_out` is not `values`.
        """

    def unevenness(self, disparity: Array, *, bend_out: Array, relief_out: Array) -> None:
        """Measure how far a map [y, x] is from a plane, and from one disparity, around each pixel.

        b_q = (|d_(q+r) - 2 d_q + d_(q-r)| + ..) / 4 with the steps r to the right, down and along both diagonals; bend
        is the mean of log(b_q + 0.001) over 3 x 3 pixels, relief = log(max d - min d + 0.01) over 5 x 5. Beyond its
        border the map goes on with its border pixels. No output is `disparity`.
        """

    def judge(
        self,
        maps: Sequence[Array],
        *,
        span: float,
        share: Sequence[float],
        spread: Sequence[float],
        confidence_out: Array,
        variance_out: Array,
    ) -> None:
        """confidence = a (1 - u) / (1 + exp(-share . f)) and variance = (1 - u) exp(spread . f) + u span^2 / 12.

        With conflict, evidence, bend, relief, wide and cost in `maps` f = (1, conflict, evidence, bend, relief, bend
        relief). Wide is the evidence farther around, and `span` > 0 what was searched, pixels per view step: u =
        min(exp(-wide) / span, 1)^8 / 2 is a half where all disparities are as good as the best one, as the map is then
        a guess, and soon 0 where they are not. Cost is that farther around: a = 1 / (1 + (exp(cost) / 2.6)^12) is soon
        0 where views that should agree show different things.
        """

    def refine_boundaries(
        self, image: Array, disparity: Array, *, step: float, contrast: float, share: float, disparity_out: Array
    ) -> None:
        """Give pixels that show little of what is nearer to what is behind it; `image` is float32 [y, x, c], >= 0.

        Of the pixels q at most REACH pixels from p, other than p, those are in front whose disparity differs
        from d_p by at most `step` and beside which, in 3 x 3 pixels, none is farther by more than `step`; those are
        behind for which d_q < d_p - step. Weights are exp(-|q - p|^2 / 3), but of pixels behind beside which there is
        something nearer by more than `step` a thousandth of that, as they may be mixtures too. With the light
        L = I^2, those behind give the mean light B and the mean disparity D; with m and V, mean and covariance of the
        places q - p of those in front, and C the covariance of their places and light,

            F = max(0, mean L - C (V + 0.3)^-1 m),

        what a plane through their light says of p (0.3 pixel^2 times the unit matrix).

        p becomes D if something beside it is farther by more than `step`, there are pixels of both kinds, and
        (L_p - B) . (F - B) < share |F - B|^2 with |sqrt F - sqrt B|^2 > c contrast^2 (sums over c channels); all else
        stays.
        `disparity_out` is not `disparity`.
        """


def sweep_shifts(offsets: NDArray[Any], disparities: Disparities) -> Float64Array:
    """Compute the shifts [l, n, 2] that a plane sweep adds to positions in x and y: -d_l o_n.

    Rounded to whole multiples of 2^-16: position and shift then add up exactly, and a shift that should be whole is.
    """
    d = disparities.first + disparities.step * np.arange(disparities.count)
    return -np.rint(2.0**16 * d[:, None, None] * np.asarray(offsets, np.float64)) / 2.0**16
