"""The generative model: a disparity map predicts every view from the reference view alone (paper §3)."""

from __future__ import annotations

import numpy as np

from lfgpu.config import RefinementConfig
from lfgpu.lightfield import LightField
from lfgpu.types import Array, Float32Array, KernelSet


class ForwardModel:
    """Predicts the views of a light field by a bilinear forward splat, and compares them with the recorded ones.

    Parameters
    ----------
    lf
        The light field; its reference view is what is splatted, all other views are predicted.
    config
        `softness` of the tent.
    kernels, device
        Where the views live from now on, stored as they came.
    """

    def __init__(self, lf: LightField, config: RefinementConfig, kernels: KernelSet, device: str) -> None:
        self._kernels, self._device, self._softness = kernels, device, config.softness
        others = np.arange(len(lf.views)) != lf.reference_index  # the reference predicts itself whatever the map
        self.shape = (int(others.sum()), *lf.size, lf.channels)
        self._image = kernels.image(lf.image(lf.reference_index), device)
        self._offsets = kernels.field(lf.offsets[others], device)
        self._data_term = kernels.data_term(
            self._image,
            kernels.image(lf.views[others], device),
            None if lf.valid is None else kernels.field(lf.valid[others], device),
            self._offsets,
            scale=lf.scale,
            softness=config.softness,
        )

    def predict(self, disparity: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Predicted views [n, y, x, c] without the reference, in the light field's order, and their coverage [n, y, x].

        `disparity` is [y, x] in pixels per view step. The model adds up all that lands on a pixel: where coverage is
        not 1, several surfaces (more) or none (less) were seen there.
        """
        k = self._kernels
        views, coverage = k.zeros_image(self.shape, self._device), k.zeros(self.shape[:3], self._device)
        k.splat(
            self._image,
            k.field(disparity, self._device),
            self._offsets,
            softness=self._softness,
            views_out=views,
            coverage_out=coverage,
        )
        return k.numpy(views), k.numpy(coverage)

    def value_and_gradient(self, disparity: Array, gradient_out: Array) -> float:
        """Squared error summed over pixels, averaged over views and channels, and its gradient."""
        mean = 1.0 / (self.shape[0] * self.shape[3])
        value = self._data_term(disparity, gradient_out)
        self._kernels.axpby(mean, gradient_out, 0.0, gradient_out, gradient_out)
        return mean * value
