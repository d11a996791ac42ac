"""Reduced views: faint and wide texture shows in them, and noise does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfgpu.contract import REDUCTION, WHITE, Array, SweepCost, ViewSets
from lfgpu.methods.matching.disparities import view_sets
from lfgpu.methods.matching.frame import SweptViews
from lfgpu.methods.prior import UNLIKE_ANY

_BESIDE = 1  # reduced pixels from an edge that are beside it
_SEVERAL = 2  # further sweeps mend the outlines that reduced views blur


class ReducedViews:
    """A sweep over views that are reduced to one pixel for each REDUCTION x REDUCTION, at the same disparities.

    Parameters
    ----------
    views
        The views as they are.
    cost
        Their cost.
    """

    def __init__(self, views: SweptViews, cost: SweepCost) -> None:
        frame, layout, tuning = views.frame, views.layout, views.frame.config.tuning.sweep
        device, (height, width) = frame.arena.device, (side // REDUCTION for side in layout.size)
        small = replace(layout, size=(height, width), offsets=layout.offsets / REDUCTION)
        self._kernels, self._reference, self._scale = frame.kernels, layout.reference, frame.scale
        self._weight, self._cost = tuning.reduced_weight, cost
        # Beside an outline, many pixels of the farther side look like a part of the nearer one.
        self._contrast = tuning.reduced_contrast if frame.config.sweep.resweeps < _SEVERAL else None
        arena = frame.arena
        self._shares = arena.device.field(np.ones(small.size))
        self._views = arena.image("reduced views", small.shape, np.uint16)
        self._image = arena.image("reduced image", small.shape[1:])
        self._valid = arena.field("reduced masks", small.shape[:3])
        self._volume = arena.field("reduced costs", (frame.disparities.count, *small.size))
        sets = ViewSets(
            device.field(small.offsets),
            device.field(view_sets(small.offsets, tuning.view_set_angle)),
            preference=tuning.view_set_penalty,
            tolerance=0.0,  # nothing hides anything
            least=1,
        )
        self._sweep = frame.kernels.plane_sweep(small.shape, sets, frame.disparities, scale=1 / WHITE)
        views.on_load(self._load)

    def _load(self, _: Array, views: Array, valid: Array | None) -> None:
        """Reduce views [n, y, x, c], as stored, with their masks [n, y, x]."""
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
