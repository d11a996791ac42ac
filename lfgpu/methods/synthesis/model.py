"""The generative model: the reference view and a disparity map predict every view (paper §6)."""

import numpy as np

from lfgpu.contract import Array, Device, Float32Array, Scalar
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.synthesis.config import RefinementConfig


def compared_as(config: RefinementConfig, *, on_gpu: bool) -> type[np.floating]:
    """Choose the type in which recorded views are kept for comparison with the model.

    On a GPU memory bandwidth is the limit, and normalised views are kept in half precision: its rounding is far below
    their noise. Raw intensities are kept as they are: rounded ones would move the printed energy by 3e-5 of its value.
    """
    return np.float16 if on_gpu and config.detail_scale > 0 else np.float32


class ForwardModel:
    """Predicts views by splatting the reference view, and compares them with the recorded views.

    With `detail_scale` above 0, views are compared after local contrast normalisation: the local mean is subtracted,
    and the rest is divided by the local contrast. Raw intensities would bend slanted surfaces, because there the
    coverage of the additive model is not 1 and changes its brightness. After normalisation weak texture counts as much
    as strong texture, and differences in exposure between cameras cancel. The reference predicts itself without error.
    """

    def __init__(self, layout: ViewLayout, config: RefinementConfig, device: Device) -> None:
        kernels = device.kernels
        self._kernels, self._device, self._softness = kernels, device, config.softness
        self._reference, self.size, self._scale = layout.reference, layout.size, layout.scale
        self.mean = 1.0 / (max(layout.count - 1, 1) * layout.channels) if config.error == "mean" else 1.0
        """The factor of the squared error: 1, or what turns a sum into a mean over the predicted views and channels."""
        self._masks_rim = config.rim == "masked"
        self._shape = shape = layout.shape
        self._offsets = device.field(layout.offsets)
        self._detail = device.zeros_image(shape, compared_as(config, on_gpu=device.is_gpu))
        self._image, self._raw = (device.zeros_image((*layout.size, layout.channels)) for _ in range(2))
        self._seen = device.zeros(shape[:3])
        self._valid, self._known = None, None
        if layout.masks is not None:
            self._valid = device.field(np.stack(layout.masks))
            self._known = device.field(layout.masks[layout.reference])
        self._normalize = kernels.normalization(
            shape, device.name, scale=layout.scale, sigma=config.detail_scale, floor=config.contrast_floor
        )
        self._data_term = kernels.data_term(shape, self._offsets, scale=1.0, softness=config.softness)

    def load(self, views: Array, start: Array | None = None) -> None:
        """Take recorded views [n, y, x, c], as stored, and perhaps a first disparity map [y, x].

        Pixels of the views that come from outside the reference view, or from its masked pixels, according to this map,
        are not compared: nothing predicts them. Without a map, or with `rim` "compared", all valid pixels are.
        """
        kernels = self._kernels
        kernels.intensities(views, self._reference, self._valid, scale=self._scale, fill=0.0, image_out=self._raw)
        self._normalize(views, self._valid, self._detail)
        kernels.intensities(self._detail, self._reference, self._valid, scale=1.0, fill=0.0, image_out=self._image)
        if start is not None and self._masks_rim:
            kernels.seen_by_reference(start, self._offsets, self._known, self._valid, seen_out=self._seen)
        self._data_term.load(
            self._image, self._detail, self._seen if start is not None and self._masks_rim else self._valid
        )

    def predict(self, disparity: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Predict all views [n, y, x, c] from a map [y, x] with the additive model, and their coverage [n, y, x].

        Coverage is the sum of the splat weights on a pixel: above 1 where several surfaces land on it, below 1 in gaps.
        """
        k = self._kernels
        views, coverage = self._device.zeros_image(self._shape), self._device.zeros(self._shape[:3])
        k.splat(
            self._raw,
            self._device.field(disparity),
            self._offsets,
            softness=self._softness,
            views_out=views,
            coverage_out=coverage,
        )
        return k.numpy(views), k.numpy(coverage)

    def squared_error(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        """Compute the squared error, summed over pixels, views and channels, and its gradient; `mean` is its factor."""
        self._data_term(disparity, gradient_out, value_out)

    def curvature(self, curvature_out: Array) -> None:
        """Approximate the second derivative of the squared error by the disparity of each pixel, a field [y, x]."""
        self._data_term.curvature(curvature_out)
