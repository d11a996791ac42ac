"""The energy that the refinement minimises: data term plus weighted prior, with its exact gradient."""

from __future__ import annotations

import numpy as np

from lfgpu.model import ForwardModel
from lfgpu.prior import NonLocalMeans
from lfgpu.types import Float64Array


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
        shape = model.shape[1:3]
        self._data_gradient = prior.kernels.zeros(shape, prior.device)
        self._prior_gradient = prior.kernels.zeros(shape, prior.device)

    def __call__(self, disparity: Float64Array) -> tuple[float, Float64Array]:
        """Value and gradient [y, x] at a disparity map [y, x] in pixels per view step."""
        kernels = self._prior.kernels
        field = kernels.field(disparity, self._prior.device)
        value = self._model.value_and_gradient(field, self._data_gradient)
        value += self._smoothness * self._prior.value_and_gradient(field, self._prior_gradient)
        kernels.axpby(1.0, self._data_gradient, self._smoothness, self._prior_gradient, self._data_gradient)
        return value, kernels.numpy(self._data_gradient).astype(np.float64)
