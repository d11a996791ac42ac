"""The levels of a U-Net over volumes [l, y, x, c], in the operations of a backend.

`lfgpu/training/network.py` has them for training; their names are those of the weights.

The volumes are large. On a CPU all layers take turns: each computes a few rows as soon as the layers before it have
those that they depend on. So only as many rows of each volume are in memory as other layers still need.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lfgpu.contract import FOLD, Array, Convolution, Float32Array, Rows
from lfgpu.methods.arena import Arena, Scratch

LEVELS = 5
STORED: type = np.float16
"""The type of volumes: their errors are far smaller than those of what a network says."""
PIXELS = 16 * FOLD
"""Rows and columns of images are filled up to multiples of this."""

Shape = tuple[int, ...]
Layers = dict[str, tuple[Shape, int, int]]
"""Convolutions by name: the window, and the channels in and out."""

Weights = Mapping[str, Float32Array]
"""Weights [l, y, x, c_in, c_out] of each convolution as "NAME.weight", and its bias [c_out] as "NAME.bias"."""

Strides = Mapping[int, tuple[int, int, int]]
"""The strides of the first convolution of a level, from the level above, by level from 1 on."""


_STRIP = 32  # rows of the finest level that a CPU computes at a time


@dataclass(frozen=True)
class Source:
    """A layer on whose rows those of another depend."""

    name: str
    reach: int = 0  # rows on which a row depends, on either side of its own place
    stride: float = 1  # rows for each row; less than 1 if these are coarser

    def before(self, row: int) -> int:
        """Return the first row on which a row depends."""
        return max(0, math.floor(row * self.stride) - self.reach)

    def after(self, row: int) -> int:
        """Return the row after the last one on which a row depends; there may be fewer."""
        return math.floor(row * self.stride) + self.reach + 1


@dataclass(frozen=True)
class Layer:
    """A layer of a network, which computes rows of a volume from those of other layers."""

    name: str
    rows: int  # in all
    sources: tuple[Source, ...] = ()
    into: str | None = None  # the layer whose volume it overwrites, row by row


def in_strips(layers: Sequence[Layer], strip: int) -> tuple[list[tuple[str, Rows]], dict[str, int]]:
    """Plan to compute layers, each of which depends on earlier ones, so that the last has `strip` more rows each time.

    Returns the layers and their rows in order, and by name how many rows a layer must hold for those that need them.
    """
    named = {layer.name: layer for layer in layers}
    order: list[tuple[str, Rows]] = []
    done, held = dict.fromkeys(named, 0), dict.fromkeys(named, 0)
    users: dict[str, list[tuple[Layer, Source]]] = {name: [] for name in named}
    for layer in layers:
        for source in layer.sources:
            users[source.name].append((layer, source))
    for layer in layers:
        if layer.into is not None:
            users[layer.into] += users[layer.name]

    def compute(layer: Layer, last: int) -> None:
        for source in layer.sources:
            before = named[source.name]
            end = min(source.after(last - 1), before.rows)
            if end > done[before.name]:
                compute(before, end)
        order.append((layer.name, Rows(done[layer.name], last, layer.rows)))
        done[layer.name] = last
        needed = [source.before(done[user.name]) for user, source in users[layer.name] if done[user.name] < user.rows]
        held[layer.name] = max(held[layer.name], last - min(needed, default=last))

    for last in range(strip, layers[-1].rows + strip, strip):
        compute(layers[-1], min(last, layers[-1].rows))
    return order, held


def level_layers(widths: Sequence[int], *, whole: Shape = (3, 3, 3)) -> Layers:
    """List the convolutions of the levels for these channels at each of the four finest ones."""
    c0, c1, c2, c3 = widths
    flat, pixel = (1, 3, 3), (1, 1, 1)
    found: Layers = {"level0": (whole, c0, c0)}
    for level, (above, here) in enumerate(((c0, c1), (c1, c2), (c2, c3), (c3, c3)), 1):
        found[f"level{level}.0"] = (whole if level < LEVELS - 1 else flat, above, here)
        found[f"level{level}.1"] = (whole, here, here)
        found[f"merge{level - 1}.coarse"] = (pixel, here, above)
        found[f"merge{level - 1}.fine"] = (pixel, above, above)
        found[f"back{level - 1}"] = (whole, above, above)
    return found


def widths_of(weights: Weights) -> list[int]:
    """Return the channels at each of the four finest levels."""
    return [len(weights.get(f"back{level}.bias", ())) for level in range(LEVELS - 1)]


class UNet:
    """The levels, and the layers before and after them, as convolutions.

    Parameters
    ----------
    arena
        Where buffers come from.
    weights
        The weights.
    strides
        Of the levels.
    linear
        The endings of the names of layers without a rectifier.
    """

    def __init__(self, arena: Arena, weights: Weights, *, strides: Strides, linear: tuple[str, ...]) -> None:
        self._device, self._weights, self._strides, self._linear = arena.device, weights, strides, linear
        names = [name.removesuffix(".weight") for name in weights if name.endswith(".weight")]
        self.parts: dict[str, Callable[..., None]] = {name: self._layer(name) for name in names}
        """The layers by name."""

    def allocate(
        self, scratch: Scratch, shape: Shape, stored: type, *, before: Sequence[Layer], after: Sequence[Layer]
    ) -> dict[str, int]:
        """Allocate the volumes of all levels, the finest of `shape`, between layers that come `before` and `after`.

        The last layer before the levels writes `begin`; the last of the levels is "back0", which writes `found`.
        Returns by name how many rows the volumes of layers hold.
        """
        rows = shape[1]
        strip = rows if self._device.is_gpu else min(_STRIP, rows)
        self._order, held = in_strips([*before, *self._layers(rows, before[-1].name), *after], strip)
        self._volumes: dict[str, tuple[Array, Array | None, Array]] = {}
        levels = list[tuple[Array, Array, Array]]()
        coarse = list[Array]()
        for level in range(LEVELS):
            if level:
                shape = tuple(length // by for length, by in zip(shape, self._strides[level], strict=True))
            names = f"level{level}.0" if level else before[-1].name, f"level{level}.1" if level else "level0"

            def volume(name: str, of: int, shape: Shape = shape) -> Array:
                return scratch.image((shape[0], held[name], shape[2], self._width(of)), stored)

            if level:
                coarse.append(volume(f"merge{level - 1}.coarse", level - 1))
            between, here = (volume(name, level) for name in names)
            merged = between
            if strip < rows and level < LEVELS - 1:  # else the first layer of the level is done with it
                merged = volume(f"merge{level}.fine", level)
            levels.append((between, here, merged))
        self.begin, self.found, _ = levels[0]
        self._volumes["level0"] = self.begin, None, self.found
        for level, ((_, above, merged), (between, here, _)) in enumerate(itertools.pairwise(levels)):
            self._volumes |= {
                f"level{level + 1}.0": (above, None, between),
                f"level{level + 1}.1": (between, None, here),
                f"merge{level}.coarse": (here, None, coarse[level]),
                f"merge{level}.fine": (above, coarse[level], merged),
                f"back{level}": (merged, None, above),  # which is not needed any more
            }
        return held

    def through(self, others: Mapping[str, Callable[[Rows], None]]) -> None:
        """Run all levels, and the `others` before and after them by name."""
        for name, rows in self._order:
            if name in others:
                others[name](rows)
            else:
                self.parts[name](*self._volumes[name], rows=rows)

    @staticmethod
    def _layers(rows: int, before: str) -> list[Layer]:
        """List the layers of the levels in order; the finest has so many rows."""
        found = [Layer("level0", rows, (Source(before, 1),))]
        here = ["level0"]
        for level in range(1, LEVELS):
            first, second = (f"level{level}.{k}" for k in range(2))
            found += [
                Layer(first, rows >> level, (Source(here[-1], 1, 2),)),
                Layer(second, rows >> level, (Source(first, 1),)),
            ]
            here.append(second)
        for level in reversed(range(LEVELS - 1)):
            coarse, fine = (f"merge{level}.{which}" for which in ("coarse", "fine"))
            found += [
                Layer(coarse, rows >> level + 1, (Source(found[-1].name),)),
                Layer(fine, rows >> level, (Source(here[level]), Source(coarse, 0, 0.5))),
                Layer(f"back{level}", rows >> level, (Source(fine, 1),), here[level]),
            ]
        return found

    def _width(self, level: int) -> int:
        return len(self._weights[f"level{level}{'.0' if level else ''}.bias"])

    def _layer(self, name: str) -> Convolution:
        """Plan a convolution."""
        level = re.fullmatch(r"level(\d)\.0", name)
        return self._device.kernels.convolution(
            self._weights[f"{name}.weight"],
            self._weights[f"{name}.bias"],
            self._device.name,
            strides=self._strides[int(level[1])] if level else (1, 1, 1),
            rectified=not name.endswith(self._linear),
        )
