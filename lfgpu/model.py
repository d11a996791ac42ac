"""The generative model: a disparity map predicts every view from the reference view alone (paper §3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu.config import RefinementConfig
from lfgpu.detail import normalized_views
from lfgpu.lightfield import LightField
from lfgpu.types import Array, Float32Array, Float64Array, KernelSet


class ForwardModel:
    """Predicts the views of a light field by a bilinear forward splat, and compares them with the recorded ones.

    Parameters
    ----------
    lf
        The light field; its reference view is what is splatted, all other views are predicted.
    config
        `softness` of the tent; `detail_scale` and `contrast_floor` of the images that are compared.
    kernels, device
        Where the views live from now on.
    start
        A first disparity map [y, x]: what by it lies outside the reference view, at the rims of the others, or where
        the reference is not valid has no prediction and is not compared. None compares everything.
    """

    def __init__(
        self,
        lf: LightField,
        config: RefinementConfig,
        kernels: KernelSet,
        device: str,
        start: Float32Array | None = None,
    ) -> None:
        self._kernels, self._device, self._softness = kernels, device, config.softness
        others = np.flatnonzero(np.arange(len(lf.views)) != lf.reference_index)  # the reference predicts itself
        self.shape = (len(others), *lf.size, lf.channels)
        self._image = kernels.image(lf.image(lf.reference_index), device)
        self._offsets = kernels.field(lf.offsets[others], device)
        detail = config.detail_scale, config.contrast_floor
        reference = normalized_views(lf, np.array([lf.reference_index]), *detail)[0]
        valid = None if lf.valid is None else lf.valid[others]
        if lf.valid is not None:
            reference = reference * lf.valid[lf.reference_index, ..., None]
        if start is not None:
            known = np.ones(lf.size, np.bool_) if lf.valid is None else lf.valid[lf.reference_index]
            seen = _seen_by_reference(start, lf.offsets[others], known)
            valid = seen if valid is None else valid & seen
        self._data_term = kernels.data_term(
            kernels.image(reference, device),
            kernels.image(normalized_views(lf, others, *detail), device),
            None if valid is None else kernels.field(valid, device),
            self._offsets,
            scale=1.0,
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


def _seen_by_reference(disparity: Float32Array, offsets: Float64Array, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether what each pixel of the views at `offsets` shows is known to the reference view: bool [n, y, x].

    `known` [y, x] are the valid pixels of the reference; nothing is known outside its frame. Near enough, the disparity
    at a pixel of another view is that at the same pixel of the reference.
    """
    height, width = disparity.shape
    y, x = np.mgrid[:height, :width]
    seen = np.empty((len(offsets), height, width), np.bool_)
    for n, (du, dv) in enumerate(offsets):
        from_x, from_y = x + disparity * du, y + disparity * dv
        inside = (from_x >= 0) & (from_x <= width - 1) & (from_y >= 0) & (from_y <= height - 1)
        column, row = np.where(inside, from_x, x), np.where(inside, from_y, y)
        seen[n] = inside & known[np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)]
    return seen
