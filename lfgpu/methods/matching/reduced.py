"""Reduced views, compared as well: what is faint and wide shows in them, and noise does not."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import REDUCTION, WHITE, Array, Device
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.matching.config import SweepConfig
from lfgpu.methods.matching.sweep import planned_sweep, sweep_cost
from lfgpu.methods.prior import UNLIKE_ANY

_BESIDE = 1  # reduced pixels from an edge that are beside it


class ReducedSweep:
    """A sweep over views that are reduced to one pixel for each REDUCTION x REDUCTION, at the same disparities.

    Parameters
    ----------
    layout
        The layout of the views.
    place
        The disparities, as `labels` gives them.
    config
        The parameters of the sweep; `reduced_weight` is what its costs count against those of views as they are.
    contrast
        The difference between adjacent pixels, intensity, beside which they count half of that. Beside an outline
        what is farther looks like a part of what is nearer, for many pixels around. None: they count everywhere.
    device
        The device on which it runs.
    scale
        The factor from stored values to intensities.
    """

    def __init__(
        self,
        layout: ViewLayout,
        place: tuple[float, float, int],
        config: SweepConfig,
        device: Device,
        *,
        scale: float,
        contrast: float | None,
    ) -> None:
        kernels = device.kernels
        height, width = (side // REDUCTION for side in layout.size)
        shape = layout.count, height, width, layout.channels
        self._kernels, self._reference, self._scale = kernels, layout.reference, scale
        self._weight, self._contrast = config.reduced_weight, contrast
        self._shares = device.field(np.ones(shape[1:3]))
        self._views, self._image = device.zeros_image(shape, np.uint16), device.zeros_image(shape[1:])
        self._valid = device.zeros(shape[:3])
        self._volume = device.zeros((place[2], height, width))
        # A disparity moves what is seen in a reduced view by so many of its pixels less.
        self._cost = sweep_cost(config, config.gradient_weight)
        self._sweep = planned_sweep(
            shape,
            layout.offsets / REDUCTION,
            place,
            config,
            device,
            scale=1 / WHITE,
        )

    def load(self, views: Array, valid: Array | None) -> None:
        """Reduce views [n, y, x, c], as stored, with their mask [n, y, x]."""
        kernels, kept = self._kernels, self._valid if valid is not None else None
        kernels.reduce_views(views, valid, scale=self._scale, views_out=self._views, valid_out=kept)
        kernels.intensities(self._views, self._reference, kept, scale=1 / WHITE, fill=UNLIKE_ANY, image_out=self._image)
        self._sweep.load(self._image, self._views, kept)
        if self._contrast is not None:
            kernels.edge_weights(self._image, contrast=self._contrast, reach=_BESIDE, weights_out=self._shares)

    def add(self, volume: Array) -> None:
        """Add the costs over view sets to a volume [l, y, x]."""
        self._sweep.by_view_sets(self._cost, self._volume)
        self._kernels.add_reduced(self._volume, self._shares, weight=self._weight, volume_inout=volume)
