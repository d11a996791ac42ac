"""The disparities that a network in training compares: whole ranges, or windows around a map that was found before."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from lfgpu.methods.matching.disparities import NETWORK_MOST, NETWORK_STEP, PADDED, WINDOW, network_reach
from lfgpu.methods.matching.learned import weights_of
from lfgpu.training.facets import facets
from lfgpu.training.generator import Batch, Generator
from lfgpu.training.network import Network, estimate, peak
from lfgpu.training.scenes import SPANS
from lfgpu.training.sectors import order_of_sectors
from lfgpu.training.weights import unfold

_NARROW = 30.0  # pixels in the farthest view: a rig's range that is not wider is compared whole
_SLACK = 3.0  # pixels in the farthest view by which ranges are wider than the truth at either end, at most
_DISTURBED = 0.0, 0.1, 0.2  # standard deviations of factors of the weights that find the map
_MOVED = 0.3  # steps by which windows lie beside the map, at most


SHOWN_FIRST = 8
"""Batches that a network which begins with given weights is shown."""


class Comparison(ABC):
    """Draws the disparities that a network in training compares, for batches of so many `scenes`."""

    spans: ClassVar[tuple[float, float]]
    """Pixels in the farthest view over which the disparities of scenes are spread."""

    @abstractmethod
    def __init__(self, generator: Generator, *, scenes: int, seed: int) -> None: ...

    @abstractmethod
    def __call__(self, batch: Batch, rng: np.random.Generator, count: int) -> tuple[Tensor, Tensor, int]:
        """Draw the first disparity of each pixel [b, y, x], the steps [b], and how many; `count` is a proposal."""


def count_of(*seed: int) -> int:
    """Draw how many disparities to compare."""
    return int(np.random.default_rng(seed).choice([20, 28, 36, 48], p=[0.25, 0.3, 0.3, 0.15]))


def disparities_for(
    batch: Batch, rng: np.random.Generator, count: int, limits: tuple[float, float] | None = None
) -> tuple[Tensor, Tensor, int]:
    """Draw the disparities to compare, a range that holds the truth: the first of each pixel, the steps [b], the count.

    It is about the `limits` of a rig, with as many disparities as it needs, if these are narrow.
    """
    low, high = batch.truth.amin((1, 2)).cpu().numpy(), batch.truth.amax((1, 2)).cpu().numpy()
    if limits is not None and limits[1] - limits[0] < _NARROW:
        found = sorted(limits + 0.1 * (limits[1] - limits[0]) * rng.uniform(-0.5, 1, 2) * (-1, 1))
        low, high = np.minimum(low, found[0]), np.maximum(high, found[1])
        count = 4 * math.ceil((float((high - low).max()) / rng.uniform(0.45, 0.6) + 5) / 4)
    step = np.maximum(rng.uniform(0.4, 0.9, len(low)), (high - low) / (count - 5))
    free = np.maximum(step * (count - 4) - (high - low), 0)
    first = low - step * 1.5 - rng.uniform(0, 1, len(low)) * free
    first, step = (torch.tensor(x, dtype=torch.float32, device=batch.truth.device) for x in (first, step))
    return first[:, None, None].expand_as(batch.truth).contiguous(), step, count


class WholeRanges(Comparison):
    """Ranges that hold the truth."""

    spans = SPANS

    def __init__(self, generator: Generator, *, scenes: int, seed: int) -> None:
        self._limits = None if generator.rig is None else generator.rig.limits

    def __call__(self, batch: Batch, rng: np.random.Generator, count: int) -> tuple[Tensor, Tensor, int]:
        """See `Comparison`."""
        return disparities_for(batch, rng, count, self._limits)


class Windows(Comparison):
    """Windows around the map that the network of whole ranges finds in the views near the reference.

    Its weights are disturbed now and then, as it fails more often on light fields of others.
    """

    spans = 24.0, 192.0

    def __init__(self, generator: Generator, *, scenes: int, seed: int) -> None:
        self._network, self._disturbed = (Network().to(generator.device).eval() for _ in range(2))
        rng = np.random.default_rng((seed, 11))

        def show(network: torch.nn.Module) -> None:
            for number in range(SHOWN_FIRST):
                batch = generator.draw(number, scenes)
                estimate(network, batch, *disparities_for(batch, rng, NETWORK_MOST))

        unfold(weights_of(""), self._network, show)

    def __call__(self, batch: Batch, rng: np.random.Generator, count: int) -> tuple[Tensor, Tensor, int]:
        """See `Comparison`."""
        map_, step = self._coarse(batch, rng), NETWORK_STEP * rng.uniform(0.9, 1.1)
        half, level = step * (WINDOW - 1) / 2, facets(map_)
        level = torch.where((level - map_).abs() > half, map_, level)  # as `Learned` places its windows
        first = level - half + step * rng.uniform(-_MOVED, _MOVED)
        return first.contiguous(), torch.full((len(first),), step, device=first.device), WINDOW

    def _coarse(self, batch: Batch, rng: np.random.Generator) -> Tensor:
        """Find a map [b, y, x] as `Learned` finds its first one in a wide range."""
        low, high = (bound.cpu().numpy() for bound in batch.truth.flatten(1).aminmax(dim=1))
        low, high = low - rng.uniform(0, _SLACK), high + rng.uniform(0, _SLACK)
        everywhere = np.concatenate([batch.offsets, np.zeros((1, 2))])
        reach, free = network_reach(everywhere, (0.0, float((high - low).max()))), NETWORK_MOST - PADDED
        near = np.flatnonzero(np.abs(batch.offsets).max(1) <= reach)
        order, starts = order_of_sectors(batch.offsets[near])
        near = near[order]
        step = np.maximum(NETWORK_STEP / reach, (high - low) / free)
        count = int(min(4 * math.ceil((float(((high - low) / step).max()) + PADDED) / 4), NETWORK_MOST))
        first, steps = (
            torch.tensor(x, dtype=torch.float32, device=batch.truth.device)
            for x in ((low + high) / 2 - step * (count - 1) / 2, step)
        )
        first = first[:, None, None].expand_as(batch.truth).contiguous()
        self._disturb(float(rng.choice(_DISTURBED)), int(rng.integers(1 << 30)))
        kind = batch.truth.device.type
        with torch.no_grad(), torch.autocast(kind, dtype=torch.float16, enabled=kind == "cuda"):
            views = batch.views[:, torch.tensor(near, device=first.device)]
            some = replace(batch, views=views, offsets=batch.offsets[near], starts=starts)
            return peak(estimate(self._disturbed, some, first, steps, count), first, steps)

    def _disturb(self, deviation: float, seed: int) -> None:
        """Multiply the weights of convolutions by random factors."""
        self._disturbed.load_state_dict(self._network.state_dict())
        device = next(self._network.parameters()).device
        generator = torch.Generator(device).manual_seed(seed)
        with torch.no_grad():
            for values in self._disturbed.parameters():
                if values.ndim > 1:
                    noise = torch.randn(values.shape, generator=generator, device=device)
                    values.mul_(1 + deviation * noise)
