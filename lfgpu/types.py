"""The contract between the host side and the kernels: what a backend is.

Shapes are written [n, y, x, c]: view, row, column, channel. Disparities are in pixels per view step, larger is nearer;
offsets are (du, dv) in view steps; intensities lie in [0, 1], stored ones after multiplication with `scale`.

A backend is the operations of `KernelSet` on arrays of its own and nothing else. Operations write into arrays that the
caller allocated (names end in `_out`) and run on the device that holds them. What is called again and again is a plan
(`DataTerm`, `LocalEstimate`): it allocates what it needs once, when it is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = Any
"""An array on a device, of whatever type the backend uses; only its own backend looks inside."""

Float64Array: TypeAlias = NDArray[np.float64]
Float32Array: TypeAlias = NDArray[np.float32]


class DataTerm(Protocol):
    """The squared distance of the predicted from the recorded views, planned for one light field on one device."""

    def __call__(self, disparity: Array, gradient_out: Array) -> float:
        """Sum over views, pixels and channels of (predicted - recorded)^2 where the recorded views are valid.

        `disparity` and `gradient_out` are fields [y, x]; the gradient with respect to the disparity is written.
        """


class LocalEstimate(Protocol):
    """Structure tensors on the epipolar plane images of one line of views, planned once."""

    def __call__(self, shear: float, disparity_out: Array, coherence_out: Array) -> None:
        """Disparity and coherence (0 to 1) of the reference view, fields [y, x], from EPIs sheared by `shear`.

        With E(u, x) = epis[u, y, x - shear * u] and J the outer-smoothed tensor of its gradient (E_x, E_u),
        disparity = shear + tan(atan2(2 J_xu, J_xx - J_uu) / 2), which is right for disparities within about 1 of
        `shear`, and coherence = ((J_xx - J_uu)^2 + 4 J_xu^2) / (J_xx + J_uu + floor^2)^2.
        """


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

    # --- memory ---

    def field(self, values: NDArray[Any], device: str) -> Array:
        """A copy of `values` (any shape) on the device as scalars of `dtype`."""

    def image(self, values: NDArray[Any], device: str) -> Array:
        """`values` [..., c] (uint8, uint16, float32; c = 1 or 3) on the device as they are stored."""

    def zeros(self, shape: Sequence[int], device: str) -> Array:
        """A field of zeros."""

    def zeros_image(self, shape: Sequence[int], device: str) -> Array:
        """An image of zeros of `dtype`; `shape` is [..., c]."""

    def numpy(self, array: Array) -> NDArray[Any]:
        """What a field or an image holds, as a NumPy array with the channels last."""

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

    def data_term(
        self,
        image: Array,
        recorded: Array,
        valid: Array | None,
        offsets: Array,
        *,
        scale: float,
        softness: float,
    ) -> DataTerm:
        """Plan ||A(d) I - scale * recorded||^2 and its gradient for `recorded` [n, y, x, c] as stored.

        `valid` [n, y, x] is a field, 0 where a recorded pixel does not count; None counts all.
        """

    # --- the non-local-means prior ---

    def nlm_weights(
        self,
        image: Array,
        *,
        window: int,
        patch: int,
        sigma_color: float,
        sigma_gradient: float,
        floor: float,
        scratch_out: Array,
        weights_out: Array,
    ) -> None:
        """Weights [k, y, x] of each pixel p with p + half_window(window)[k]; 0 where that lies outside, else >= floor.

        `scratch_out` is a field of the same shape whose contents mean nothing afterwards.
        """

    def nlm_neighbors(self, weights: Array, values: Array, *, window: int, sums_out: Array) -> None:
        """W v: the weighted sum [y, x] of `values` [y, x] over each pixel's window, itself (weight 1) included."""

    def nlm_laplacian(self, weights: Array, values: Array, *, window: int, laplacian_out: Array) -> None:
        """L v with (L v)_p = sum_q w_pq (v_p - v_q): then sum_pq w_pq (v_p - v_q)^2 = 2 v^T L v."""

    # --- the local estimate ---

    def structure_tensor(
        self, epis: Array, offsets: Array, filters: StructureFilters, *, scale: float, floor: float
    ) -> LocalEstimate:
        """Plan structure tensors on the EPIs [u, y, x, c] (as stored) of one line of views along x.

        `offsets` [u] is each view's place relative to the reference; `filters` holds fields; `floor` is the gradient
        (intensity per pixel) that is taken for noise.
        """

    # --- vectors: fields of one shape ---

    def dot(self, a: Array, b: Array) -> float:
        """Sum of products, accumulated in float64."""

    def copy(self, source: Array, target_out: Array) -> None:
        """target = source."""

    def axpby(self, alpha: float, x: Array, beta: float, y: Array, y_out: Array) -> None:
        """y_out = alpha x + beta y; `y_out` may be `x` or `y`."""

    def multiply(self, x: Array, y: Array, product_out: Array) -> None:
        """Element by element; `product_out` may be `x` or `y`."""

    def clamp(self, x: Array, low: float, high: float, x_out: Array) -> None:
        """Each element moved into [low, high]; `x_out` may be `x`."""


def half_window(window: int) -> NDArray[np.int64]:
    """The offsets (dy, dx) of one half of a window of odd side `window`: [k, 2], those after the centre in row order.

    Weights are symmetric, w(p, q) = w(q, p), so one half says all.
    """
    radius = window // 2
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1)
    after = (dy > 0) | ((dy == 0) & (dx > 0))
    return np.stack([dy[after], dx[after]], axis=1)
