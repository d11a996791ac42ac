"""The non-local-means prior: weights between pixels of a reference image, and the operators made of them."""

from collections.abc import Sequence

from lfgpu.contract import Array, Device, OverPatch, PatchGradients, Scalar, half_window
from lfgpu.methods.sections import PriorConfig

UNLIKE_ANY = 10.0
"""The intensity of invalid pixels of the reference: so far from [0, 1] that they resemble only each other."""


class NonLocalMeans:
    """The weights w_pq between pixels of a neighbourhood, computed from a reference image, and their operators.

    The weights and the workspace to compute them take window² floats per pixel. `over_patch` and `gradients` are their
    forms (`lfgpu.contract.NlmWeights`). A `sigma_color` takes the place of that of the parameters.
    """

    def __init__(
        self,
        shape: Sequence[int],
        config: PriorConfig,
        device: Device,
        *,
        over_patch: OverPatch = "mean",
        gradients: PatchGradients = "central",
        sigma_color: float | Scalar | None = None,
    ) -> None:
        kernels = device.kernels
        self.kernels, self.device, self.window = kernels, device, config.window
        self.weights = device.zeros((len(half_window(config.window)), *shape[:2]))
        """[k, y, x] in the order of `half_window`."""
        self._weigh = kernels.nlm_weights(
            shape,
            device.name,
            window=config.window,
            patch=config.patch,
            sigma_color=config.sigma_color if sigma_color is None else sigma_color,
            sigma_gradient=config.sigma_gradient,
            floor=config.floor,
            over_patch=over_patch,
            gradients=gradients,
        )
        self.ones, self.degree = device.zeros(shape[:2]), device.zeros(shape[:2])
        """Fields [y, x]: ones; and W 1, the sum of the weights in each pixel's window, its own weight 1 included."""

    def load(self, image: Array) -> None:
        """Compute the weights of a reference image, float32 [y, x, c] in [0, 1], `UNLIKE_ANY` where it is invalid."""
        self._weigh(image, self.weights)
        self.kernels.fill(1.0, self.ones)
        self.neighbors(self.ones, self.degree)

    def neighbors(self, values: Array, sums_out: Array) -> None:
        """W v: the weighted sum over each pixel's window, the pixel itself included."""
        self.kernels.nlm_neighbors(self.weights, values, window=self.window, sums_out=sums_out)

    def mean(self, values: Array, means_out: Array) -> None:
        """W v / W 1: the weighted mean over each pixel's window."""
        self.neighbors(values, means_out)
        self.kernels.divide(means_out, self.degree, means_out)

    def laplacian(self, values: Array, laplacian_out: Array) -> None:
        """L v, with R(v) = Σ_p Σ_{q∈N(p)} w_pq (v_p - v_q)² = 2 vᵀ L v and ∇R = 4 L v."""
        self.kernels.nlm_laplacian(self.weights, values, window=self.window, laplacian_out=laplacian_out)

    def half(self, values: Array, laplacian_out: Array, half_out: Scalar) -> None:
        """L v, and R(v) / 2 = vᵀ L v."""
        self.laplacian(values, laplacian_out)
        self.kernels.dot(values, laplacian_out, half_out)

    def average(self, volume: Array, average_out: Array) -> None:
        """W v / W 1: the weighted mean over each pixel's window, for each slice of a volume [l, y, x]."""
        self.kernels.nlm_average(self.weights, volume, window=self.window, average_out=average_out)

    def plane(self, values: Array, certainty: Array, *, support: float, ridge: float, plane_out: Array) -> None:
        """Fit planes to the values, weighted by certainty, on the surface around each pixel, and evaluate them at the
        pixel."""
        self.kernels.nlm_plane(
            self.weights, values, certainty, window=self.window, support=support, ridge=ridge, plane_out=plane_out
        )

    def ratio(
        self, guide: Array, numerator: Array, denominator: Array, *, support: float, floor: float, ratio_out: Array
    ) -> None:
        """W' numerator / W' (denominator + floor). W' are the weights, lowered between pixels of different disparity.

        `guide` is the disparity map [y, x] that tells; at a difference of `support` a weight is halved.
        """
        self.kernels.nlm_ratio(
            self.weights,
            guide,
            numerator,
            denominator,
            window=self.window,
            support=support,
            floor=floor,
            ratio_out=ratio_out,
        )
