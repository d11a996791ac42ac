"""The generative model: the reference view and a disparity map predict every view (paper §6)."""

import numpy as np

from lfgpu.contract import Array, Device
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.synthesis.config import RefinementConfig


def compared_as(config: RefinementConfig, *, on_gpu: bool) -> type[np.floating]:
    """Choose the type in which recorded views are kept for comparison with the model.

    On a GPU memory bandwidth is the limit, and normalised views are kept in half precision: its rounding is far below
    their noise. Raw intensities are kept as they are: rounded ones would move the printed energy by 3e-5 of its value.
    """
    return np.float16 if on_gpu and config.detail_scale > 0 else np.float32


class ForwardModel:
    """Comparison of the recorded views with those that the reference view, splatted, predicts.

    With `detail_scale` above 0, views are compared after local contrast normalisation: the local mean is subtracted,
    and the rest is divided by the local contrast. Raw intensities would bend slanted surfaces, because there the
    coverage of the additive model is not 1 and changes its brightness. After normalisation weak texture counts as much
    as strong texture, and differences in exposure between cameras cancel. The reference predicts itself without error.
    """

    def __init__(self, layout: ViewLayout, config: RefinementConfig, device: Device) -> None:
        kernels = device.kernels
        self._kernels = kernels
        self._reference, self.size = layout.reference, layout.size
        self.mean = 1.0 / (max(layout.count - 1, 1) * layout.channels) if config.error == "mean" else 1.0
        """The factor of the squared error: 1, or what turns a sum into a mean over the predicted views and channels."""
        self._masks_rim = config.rim == "masked"
        shape = layout.shape
        self._offsets = device.field(layout.offsets)
        self._detail = device.zeros_image(shape, compared_as(config, on_gpu=device.is_gpu))
        self._image = device.zeros_image((*layout.size, layout.channels))
        self._seen = device.zeros(shape[:3])
        masks = layout.masks
        self.valid = None if masks is None else device.field(np.stack(masks))
        """The masks of the views, a field [n, y, x]; None if all pixels are valid."""
        self.known = None if masks is None else device.field(masks[layout.reference])
        """The mask of the reference view, a field [y, x]."""
        self._normalize = kernels.normalization(
            shape, device.name, scale=layout.scale, sigma=config.detail_scale, floor=config.contrast_floor
        )
        self.squared_error = kernels.data_term(shape, self._offsets, scale=1.0, softness=config.softness)
        """The squared error, summed over pixels, views and channels, and its gradient; `mean` is its factor."""

    def load(self, views: Array, start: Array | None = None) -> None:
        """Take recorded views [n, y, x, c], as stored, and perhaps a first disparity map [y, x].

        Pixels of the views that come from outside the reference view, or from its masked pixels, according to this map,
        are not compared: nothing predicts them. Without a map, or with `rim` "compared", all valid pixels are.
        """
        kernels = self._kernels
        self._normalize(views, self.valid, self._detail)
        kernels.intensities(self._detail, self._reference, self.valid, scale=1.0, fill=0.0, image_out=self._image)
        compared = self.valid
        if start is not None and self._masks_rim:
            compared = self._seen
            kernels.seen_by_reference(start, self._offsets, self.known, self.valid, seen_out=compared)
        self.squared_error.load(self._image, self._detail, compared)
