"""Facets of maps in PyTorch, as `KernelSet.facets` finds them."""

from __future__ import annotations

import torch
import torch.nn.functional as F  # noqa: N812 - its usual name
from torch import Tensor

from lfgpu.contract import FACET_REACH


def facets(map_: Tensor) -> Tensor:
    """Give each pixel of maps [b, y, x] its value on the best plane through the pixels around it."""
    size = 2 * FACET_REACH + 1
    height, width = map_.shape[-2:]

    def windows(values: Tensor) -> Tensor:
        return F.unfold(F.pad(values[:, None], (FACET_REACH,) * 4), size)  # [b, size^2, y x]

    inside = windows(torch.ones_like(map_[:1]))
    places = torch.arange(-FACET_REACH, FACET_REACH + 1, device=map_.device, dtype=map_.dtype)
    dy, dx = (grid.reshape(1, -1, 1) for grid in torch.meshgrid(places, places, indexing="ij"))

    def mean(values: Tensor) -> Tensor:
        return (inside * values).sum(1) / inside.sum(1)

    beside = windows(map_) - map_.flatten(1)[:, None]
    x, y, level = mean(dx), mean(dy), mean(beside)
    spread_x, spread_y = mean(dx**2) - x**2, mean(dy**2) - y**2
    slope_x = (mean(dx * beside) - x * level) / spread_x.clamp(min=1e-6)
    slope_y = (mean(dy * beside) - y * level) / spread_y.clamp(min=1e-6)
    residual = mean(beside**2) - level**2 - slope_x**2 * spread_x - slope_y**2 * spread_y
    value = level - slope_x * x - slope_y * y + map_.flatten(1)
    residual, value, slope_x, slope_y = (part.reshape(map_.shape) for part in (residual, value, slope_x, slope_y))
    rows, columns = (torch.arange(side, device=map_.device) for side in (height, width))
    least, found = torch.full_like(map_, torch.inf), map_
    for j in range(-FACET_REACH, FACET_REACH + 1):
        for i in range(-FACET_REACH, FACET_REACH + 1):
            qy, qx = (rows + j).clamp(0, height - 1), (columns + i).clamp(0, width - 1)
            there, ahead, down, rest = (part[:, qy][:, :, qx] for part in (value, slope_x, slope_y, residual))
            there = there + ahead * (columns - qx) + down * (rows - qy)[:, None]
            found, least = torch.where(rest < least, there, found), torch.minimum(least, rest)
    return found
