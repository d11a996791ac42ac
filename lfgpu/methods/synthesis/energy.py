"""The energy that the refinement minimises: the data term plus the weighted prior, with its exact gradient."""

from lfgpu.contract import Array, Scalar
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.methods.synthesis.model import ForwardModel
from lfgpu.methods.synthesis.propagation import Propagation

_EVENNESS = 0.75  # share of the mean in the curvature that the solver gets


class Energy:
    """E(d) = a ‖L̃_d - L‖² + λ R(d), with a of the model (paper §6: a = 1) and λ the `smoothness`.

    R is the energy of the propagation `local`, whose minimum the propagated map is (paper, all of eq. 1); or, without
    it, its first part alone, Σ_p Σ_{q∈N(p)} w_pq (v_p - v_q)², of v = d - s with a map s, `start`, or of v = d.
    """

    def __init__(
        self,
        model: ForwardModel,
        prior: NonLocalMeans,
        smoothness: float,
        start: Array | None = None,
        local: Propagation | None = None,
    ) -> None:
        self._model, self._prior, self._smoothness, self._start = model, prior, smoothness, start
        self._local = local
        self._change = None if start is None else prior.device.zeros(model.size)
        self._laplacian = prior.device.zeros(model.size)
        self._half, self._share = (prior.device.scalar(0.0) for _ in range(2))
        self._even_share = prior.device.scalar((1.0 - _EVENNESS) * model.size[0] * model.size[1])
        self.curvature = prior.device.zeros(model.size)
        """The approximate second derivative of the energy by each pixel, divided by its mean: a field [y, x] > 0.

        The solver uses it as a diagonal preconditioner. `load` computes it. Pixels with strong texture have the largest
        values. Each value is blended with the mean, because the second derivative by one pixel alone ignores its
        neighbours: without the blend, pixels with little texture take too long steps and follow the noise.
        """

    def load(self) -> None:
        """Compute the curvature from what the model and the prior have loaded."""
        kernels, prior, curvature, weight = self._prior.kernels, self._prior, self.curvature, 4.0 * self._smoothness
        self._model.squared_error.curvature(curvature)
        kernels.axpby(self._model.mean, curvature, weight, prior.degree, curvature)
        kernels.axpby(1.0, curvature, -weight, prior.ones, curvature)  # a pixel is not its own neighbour
        kernels.dot(curvature, prior.ones, self._share)
        kernels.ratio(self._even_share, self._share, self._share)
        kernels.axpby(self._share, curvature, _EVENNESS, prior.ones, curvature)

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        """Compute the value and the gradient at a disparity map [y, x], pixels per view step."""
        kernels, mean = self._prior.kernels, self._model.mean
        self._model.squared_error(disparity, gradient_out, value_out)
        if self._local is not None:
            self._local.energy(disparity, self._laplacian, self._half)
            kernels.axpby(mean, value_out, self._smoothness, self._half, value_out)
            kernels.axpby(mean, gradient_out, self._smoothness, self._laplacian, gradient_out)
            return
        smoothed = disparity
        if self._change is not None:
            kernels.axpby(1.0, disparity, -1.0, self._start, self._change)
            smoothed = self._change
        self._prior.half(smoothed, self._laplacian, self._half)
        kernels.axpby(mean, value_out, 2.0 * self._smoothness, self._half, value_out)
        kernels.axpby(mean, gradient_out, 4.0 * self._smoothness, self._laplacian, gradient_out)
