"""The levels of a U-Net over volumes [l, y, x, c], in the operations of a backend.

`lfgpu/training/network.py` has them for training; their names are those of the weights.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lfgpu.contract import FOLD, Array, Convolution, Float32Array
from lfgpu.methods.arena import Arena, Scratch

LEVELS = 5
PIXELS = 16 * FOLD
"""Rows and columns of images are filled up to multiples of this."""

Shape = tuple[int, ...]
Layers = dict[str, tuple[Shape, int, int]]
"""Convolutions by name: the window, and the channels in and out."""

Weights = Mapping[str, Float32Array]
"""Weights [l, y, x, c_in, c_out] of each convolution as "NAME.weight", and its bias [c_out] as "NAME.bias"."""

Strides = Mapping[int, tuple[int, int, int]]
"""The strides of the first convolution of a level, from the level above, by level from 1 on."""


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

    def allocate(self, scratch: Scratch, shape: Shape, stored: type) -> Array:
        """Allocate the volumes of all levels, the finest of `shape`; return the one from which `through` begins."""
        self._levels, self._coarse = list[tuple[Array, Array]](), list[Array]()
        for level in range(LEVELS):
            if level:
                shape = tuple(length // by for length, by in zip(shape, self._strides[level], strict=True))
                self._coarse.append(scratch.image((*shape, self._width(level - 1)), stored))
            here = *shape, self._width(level)
            self._levels.append((scratch.image(here, stored), scratch.image(here, stored)))
        return self._levels[0][0]

    def through(self) -> Array:
        """Run all levels; return the finest volume, which is the result."""
        run, ((begin, found), *others) = self.parts, self._levels
        run["level0"](begin, None, found)
        for level, (between, here) in enumerate(others, 1):
            run[f"level{level}.0"](found, None, between)
            run[f"level{level}.1"](between, None, here)
            found = here
        for level in reversed(range(LEVELS - 1)):
            (between, here), coarse = self._levels[level], self._coarse[level]
            run[f"merge{level}.coarse"](found, None, coarse)
            run[f"merge{level}.fine"](here, coarse, between)
            run[f"back{level}"](between, None, here)
            found = here
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


def stored_type(arena: Arena) -> type:
    """Return the type of volumes: float16 on a GPU, else float32."""
    return np.float16 if arena.device.is_gpu else np.float32
