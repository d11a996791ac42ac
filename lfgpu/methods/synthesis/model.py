"""The generative model: a disparity map predicts every view from the reference view alone (paper §3)."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Array, Float32Array, KernelSet, Scalar
from lfgpu.data.lightfield import LightField
from lfgpu.methods.synthesis import data_terms
from lfgpu.methods.synthesis.config import RefinementConfig


class ForwardModel:
    """Predicts the views of light fields of one kind by a bilinear forward splat, and compares them with recorded ones.

    Views are compared without their local mean and in units of their local contrast. The additive model's brightness
    follows the coverage, which on slanted surfaces is not 1: comparing raw intensities bends them. Detail has no
    brightness to follow, faint texture counts as much as strong, and differences in exposure between cameras cancel.

    Parameters
    ----------
    lf
        A light field of that kind: its cameras, size, masks and reference view count, its views do not. The reference
        is what is splatted; it predicts itself without error, whatever the disparity.
    config
        `softness` of the tent; `detail_scale` and `contrast_floor` of the images that are compared.
    kernels, device
        Where the views live.
    """

    def __init__(self, lf: LightField, config: RefinementConfig, kernels: KernelSet, device: str) -> None:
        self._kernels, self._device, self._softness = kernels, device, config.softness
        self._reference, self.size, self._scale = lf.reference_index, lf.size, lf.scale
        self.mean = 1.0 / (max(len(lf.views) - 1, 1) * lf.channels)
        """What turns sums over views and channels into means over the views that are predicted."""
        self._shape = shape = (len(lf.views), *lf.size, lf.channels)
        # Half the bytes on a GPU, whose kernels wait for memory; the noise of a view is far above their rounding.
        stored = np.float32 if device == "cpu" else np.float16
        self._offsets = kernels.field(lf.offsets, device)
        self._detail = kernels.zeros_image(shape, device, stored)
        self._image, self._raw = (kernels.zeros_image((*lf.size, lf.channels), device) for _ in range(2))
        self._seen = kernels.zeros(shape[:3], device)
        self._valid, self._known = None, None
        if lf.valid is not None:
            self._valid = kernels.field(lf.valid, device)
            self._known = kernels.field(lf.valid[lf.reference_index], device)
        self._normalize = kernels.normalization(
            shape, device, scale=lf.scale, sigma=config.detail_scale, floor=config.contrast_floor
        )
        self._data_term = data_terms.planned(
            config.data_term, shape, self._offsets, softness=config.softness, kernels=kernels, device=device
        )

    def load(self, views: Array, start: Array | None = None) -> None:
        """Take recorded views [n, y, x, c], as stored.

        `start` is a first disparity map [y, x]: what by it lies outside the reference view, at the rims of the others,
        or where the reference is not valid has no prediction and is not compared. None compares everything valid.
        """
        kernels = self._kernels
        kernels.intensities(views, self._reference, self._valid, scale=self._scale, fill=0.0, image_out=self._raw)
        self._normalize(views, self._valid, self._detail)
        kernels.intensities(self._detail, self._reference, self._valid, scale=1.0, fill=0.0, image_out=self._image)
        if start is not None:
            kernels.seen_by_reference(start, self._offsets, self._known, self._valid, seen_out=self._seen)
        self._data_term.load(self._image, self._detail, self._valid if start is None else self._seen)

    def predict(self, disparity: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Predicted views [n, y, x, c] of the loaded reference view, itself included, and their coverage [n, y, x].

        `disparity` is [y, x] in pixels per view step. The model adds up all that lands on a pixel: where coverage is
        not 1, several surfaces (more) or none (less) were seen there.
        """
        k = self._kernels
        views, coverage = k.zeros_image(self._shape, self._device), k.zeros(self._shape[:3], self._device)
        k.splat(
            self._raw,
            k.field(disparity, self._device),
            self._offsets,
            softness=self._softness,
            views_out=views,
            coverage_out=coverage,
        )
        return k.numpy(views), k.numpy(coverage)

    def squared_error(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        """Squared error summed over pixels, views and channels, and its gradient; `mean` makes a mean of it."""
        self._data_term(disparity, gradient_out, value_out)

    def curvature(self, curvature_out: Array) -> None:
        """About the second derivative of the squared error by each pixel's disparity, a field [y, x]."""
        self._data_term.curvature(curvature_out)
