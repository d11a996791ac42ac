"""The networks: from sector costs to a distribution over disparities for each pixel, and the choice between two maps.

The first is a U-Net over pixels and disparities, the second one over pixels. What they see has the full resolution;
2 x 2 pixels are folded into channels before the first layer and unfolded after the last, so volumes are a quarter as
large and nothing is averaged away.

Disparities are in pixels of the farthest view.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F  # noqa: N812 - its usual name
from torch import Tensor, nn

from lfgpu.contract import COMPARED, DECISIONS
from lfgpu.training.generator import Batch
from lfgpu.training.sectors import CHANNELS, sector_costs

FOLD = 2
"""Pixels of an image, each way, in one of the network's."""

MULTIPLE = 16 * FOLD
"""Heights and widths that the network takes are multiples of this; counts of disparities are multiples of 4."""

BRIGHTNESS = 0.4
"""Mean intensity that references are brought to."""


def brightness(reference: Tensor) -> Tensor:
    """Give the factors [b] that bring references [b, y, x, 3] to about the same mean."""
    return (BRIGHTNESS / (reference.mean((1, 2, 3)) + 0.08)).clamp(0.5, 4.0)


def block(
    inputs: int, outputs: int, *, size: tuple[int, ...] = (3, 3, 3), stride: int | tuple[int, ...] = 1
) -> nn.Module:
    """Make a convolution over [l, y, x], its normalisation and a rectifier."""
    convolution = nn.Conv3d(inputs, outputs, size, stride, tuple(k // 2 for k in size), bias=False)
    return nn.Sequential(convolution, nn.BatchNorm3d(outputs), nn.ReLU(inplace=True))


class Merge(nn.Module):
    """A coarse volume, repeated to the size of a finer one, and that finer one, mixed pixel by pixel."""

    def __init__(self, coarse: int, fine: int) -> None:
        super().__init__()
        self.coarse, self.fine = nn.Conv3d(coarse, fine, 1, bias=False), nn.Conv3d(fine, fine, 1, bias=False)
        self.norm = nn.BatchNorm3d(fine)

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """Mix volumes [b, c, l, y, x]."""
        return F.relu(self.norm(F.interpolate(self.coarse(coarse), size=fine.shape[2:]) + self.fine(fine)))


class UNet(nn.Module):
    """The levels of a network, `widths` the channels at each of its resolutions; `flat` ones see images alone."""

    def __init__(self, widths: tuple[int, int, int, int], *, flat: bool = False) -> None:
        super().__init__()
        c0, c1, c2, c3 = widths
        size, wide = ((1, 3, 3), (1, 2, 2)) if flat else ((3, 3, 3), (2, 2, 2))
        self.level0 = block(c0, c0, size=size)
        self.level1 = nn.Sequential(block(c0, c1, size=size, stride=(1, 2, 2)), block(c1, c1, size=size))
        self.level2 = nn.Sequential(block(c1, c2, size=size, stride=wide), block(c2, c2, size=size))
        self.level3 = nn.Sequential(block(c2, c3, size=size, stride=wide), block(c3, c3, size=size))
        self.level4 = nn.Sequential(block(c3, c3, size=(1, 3, 3), stride=(1, 2, 2)), block(c3, c3, size=size))
        self.merge3, self.back3 = Merge(c3, c3), block(c3, c3, size=size)
        self.merge2, self.back2 = Merge(c3, c2), block(c2, c2, size=size)
        self.merge1, self.back1 = Merge(c2, c1), block(c1, c1, size=size)
        self.merge0, self.back0 = Merge(c1, c0), block(c0, c0, size=size)

    def through(self, volume: Tensor) -> Tensor:
        """Send a volume [b, c, l, y, x] through all levels."""
        x0 = self.level0(volume)
        x1 = self.level1(x0)
        x2 = self.level2(x1)
        x3 = self.level3(x2)
        y = self.back3(self.merge3(self.level4(x3), x3))
        y = self.back2(self.merge2(y, x2))
        y = self.back1(self.merge1(y, x1))
        found: Tensor = self.back0(self.merge0(y, x0))
        return found


class Network(UNet):
    """The network."""

    def __init__(self, widths: tuple[int, int, int, int] = (24, 40, 56, 72)) -> None:
        super().__init__(widths)
        c0, folded = widths[0], FOLD**2
        self.sectors = nn.Sequential(
            nn.Conv3d(CHANNELS * folded, 2 * c0, 1), nn.ReLU(inplace=True), nn.Conv3d(2 * c0, c0, 1)
        )
        self.image = nn.Sequential(
            nn.Conv2d(3 * folded, c0, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(c0, c0, 3, padding=1)
        )
        self.logits = nn.Conv3d(c0, folded, 3, padding=1)

    def forward(self, costs: Tensor, image: Tensor) -> Tensor:
        """Give logits float32 [b, l, y, x] to costs [b, CHANNELS, l, y, x] and images [b, 3, y, x]."""
        mixed = self.sectors(F.pixel_unshuffle(costs.transpose(1, 2), FOLD).transpose(1, 2))
        y = self.through(F.relu(mixed + self.image(F.pixel_unshuffle(image, FOLD))[:, :, None]))
        with torch.autocast(y.device.type, enabled=False):  # differences of logits are hundredths of a pixel
            logits = self.logits(y.float())
        return F.pixel_shuffle(logits.transpose(1, 2), FOLD)[:, :, 0]


class Choice(UNet):
    """The network that chooses between two maps."""

    def __init__(self, widths: tuple[int, int, int, int] = (16, 24, 32, 32)) -> None:
        super().__init__(widths, flat=True)
        c0, folded = widths[0], FOLD**2
        self.image = nn.Sequential(nn.Conv3d(3 * folded, 2 * c0, 1))
        self.features = nn.Sequential(
            nn.Conv3d(COMPARED * folded, 2 * c0, 1), nn.ReLU(inplace=True), nn.Conv3d(2 * c0, c0, 1)
        )
        self.decisions = nn.Conv3d(c0, DECISIONS * folded, (1, 3, 3), padding=(0, 1, 1))

    def forward(self, features: Tensor, image: Tensor) -> Tensor:
        """Give decisions float32 [b, DECISIONS, y, x] to features [b, COMPARED, y, x] and images [b, 3, y, x]."""
        first, between, last = self.features
        seen = self.image(F.pixel_unshuffle(image, FOLD)[:, :, None])
        mixed = between(first(F.pixel_unshuffle(features, FOLD)[:, :, None]) + seen)
        y = self.through(F.relu(last(mixed)))
        with torch.autocast(y.device.type, enabled=False):
            return F.pixel_shuffle(self.decisions(y.float())[:, :, 0], FOLD)


_REACH = 2  # disparities on either side of the likeliest one that its mean is over


def _around(logits: Tensor) -> tuple[Tensor, Tensor]:
    """Give the disparities around the likeliest one of each pixel, and their logits, [b, 2 _REACH + 1, y, x]."""
    count = logits.shape[1]
    best = logits.argmax(1, keepdim=True)
    around = best + torch.arange(-_REACH, _REACH + 1, device=logits.device)[None, :, None, None]
    inside = (around >= 0) & (around < count)
    around = around.clamp(0, count - 1)
    return around, logits.gather(1, around).masked_fill(~inside, -1e4)


def peak(logits: Tensor, first: Tensor, steps: Tensor) -> Tensor:
    """Average the disparities around the likeliest one of each pixel, [b, y, x]."""
    around, near = _around(logits)
    place = (near.softmax(1) * around).sum(1)
    return first + steps[:, None, None] * place


def certainty(logits: Tensor) -> tuple[Tensor, Tensor]:
    """Give the probability of the disparities around the likeliest one, and their deviation in steps, [b, y, x]."""
    around, near = _around(logits)
    shares = near.softmax(1)
    mean = (shares * around).sum(1, keepdim=True)
    variance = (shares * (around - mean) ** 2).sum(1)
    return (near.logsumexp(1) - logits.logsumexp(1)).exp(), variance.sqrt()


def estimate(network: nn.Module, batch: Batch, first: Tensor, steps: Tensor, count: int) -> Tensor:
    """Give logits float32 [b, l, y, x] at the disparities first [b, y, x] + l steps [b] of light fields, l < count."""
    scale = brightness(batch.reference)[:, None, None, None]
    with torch.no_grad():
        views, reference = batch.views * scale[..., None], batch.reference * scale
        costs = sector_costs(
            views, reference, batch.offsets, batch.starts, margin=batch.margin, first=first, steps=steps, count=count
        )
        del views  # which are large
    logits: Tensor = network(costs, reference.permute(0, 3, 1, 2))
    return logits


def learning_rate(largest: float, step: int, steps: int, warm_up: int) -> float:
    """Give the learning rate of a step: half a cosine, after a warm-up."""
    cosine = 0.5 + 0.5 * math.cos(math.pi * min(step / steps, 1.0))
    return largest * min((step + 1) / warm_up, 1.0) * max(cosine, 0.01)


def follow(mean: nn.Module, network: nn.Module, step: int) -> None:
    """Move the mean of a network's weights over its last thousand steps, of which there were `step`, towards it."""
    share = 1 - min(0.999, step / (step + 19))
    with torch.no_grad():
        for old, new in zip(mean.state_dict().values(), network.state_dict().values(), strict=True):
            if old.is_floating_point():
                old.lerp_(new, share)
