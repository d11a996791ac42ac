"""The contract between the host side and the kernels: what a backend is.

Shapes are written [n, y, x, c]: view, row, column, channel. Disparities are in pixels per view step, larger is nearer;
offsets are (du, dv) in view steps; intensities lie in [0, 1], stored ones after multiplication with `scale`.

A backend is the operations of `KernelSet` on arrays of its own and nothing else. Operations write into arrays that the
caller allocated (names end in `_out`) and run on the device that holds them. What is called again and again is a plan
(`DataTerm`, `PlaneSweep`): it allocates what it needs once, when it is made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = Any
"""An array on a device, of whatever type the backend uses; only its own backend looks inside."""

Float64Array: TypeAlias = NDArray[np.float64]
Float32Array: TypeAlias = NDArray[np.float32]


Scalar: TypeAlias = Any
"""One float64 number on a device; `KernelSet.number` waits for it."""


REACH = 2
"""Rows and columns from a pixel to the farthest ones that `KernelSet.unmix` looks at."""


class DataTerm(Protocol):
    """How far the predicted views are from the recorded ones, planned for light fields of one kind."""

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        """Take a reference image [y, x, c] and `recorded` views [n, y, x, c]: what is compared from now on.

        `valid` [n, y, x] is a field, 0 where a recorded pixel does not count; None counts all.
        """

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        """The sum over views and pixels that `data_term` or `occluding_data_term` says, where recorded views are valid.

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
"""How much a residual counts, see `KernelSet.occluding_data_term`."""


class LocalEstimate(Protocol):
    """Structure tensors on the epipolar plane images of one line of views, planned once."""

    def __call__(self, epis: Array, shear: float, disparity_out: Array, coherence_out: Array) -> None:
        """Disparity and coherence (0 to 1) of the reference view, fields [y, x], from `epis` sheared by `shear`.

        `epis` [u, y, x, c] are stored values. With E(u, x) = scale * epis[u, y, x - shear * u] and J the outer-smoothed
        tensor of its gradient (E_x, E_u), disparity = shear + tan(atan2(2 J_xu, J_xx - J_uu) / 2), which is right for
        disparities within about 1 of `shear`, and coherence = ((J_xx - J_uu)^2 + 4 J_xu^2) / (J_xx + J_uu + floor^2)^2.
        """


class NlmWeights(Protocol):
    """Non-local-means weights of images of one shape, planned once."""

    def __call__(self, image: Array, weights_out: Array) -> None:
        """Weights [k, y, x] of each pixel p with p + half_window(window)[k]; 0 where that lies outside, else >= floor.

        `image` is float32 [y, x, c].
        """


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


class PlaneSweep(Protocol):
    """How well the views agree with the reference view if all of the scene lay at one disparity, for a row of them.

    Planned for light fields of one kind: views [n, y, x, c], disparities d_l = first + l * step, l < count. With
    W_n(p) = scale * recorded_n at p - d_l o_n (bilinear, the position moved into the frame), D = W_n - I and G its
    central differences in x and y, (D(p + 1) - D(p - 1)) / 2 with the border pixels of D repeated,

        c_n(p) = (min(mean_c |D|, truncation) + w min(mean_(c, x, y) |G|, gradient_truncation)) / (1 + w),
        w = gradient_weight.

    View n takes part at p if it is not the reference (|o_n| > 1e-3), p - d_l o_n lies in the frame (0 to width - 1, 0
    to height - 1) and the recorded pixel nearest to it (x + 1/2 rounded down) is valid. What no view takes part in
    costs the most there is, (truncation + w gradient_truncation) / (1 + w). The shifts -d_l o_n are `sweep_shifts`, so
    that no rounding in float32 decides what lies in the frame and which pixel is nearest.
    """

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        """Take a reference image [y, x, c] and `recorded` views [n, y, x, c] with their `valid` [n, y, x] or None."""

    def apertures(self, volume_out: Array) -> None:
        """volume [l, y, x]: the least over the apertures of the mean of c_n over the views of the aperture that take
        part; that of the first aperture as it is, of the others times (1 + preference), plus 1e-4.

        Where something nearer hides p from some views, an aperture without these still sees it (those on one side
        of the reference). The preference keeps noise from choosing.
        """

    def seen(self, nearest: Array, volume_out: Array) -> None:
        """volume [l, y, x]: the mean of c_n over the views that take part and see p at d_l, if there are `least`.

        View n sees it if d_l >= nearest [n, y, x] - tolerance at the pixel nearest to p - d_l o_n: see
        `KernelSet.nearest_surface`.
        """


class NearestSurface(Protocol):
    """The nearest surface that comes near each pixel of each view, planned for light fields of one kind."""

    def __call__(self, disparity: Array, nearest_out: Array) -> None:
        """nearest [n, y, x]: the largest of the disparities [y, x] that come near a pixel of a view.

        It is the maximum of d_p over the reference pixels p for which p - d_p o_n, rounded (x + 1/2 down), is at most
        `reach` pixels away in x and in y, also beyond the frame; where there is none, at most `reach` + 1; where
        there is still none, -1e6.
        """


class Alignment(Protocol):
    """Gauss-Newton on how well the views agree with each other at a disparity map, planned for light fields of a kind.

    With the features f(V) = (V, w V_x, w V_y), V = scale * recorded continued beyond its border by its border pixels,
    central differences and w = gradient_weight; F_n(p) = f(V_n) at p - d(p) o_n, bilinear, and F_n' its derivative with
    respect to d, -(o_n . grad f), grad by central differences of f interpolated bilinearly in the same place. View n
    takes part where `PlaneSweep` says and where d(p) >= nearest_n - tolerance at the pixel nearest to p - d(p) o_n.
    Its weight is k_n(r) = 1 / (1 + mean r^2 / robust^2)^2, mean over the features, 0 where it takes no part.
    """

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        """Take a reference image [y, x, c] and `recorded` views [n, y, x, c] with their `valid` [n, y, x] or None."""

    def __call__(self, disparity: Array, nearest: Array, curvature_out: Array, slope_out: Array) -> None:
        """Fields [y, x]: curvature = sum_n k_n mean F_n'^2 / N and slope = -sum_n k_n mean F_n' (F_n - F) / N.

        What the views are compared with is their own robust mean F = (f(I) + sum_n k_n F_n) / (1 + sum_n k_n), these
        k_n at F_n - f(I), those above at F_n - F: so the noise of the reference view is but one of many. N counts all
        views but the reference, whose |o_n| is at most 1e-3; without any other, both are 0. slope / curvature is the
        step that Gauss and Newton would take.
        """


class Residuals(Protocol):
    """What is left after each iteration of a linear solver, and whether that is little enough, on a device."""

    go_on: Scalar
    """1 while there is something to do, else 0."""

    def begin(self, norm: Scalar) -> None:
        """Forget everything; residuals are relative to `norm`, or to 1 if that is 0."""

    def add(self, residual: Scalar) -> None:
        """Add sqrt(max(residual, 0) / norm) to the trace; `go_on` becomes 1 if it is larger than the tolerance and less
        than `most` + 1 are there, else 0.
        """

    def report(self) -> list[float]:
        """The trace; waits for the device."""


class Lbfgs(Protocol):
    """The memory of a limited-memory BFGS solver for fields of one shape within bounds, on a device.

    It holds the last m steps s_j and gradient differences y_j, the direction, the step length and what it takes to
    decide without the host. `solvers/lbfgs.py` is the algorithm. Pixels have units of their own: with c the curvature
    that `begin` is given, x is measured in 1 / √c and the gradient in √c, in inner products and in the recursion.
    """

    go_on: Scalar
    """1 while there is something to do, else 0."""

    def begin(self, x: Array, gradient: Array, value: Scalar, curvature: Array | None = None) -> None:
        """Forget everything; the first direction is against the gradient where the bounds leave it free.

        Its length is such that the root mean square of the first step, in those units, is `first_step`. `curvature`
        [y, x] > 0 is about the second derivative by each pixel, up to a factor; None is 1 everywhere.
        """

    def propose(self, x: Array, trial_out: Array) -> None:
        """trial = x + step * direction, moved into the bounds."""

    def judge(self, value: Scalar, trial_value: Scalar) -> None:
        """Accept the trial if trial_value <= value + 1e-4 * step * slope, the slope being gradient . direction.

        Accepted, `value` becomes `trial_value`, which is added to the trace, and `go_on` becomes 0 if the trace is flat
        (see `solvers/lbfgs.py`) or as long as it may be. Not accepted, the step shrinks to the minimum of the parabola
        through both values and the slope, but between 0.1 and 0.5 of what it was; `go_on` becomes 0 after 20 in a row.
        """

    def learn(self, x: Array, gradient: Array, trial: Array, trial_gradient: Array) -> None:
        """If the trial was accepted: keep s = trial - x and y = trial_gradient - gradient, if s . y is clearly positive
        (> 1e-10 |s| |y|), and let x and gradient become those of the trial. The next direction is that of the two-loop
        recursion (Nocedal 1980) on the gradient, with 0 where the bounds stop it, and its step is 1. A pixel at a bound
        that its gradient holds there does not move, whatever the recursion says.
        """

    def report(self) -> tuple[list[float], int, bool]:
        """The values accepted so far, the first included, the number of values judged plus 1, and whether they are
        flat; waits for the device."""


class StructureFilters(NamedTuple):
    """The separable filters of a structure tensor: along the views (one set per place of the outer window) and across.

    A gradient is the slope filter in its own direction and the value filter in the other one.
    """

    along_value: Any  # [m, u]
    along_slope: Any  # [m, u]
    along_outer: Any  # [m]
    across_value: Any  # [2 r + 1]
    across_slope: Any  # [2 r + 1]
    across_outer: Any  # [2 r' + 1]


class KernelSet(Protocol):
    """One backend: memory, the operations of the method, and the vector operations of a solver."""

    @property
    def name(self) -> str:
        """The name under which the backend is asked for."""

    @property
    def dtype(self) -> type[np.floating[Any]]:
        """What fields are made of: float32 on devices, float64 in the reference."""

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that can be used here, the default first."""

    def is_deterministic(self, device: str) -> bool:
        """Whether an estimate on this device has the same bits each time, whatever the number of threads."""

    # --- memory ---

    def field(self, values: NDArray[Any], device: str) -> Array:
        """A copy of `values` (any shape) on the device as scalars of `dtype`."""

    def image(self, values: NDArray[Any], device: str) -> Array:
        """`values` [..., c] (uint8, uint16, float16, float32; c = 1 or 3) on the device as they are stored."""

    def zeros(self, shape: Sequence[int], device: str) -> Array:
        """A field of zeros."""

    def zeros_image(self, shape: Sequence[int], device: str, stored: Any = np.float32) -> Array:
        """An image of zeros of the NumPy type `stored`; `shape` is [..., c]."""

    def scalar(self, value: float, device: str) -> Scalar:
        """A number on the device."""

    def upload(self, values: NDArray[Any], array_out: Array) -> None:
        """New contents of a field or an image, of the same shape and, for an image, the type that it is stored in.

        A backend may also take arrays of other libraries (`__dlpack__` or `__cuda_array_interface__`) on the device
        itself, and then copies there: after what their library was asked for before, and before what it is asked for
        later.
        """

    def shared(self, field: Array) -> Any:
        """The field itself as an array that other libraries take without a copy: `__dlpack__`, and on the host
        `__array_interface__`, on a GPU `__cuda_array_interface__`; who takes it reads it after what was asked for
        before. BackendError where a backend has no such arrays.
        """

    def numpy(self, array: Array) -> NDArray[Any]:
        """What a field or an image holds, as a NumPy array with the channels last; waits for the device."""

    def number(self, scalar: Scalar) -> float:
        """What a scalar holds; waits for the device."""

    # --- control ---

    def repeat(self, body: Callable[[], None], go_on: Scalar, most: int) -> None:
        """Call `body` as long as `go_on` is not 0, which is looked at before each call, and at most `most` times.

        `body` asks for operations only, and one of them sets `go_on`. While work is captured (`capture`) the device
        itself repeats it.
        """

    def capture(self, work: Callable[[], None], device: str) -> Callable[[], None] | None:
        """What does `work` again as a whole, without the host; None where the device cannot be given work that way.

        `work` asks for operations only. It must have run once before, so that all kernels are loaded.
        """

    # --- views ---

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

    # --- the forward splat L(d) = A(d) I, sum_p I(p) Λ(x - x_p + d du) Λ(y - y_p + d dv) ---

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

    # --- the splat with occlusions: what is nearer hides what is behind it ---

    def splat_occluding(
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

    def occluding_data_term(
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
        """Plan the loss of L - scale * recorded for views of `shape` [n, y, x, c], with L of `splat_occluding`.

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

    # --- the non-local-means prior ---

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
    ) -> NlmWeights:
        """Plan the weights of images of `shape` [y, x, c]."""

    def nlm_neighbors(self, weights: Array, values: Array, *, window: int, sums_out: Array) -> None:
        """W v: the weighted sum [y, x] of `values` [y, x] over each pixel's window, itself (weight 1) included."""

    def nlm_laplacian(self, weights: Array, values: Array, *, window: int, laplacian_out: Array) -> None:
        """L v with (L v)_p = sum_q w_pq (v_p - v_q): then sum_pq w_pq (v_p - v_q)^2 = 2 v^T L v."""

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

    def nlm_on_surface(self, weights: Array, guide: Array, *, window: int, support: float, weights_out: Array) -> None:
        """v_pq of `nlm_ratio` as weights [k, y, x]; `weights_out` is not `weights`."""

    # --- outlines ---

    def unmix(
        self, image: Array, disparity: Array, *, step: float, contrast: float, share: float, disparity_out: Array
    ) -> None:
        """Give pixels that show little of what is nearer to what is behind it; `image` is float32 [y, x, c].

        Of the pixels q at most REACH rows and columns from p, other than p, those are in front whose disparity differs
        from d_p by at most `step` and beside which, in 3 x 3 pixels, none is farther by more than `step`; those are
        behind for which d_q < d_p - step. With weights exp(-|q - p|^2 / 0.7) the first give the mean colour F, and the
        second the mean colour B and the mean disparity D; of these, q beside which there is something nearer by more
        than `step` count a thousandth, as they may be mixtures too.

        p becomes D if something beside it is farther by more than `step`, there are pixels of both kinds, and
        (I_p - B) . (F - B) < share |F - B|^2 with |F - B|^2 > c contrast^2 (sums over c channels); all else stays.
        `disparity_out` is not `disparity`.
        """

    # --- the local estimate ---

    def structure_tensor(
        self, shape: Sequence[int], offsets: Array, filters: StructureFilters, *, scale: float, floor: float
    ) -> LocalEstimate:
        """Plan structure tensors on EPIs of `shape` [u, y, x, c] of one line of views along x.

        `offsets` [u] is each view's place relative to the reference; `filters` holds fields; `floor` is the gradient
        (intensity per pixel) that is taken for noise.
        """

    def keep_more_coherent(
        self,
        disparity: Array,
        coherence: Array,
        trusted: Array | None,
        *,
        shear: float,
        reach: float,
        unit: float,
        low: float,
        high: float,
        vertical: bool,
        best_disparity_out: Array,
        best_coherence_out: Array,
    ) -> None:
        """Where an estimate is better than the best so far, it becomes the best.

        It is if |disparity - shear| <= reach, low <= disparity / unit <= high, `trusted` (a field of its shape) is not
        0 or None, and its coherence is larger; the best disparity becomes disparity / unit. If `vertical`, estimate and
        `trusted` are [x, y] where the best are [y, x].
        """

    # --- how well views agree ---

    def plane_sweep(
        self,
        shape: Sequence[int],
        offsets: Array,
        apertures: Array,
        *,
        first: float,
        step: float,
        count: int,
        scale: float,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        preference: float,
        tolerance: float,
        least: int,
    ) -> PlaneSweep:
        """Plan a sweep over views of `shape` [n, y, x, c]; `apertures` [m, n] is a field of 1 and 0, row 0 all 1.

        There are at most 32 apertures; truncations, weight, preference and tolerance are >= 0, `count` and `least` > 0.
        What `offsets` and `apertures` hold is read once, when the sweep is planned.
        """

    def nearest_surface(self, shape: Sequence[int], offsets: Array, *, reach: int) -> NearestSurface:
        """Plan the nearest surfaces of views of `shape` [n, y, x, c]; `reach` is in pixels, >= 0."""

    def alignment(
        self,
        shape: Sequence[int],
        offsets: Array,
        *,
        scale: float,
        gradient_weight: float,
        robust: float,
        tolerance: float,
    ) -> Alignment:
        """Plan the alignment of views of `shape` [n, y, x, c]."""

    # --- cost volumes [l, y, x] ---

    def nlm_average(self, weights: Array, volume: Array, *, window: int, average_out: Array) -> None:
        """Each slice averaged over each pixel's window with the non-local-means weights, itself with weight 1.

        average_p = (volume_p + sum_q w_pq volume_q) / (1 + sum_q w_pq) over all q of the window that lie in the image.
        """

    def semi_global(
        self, volume: Array, image: Array, *, small: float, large: float, contrast: float, sum_out: Array
    ) -> None:
        """The sum [l, y, x] over eight directions r of the costs of the best path to each pixel (Hirschmüller 2008).

        L_r(p, l) = C(p, l) + min(L_r(p - r, l), L_r(p - r, l -+ 1) + s, min_k L_r(p - r, k) + t) - min_k L_r(p - r, k),
        and C itself where p - r lies outside. With a = exp(-mean_c |I(p) - I(p - r)| / contrast) a step of one costs
        s = small * max(a, 0.2) and one of more t = max(large * a, 1.2 * small). `image` is float32 [y, x, c].
        """

    def lowest(self, volume: Array, *, first: float, step: float, disparity_out: Array) -> None:
        """The disparity [y, x] of least cost: first + step * (k + t), count >= 3.

        k is the first of the least costs, but at least 1 and at most count - 2; t the minimum of the parabola through
        the costs at k - 1, k and k + 1, in -1 to 1, 0 where they do not bend upwards by more than 1e-9.
        """

    # --- vectors: fields of one shape ---

    def dot(self, a: Array, b: Array, product_out: Scalar) -> None:
        """Sum of products, accumulated in float64."""

    def ratio(self, numerator: Scalar, denominator: Scalar, ratio_out: Scalar, *, factor: float = 1.0) -> None:
        """factor * numerator / denominator; 0 where the denominator is 0. `ratio_out` may be one of them."""

    def copy(self, source: Array, target_out: Array) -> None:
        """target = source, for fields, or for scalars."""

    def axpby(self, alpha: float | Scalar, x: Array, beta: float | Scalar, y: Array, y_out: Array) -> None:
        """y_out = alpha x + beta y; `y_out` may be `x` or `y`. Also for scalars x, y and y_out, with plain numbers."""

    def multiply(self, x: Array, y: Array, product_out: Array) -> None:
        """Element by element; `product_out` may be `x` or `y`."""

    def divide(self, x: Array, y: Array, quotient_out: Array) -> None:
        """Element by element, 0 where y is 0; `quotient_out` may be `x` or `y`."""

    def fill(self, value: float | Scalar, x_out: Array) -> None:
        """Each element becomes `value`."""

    def choose(self, condition: Array, x: Array, y: Array, chosen_out: Array) -> None:
        """x where the condition is > 0, else y, element by element; `chosen_out` may be any of them."""

    def at_least(self, x: Array, threshold: float, x_out: Array) -> None:
        """x where x >= threshold, else 0; `x_out` may be `x`."""

    def clamp(self, x: Array, low: float, high: float, x_out: Array) -> None:
        """Each element moved into [low, high]; `x_out` may be `x`."""

    # --- solvers ---

    def residuals(self, device: str, *, tolerance: float, most: int) -> Residuals:
        """Plan the bookkeeping of an iterative linear solver that makes at most `most` iterations."""

    def lbfgs(
        self,
        shape: Sequence[int],
        device: str,
        *,
        memory: int,
        low: float,
        high: float,
        first_step: float,
        tolerance: float,
        patience: int,
        most: int,
    ) -> Lbfgs:
        """Plan an L-BFGS memory of `memory` pairs for fields of `shape` [y, x]; `most` is the longest trace less 1.

        The trace is flat when its last `patience` steps together lowered the value by at most patience * tolerance *
        |first value|.
        """


def half_window(window: int) -> NDArray[np.int64]:
    """The offsets (dy, dx) of one half of a window of odd side `window`: [k, 2], those after the centre in row order.

    Weights are symmetric, w(p, q) = w(q, p), so one half says all.
    """
    radius = window // 2
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1)
    after = (dy > 0) | ((dy == 0) & (dx > 0))
    return np.stack([dy[after], dx[after]], axis=1)


def sweep_shifts(offsets: NDArray[Any], *, first: float, step: float, count: int) -> Float64Array:
    """What a plane sweep adds to positions, [l, n, 2] in x and y: -d_l o_n, d_l = first + l * step, l < count.

    Rounded to whole multiples of 2^-16: position and shift then add up exactly, and a shift that should be whole is.
    """
    disparities = first + step * np.arange(count)
    return -np.rint(2.0**16 * disparities[:, None, None] * np.asarray(offsets, np.float64)) / 2.0**16
