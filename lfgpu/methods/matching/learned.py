"""The learned network: from views to a map, with what it says of each pixel, in the operations of a backend.

It is a U-Net over pixels and disparities. `lfgpu/training/network.py` has it for training; its names are those of the
weights.
"""

from __future__ import annotations

import os
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from lfgpu.contract import COSTS, FOLD, Array, Convolution, Float32Array, Scalar
from lfgpu.data.layout import ViewLayout
from lfgpu.errors import LightFieldError
from lfgpu.methods.arena import Arena, Scratch

_LEVELS = 5
_STRIDES = {1: (1, 2, 2), 2: (2, 2, 2), 3: (2, 2, 2), 4: (1, 2, 2)}
"""Of the first convolution of a level, from the level above."""
_TOGETHER = {"cpu": 4, "gpu": 16}  # disparities whose costs are in memory at the same time, at most
_GREY = 0.4  # intensity of pixels that are not valid: the mean that images are brought to
PIXELS, DISPARITIES = 16 * FOLD, 4
"""The network works on as many rows and columns, and on as many disparities, as are multiples of these."""
NETWORK_REACH = 5 * PIXELS
"""Pixels on each side of a pixel on which its disparity depends."""

Shape = tuple[int, ...]

Weights = Mapping[str, Float32Array]
"""Weights [l, y, x, c_in, c_out] of each convolution as "NAME.weight", and its bias [c_out] as "NAME.bias".

`share` [4] and `spread` [3] are those of `KernelSet.judge_peak`.
"""

VERSION = 1
"""Version of files of weights: another one where the same numbers mean something else."""

_TRUST = {"share": (4,), "spread": (3,)}


class WeightsFile(str):
    """Name and hash of a file of weights, which stand for it among parameters, with the weights themselves."""

    weights: Weights


def weights_file(path: str | os.PathLike[str]) -> WeightsFile:
    """Read a file of weights, to be one of the parameters; LightFieldError as `read_weights`."""
    about = Path(path).stat() if Path(path).is_file() else None
    return _read_once(os.fspath(path), about and (about.st_mtime_ns, about.st_size, about.st_ino))


@lru_cache(maxsize=8)
def _read_once(path: str, about: tuple[int, ...] | None) -> WeightsFile:
    """Read a file of weights if it has changed, as `about` tells."""
    weights = read_weights(path)
    found = WeightsFile(f"{Path(path).name} (SHA-256 {sha256(Path(path).read_bytes()).hexdigest()[:16]})")
    found.weights = weights
    return found


def weights_of(name: str) -> Weights:
    """Return the weights that parameters name; LightFieldError if they are only a name, read from a result."""
    if not name:
        return _built_in()
    if not isinstance(name, WeightsFile):
        raise LightFieldError(
            f"these parameters name the weights {name}, but a result does not hold them; give the file as weights."
        )
    return name.weights


@cache
def _built_in() -> Weights:
    """Read the weights that lfgpu comes with."""
    return read_weights(BUILT_IN)


BUILT_IN = Path(__file__).with_name("weights.npz")
"""The file of the weights that lfgpu comes with."""


def read_weights(path: str | os.PathLike[str]) -> Weights:
    """Read the weights of a network from a file of `lfgpu train`, .npz.

    Raises
    ------
    LightFieldError
        If it is no such file, or one of another version or another network.
    """
    try:
        with np.load(path) as file:
            weights = {name: file[name].astype(np.float32) for name in file.files}
    except (OSError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        reason = "it does not exist" if not Path(path).exists() else "it is damaged, or another kind of file"
        raise LightFieldError(f"{path} cannot be read as a file of weights (.npz): {reason}.") from error
    version = float(weights.pop("version", VERSION))
    if version != VERSION:
        raise LightFieldError(
            f"{path} holds weights of version {version:g}, but this lfgpu uses version {VERSION}; train them again."
        )
    widths = [len(weights.get(f"back{level}.bias", ())) for level in range(_LEVELS - 1)]
    expected = _TRUST | {
        f"{name}.{part}": shape
        for name, (window, inputs, outputs) in layers(widths).items()
        for part, shape in (("weight", (*window, inputs, outputs)), ("bias", (outputs,)))
    }
    if not set(expected) & set(weights):
        raise LightFieldError(f"{path} holds no weights of a network: it was not written by lfgpu train.")
    for name, shape in expected.items():
        found = weights[name].shape if name in weights else None
        if found != shape or not np.isfinite(weights[name]).all():
            is_there = "is missing" if found is None else f"has shape {list(found)}, not {list(shape)}"
            is_there = "holds NaN or infinity" if found == shape else is_there
            raise LightFieldError(f"{path} does not fit the network of this lfgpu: {name} {is_there}; train again.")
    return {name: weights[name] for name in expected}


def layers(widths: Sequence[int]) -> dict[str, tuple[Shape, int, int]]:
    """List the convolutions of a network with these channels at each resolution: window, and channels in and out."""
    c0, c1, c2, c3 = widths
    whole, flat, pixel = (3, 3, 3), (1, 3, 3), (1, 1, 1)
    found: dict[str, tuple[Shape, int, int]] = {
        "sectors.0": (pixel, COSTS * FOLD**2, 2 * c0),
        "sectors.2": (pixel, 2 * c0, c0),
        "image.0": (flat, 4 * FOLD**2, c0),
        "image.2": (flat, c0, c0),
        "level0": (whole, c0, c0),
    }
    for level, (above, here) in enumerate(((c0, c1), (c1, c2), (c2, c3), (c3, c3)), 1):
        found[f"level{level}.0"] = (whole if level < 4 else flat, above, here)
        found[f"level{level}.1"] = (whole, here, here)
        found[f"merge{level - 1}.coarse"] = (pixel, here, above)
        found[f"merge{level - 1}.fine"] = (pixel, above, above)
        found[f"back{level - 1}"] = (whole, above, above)
    return found | {"logits": (whole, c0, FOLD**2)}


class Network:
    """The network for views of one layout, with all memory allocated.

    Parameters
    ----------
    arena
        Where buffers come from. Those of the network hold nothing between calls.
    weights
        The weights.
    layout
        The layout of the views.
    count
        The number of disparities, a multiple of `DISPARITIES`.
    stored
        The type of volumes, float16 or float32. Default: float16 on a GPU, else float32.
    """

    def __init__(
        self, arena: Arena, weights: Weights, layout: ViewLayout, count: int, *, stored: type | None = None
    ) -> None:
        assert count % DISPARITIES == 0
        self._kernels, self._device, self._layout, self._count = arena.kernels, arena.device, layout, count
        names = [name.removesuffix(".weight") for name in weights if name.endswith(".weight")]
        self.parts: dict[str, Callable[..., None]] = {name: self._layer(name, weights) for name in names}
        """The layers by name, and what else the network calls."""
        offsets = self._device.field(layout.offsets)
        self._costs_of = self._kernels.sector_costs(layout.shape, offsets, scale=layout.scale)
        self.parts |= {"fold": self._kernels.fold, "costs": self._costs_of, "peak": self._kernels.peak}
        self._image = arena.image("image for the network", (*layout.size, layout.channels))
        self._factor: Scalar = self._device.scalar(1.0)
        with arena.scratch() as scratch:
            self._allocate(scratch, weights, stored or (np.float16 if arena.device.is_gpu else np.float32))

    def _allocate(self, scratch: Scratch, weights: Weights, stored: type) -> None:
        rows, columns = (-(-side // PIXELS) * PIXELS // FOLD for side in self._layout.size)
        shape: Shape = self._count, rows, columns

        def volume(size: Shape, channels: int) -> Array:
            return scratch.image((*size, channels), stored)

        widths = [weights[f"level{level}{'.0' if level else ''}.weight"].shape[-1] for level in range(_LEVELS)]
        self._folded = volume((1, *shape[1:]), 4 * FOLD**2)
        self._seen, self._shown = (volume((1, *shape[1:]), widths[0]) for _ in range(2))
        most = _TOGETHER["gpu" if self._device.is_gpu else "cpu"]
        self._together = max(some for some in range(DISPARITIES, most + 1, DISPARITIES) if self._count % some == 0)
        some = self._together, *shape[1:]
        self._costs, self._mixed = volume(some, COSTS * FOLD**2), volume(some, weights["sectors.0.bias"].size)
        self._finest, self._levels, self._coarse = shape, list[tuple[Array, Array]](), list[Array]()
        for level, width in enumerate(widths):
            if level:
                shape = tuple(length // by for length, by in zip(shape, _STRIDES[level], strict=True))
                self._coarse.append(volume(shape, widths[level - 1]))
            self._levels.append((volume(shape, width), volume(shape, width)))
        self._logits = scratch.image((*self._finest, FOLD**2), np.float32)  # differences of these count

    def load(self, views: Array, valid: Array | None) -> None:
        """Take views [n, y, x, c] as stored, and their masks [n, y, x] or None."""
        kernels, layout = self._kernels, self._layout
        kernels.intensities(views, layout.reference, valid, scale=layout.scale, fill=_GREY, image_out=self._image)
        kernels.brightness(self._image, factor_out=self._factor)
        self._costs_of.load(self._image, views, valid)

    def __call__(
        self, first: Array, *, step: float, disparity_out: Array, probability_out: Array, deviation_out: Array
    ) -> None:
        """Find the map among the disparities first + l step, `first` [y, x], in pixels per view step.

        All outputs are fields [y, x]: the disparity, the probability that it is near the truth, and the standard
        deviation there.
        """
        run = self.parts
        run["fold"](self._image, self._factor, folded_out=self._folded)
        run["image.0"](self._folded, None, self._seen)
        run["image.2"](self._seen, None, self._shown)
        (mixed, found), *others = self._levels
        for label in range(0, self._count, self._together):
            run["costs"](first, self._factor, self._costs, step=step, label=label)
            run["sectors.0"](self._costs, None, self._mixed)
            run["sectors.2"](self._mixed, self._shown, mixed, at=label)
        run["level0"](mixed, None, found)
        for level, (between, here) in enumerate(others, 1):
            run[f"level{level}.0"](found, None, between)
            run[f"level{level}.1"](between, None, here)
            found = here
        for level in reversed(range(_LEVELS - 1)):
            (between, here), coarse = self._levels[level], self._coarse[level]
            run[f"merge{level}.coarse"](found, None, coarse)
            run[f"merge{level}.fine"](here, coarse, between)
            run[f"back{level}"](between, None, here)
            found = here
        run["logits"](found, None, self._logits)
        run["peak"](
            self._logits,
            first,
            step=step,
            disparity_out=disparity_out,
            probability_out=probability_out,
            deviation_out=deviation_out,
        )

    def _layer(self, name: str, weights: Weights) -> Convolution:
        """Plan a convolution."""
        level = re.fullmatch(r"level(\d)\.0", name)
        return self._device.kernels.convolution(
            weights[f"{name}.weight"],
            weights[f"{name}.bias"],
            self._device.name,
            strides=_STRIDES[int(level[1])] if level else (1, 1, 1),
            rectified=not name.endswith((".coarse", "image.2", "logits")),
        )
