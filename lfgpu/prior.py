"""The non-local-means prior of one reference image: its weights and what they do to a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu.config import PriorConfig
from lfgpu.types import Array, Float32Array, KernelSet, half_window

_UNLIKE_ANY = 10.0  # an intensity far from all recorded ones: similar to nothing but to others that are not valid


class NonLocalMeans:
    """Weights w_pq of the pixels in each other's window, computed once from the reference image, and their operators.

    Parameters
    ----------
    image
        The reference image, float32 [y, x, c] in [0, 1].
    config
        Window, patch and scales of the weights.
    kernels, device
        Where the weights live; they take window² / 2 floats a pixel.
    valid
        bool [y, x], False where the image means nothing; None is valid everywhere.
    """

    def __init__(
        self,
        image: Float32Array,
        config: PriorConfig,
        kernels: KernelSet,
        device: str,
        valid: NDArray[np.bool_] | None = None,
    ) -> None:
        if valid is not None:
            image = np.where(valid[..., None], image, np.float32(_UNLIKE_ANY))
        self.kernels, self.device, self.window = kernels, device, config.window
        shape = (len(half_window(config.window)), *image.shape[:2])
        self._weights = kernels.zeros(shape, device)
        kernels.nlm_weights(
            kernels.image(image, device),
            window=config.window,
            patch=config.patch,
            sigma_color=config.sigma_color,
            sigma_gradient=config.sigma_gradient,
            floor=config.floor,
            scratch_out=kernels.zeros(shape, device),
            weights_out=self._weights,
        )
        self.degree = kernels.zeros(image.shape[:2], device)
        """W 1: the sum of the weights of each pixel's window, its own 1 included; a field [y, x]."""
        self.neighbors(kernels.field(np.ones(image.shape[:2]), device), self.degree)

    def neighbors(self, values: Array, sums_out: Array) -> None:
        """W v: the weighted sum over each pixel's window, itself included."""
        self.kernels.nlm_neighbors(self._weights, values, window=self.window, sums_out=sums_out)

    def mean(self, values: Float32Array) -> Float32Array:
        """W v / W 1: the weighted mean over each pixel's window, [y, x] to [y, x]."""
        kernels, device = self.kernels, self.device
        sums = kernels.zeros(values.shape, device)
        self.neighbors(kernels.field(values, device), sums)
        return np.asarray(kernels.numpy(sums) / kernels.numpy(self.degree), np.float32)

    def laplacian(self, values: Array, laplacian_out: Array) -> None:
        """L v, with Σ_p Σ_q w_pq (v_p - v_q)² = 2 vᵀ L v."""
        self.kernels.nlm_laplacian(self._weights, values, window=self.window, laplacian_out=laplacian_out)

    def value_and_gradient(self, values: Array, gradient_out: Array) -> float:
        """R(v) = Σ_p Σ_{q∈N(p)} w_pq (v_p - v_q)² and its gradient 4 L v."""
        self.laplacian(values, gradient_out)
        value = 2 * self.kernels.dot(values, gradient_out)
        self.kernels.axpby(4.0, gradient_out, 0.0, gradient_out, gradient_out)
        return value
