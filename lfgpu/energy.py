"""The energy that the refinement minimises: data term plus weighted prior, with its exact gradient."""

from __future__ import annotations

from lfgpu.model import ForwardModel
from lfgpu.prior import NonLocalMeans
from lfgpu.types import Array, Scalar


class Energy:
    """E(d) = mean over views and channels of ‖L̃_d - L‖² + λ R(d) (paper, the refinement objective).

    Parameters
    ----------
    model, prior
        The two terms, on one device.
    smoothness
        λ, >= 0.
    """

    def __init__(self, model: ForwardModel, prior: NonLocalMeans, smoothness: float) -> None:
        self._model, self._prior, self._smoothness = model, prior, smoothness
        self._laplacian = prior.kernels.zeros(model.size, prior.device)
        self._half = prior.kernels.scalar(0.0, prior.device)

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        """Value and gradient at a disparity map, fields [y, x], pixels per view step."""
        kernels, mean = self._prior.kernels, self._model.mean
        self._model.squared_error(disparity, gradient_out, value_out)
        self._prior.half(disparity, self._laplacian, self._half)
        kernels.axpby(mean, value_out, 2.0 * self._smoothness, self._half, value_out)
        kernels.axpby(mean, gradient_out, 4.0 * self._smoothness, self._laplacian, gradient_out)
