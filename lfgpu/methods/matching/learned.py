"""The learned network: from views to a map, with what it says of each pixel, in the operations of a backend.

It is a U-Net over pixels and disparities. `lfgpu/training/network.py` has it for training; its names are those of the
weights.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from lfgpu.contract import COSTS, FOLD, Array, Float32Array, Rows, Scalar
from lfgpu.data.layout import ViewLayout
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.methods.arena import Arena, Scratch
from lfgpu.methods.matching.unet import (
    PIXELS,
    STORED,
    Layer,
    Layers,
    Shape,
    Source,
    UNet,
    Weights,
    level_layers,
    widths_of,
)

_STRIDES = {1: (1, 2, 2), 2: (2, 2, 2), 3: (2, 2, 2), 4: (1, 2, 2)}
_TOGETHER = 8  # a GPU keeps as many costs at a time as whole images have at so many disparities
_ROWS = 8  # a CPU keeps the costs of so many folded rows at a time
_GREY = 0.4  # intensity of pixels that are not valid: the mean that images are brought to
DISPARITIES = 4
"""The network works on as many disparities as are a multiple of this."""
NETWORK_REACH = 5 * PIXELS
"""Pixels on each side of a pixel on which its disparity depends."""

VERSION = 1
"""Version of files of weights: another one where the same numbers mean something else."""

_TRUST = {"share": (4,), "spread": (3,)}  # of `KernelSet.judge_peak`


class WeightsFile(str):
    """Name and hash of a file of weights, which stand for it among parameters, with the weights themselves."""

    weights: Weights


def weights_file(path: str | os.PathLike[str]) -> WeightsFile:
    """Read a file of weights, to be one of the parameters; LightFieldError as `read_weights`."""
    file, about = named(path), None
    with suppress(OSError):  # of a file that cannot be read, which reading says better
        found = file.stat()
        about = found.st_mtime_ns, found.st_size, found.st_ino
    return _read_once(str(file), about)


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


@cache
def weights_of_windows() -> Weights:
    """Read the weights of the network that compares windows around a map."""
    return read_weights(Path(__file__).with_name("windows.npz"))


BUILT_IN = Path(__file__).with_name("weights.npz")
"""The file of the weights that lfgpu comes with."""


def read_weights(path: str | os.PathLike[str]) -> Weights:
    """Read the weights of a network from a file of `lfgpu train`, .npz.

    Raises
    ------
    LightFieldError
        If it is no such file, or one of another version or another network.
    """
    weights = read_file(path)
    return checked_weights(path, weights, layers(widths_of(weights)), _TRUST)


def read_file(path: str | os.PathLike[str]) -> dict[str, Float32Array]:
    """Read the arrays of a file of weights by name; LightFieldError if it is damaged or of another version."""
    try:
        with np.load(path) as file:
            weights = {name: file[name].astype(np.float32) for name in file.files}
    except Exception as error:  # NumPy and zipfile raise whatever comes to them when a file is damaged
        reason = getattr(error, "strerror", None) or "it is damaged, or another kind of file"
        reason = "it does not exist" if isinstance(error, FileNotFoundError) else reason
        raise LightFieldError(
            f"{path} cannot be read as a file of weights (.npz): {reason}; give one that `lfgpu train` wrote."
        ) from error
    version = float(weights.pop("version", VERSION))
    if version != VERSION:
        raise LightFieldError(
            f"{path} holds weights of version {version:g}, but this lfgpu uses version {VERSION}; train them again."
        )
    return weights


def checked_weights(
    path: str | os.PathLike[str], weights: Weights, convolutions: Layers, others: Mapping[str, Shape]
) -> Weights:
    """Return those of the `weights` from a file that a network has; LightFieldError if they do not fit it."""
    expected = dict(others) | {
        f"{name}.{part}": shape
        for name, (window, inputs, outputs) in convolutions.items()
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


def layers(widths: Sequence[int]) -> Layers:
    """List the convolutions of a network with these channels at each resolution: window, and channels in and out."""
    c0, flat, pixel = widths[0], (1, 3, 3), (1, 1, 1)
    return {
        "sectors.0": (pixel, COSTS * FOLD**2, 2 * c0),
        "sectors.2": (pixel, 2 * c0, c0),
        "image.0": (flat, 4 * FOLD**2, c0),
        "image.2": (flat, c0, c0),
        **level_layers(widths),
        "logits": ((3, 3, 3), c0, FOLD**2),
    }


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
        The type of volumes, float16 or float32. Default: float16.
    """

    def __init__(
        self, arena: Arena, weights: Weights, layout: ViewLayout, count: int, *, stored: type = STORED
    ) -> None:
        assert count % DISPARITIES == 0
        self._kernels, self._device, self._layout, self._count = arena.kernels, arena.device, layout, count
        self._net = UNet(arena, weights, strides=_STRIDES, linear=(".coarse", "image.2", "logits"))
        self.parts = self._net.parts
        """The layers by name, and what else the network calls."""
        offsets = self._device.field(layout.offsets)
        self._costs_of = self._kernels.sector_costs(layout.shape, offsets, scale=layout.scale)
        self.parts |= {"fold": self._kernels.fold, "costs": self._costs_of, "peak": self._kernels.peak}
        self.image = arena.image("image for the network", (*layout.size, layout.channels))
        """The reference image [y, x, c] of the views that were loaded."""
        self.factor: Scalar = self._device.scalar(1.0)
        """The factor that brings this image to the brightness of training."""
        with arena.scratch() as scratch:
            self._allocate(scratch, weights, stored)

    def _allocate(self, scratch: Scratch, weights: Weights, stored: type) -> None:
        rows, columns = (-(-side // PIXELS) * PIXELS // FOLD for side in self._layout.size)
        shape: Shape = self._count, rows, columns

        def volume(size: Shape, channels: int) -> Array:
            return scratch.image((*size, channels), stored)

        self._folded = volume((1, rows, columns), 4 * FOLD**2)
        before = [Layer("image.0", rows)]
        before += [Layer("image.2", rows, (Source("image.0", 1),)), Layer("begin", rows, (Source("image.2"),))]
        after = Layer("logits", rows, (Source("back0", 1),)), Layer("peak", rows, (Source("logits"),))
        held = self._net.allocate(scratch, shape, stored, before=before, after=after)
        width = len(weights["image.2.bias"])
        self._seen, self._shown = (volume((1, held[name], columns), width) for name in ("image.0", "image.2"))
        together = max(1, rows * _TOGETHER // self._count) if self._device.is_gpu else _ROWS
        some = self._count, min(held["begin"], together), columns
        self._costs, self._mixed = volume(some, COSTS * FOLD**2), volume(some, weights["sectors.0.bias"].size)
        # Differences of these count.
        self._logits = scratch.image((self._count, held["logits"], columns, FOLD**2), np.float32)

    def load(self, views: Array, valid: Array | None) -> None:
        """Take views [n, y, x, c] as stored, and their masks [n, y, x] or None."""
        kernels, layout = self._kernels, self._layout
        kernels.intensities(views, layout.reference, valid, scale=layout.scale, fill=_GREY, image_out=self.image)
        kernels.brightness(self.image, factor_out=self.factor)
        self._costs_of.load(self.image, views, valid)

    def __call__(
        self, first: Array, *, step: float, disparity_out: Array, probability_out: Array, deviation_out: Array
    ) -> None:
        """Find the map among the disparities first + l step, `first` [y, x], in pixels per view step.

        All outputs are fields [y, x]: the disparity, the probability that it is near the truth, and the standard
        deviation there.
        """
        run, net = self.parts, self._net
        run["fold"](self.image, self.factor, folded_out=self._folded)
        maps = {"disparity_out": disparity_out, "probability_out": probability_out, "deviation_out": deviation_out}

        def begin(rows: Rows) -> None:
            most = self._costs.shape[1]
            for row in range(rows.first, rows.last, most):
                some = Rows(row, min(row + most, rows.last), rows.all)
                run["costs"](first, self.factor, self._costs, step=step, rows=some)
                run["sectors.0"](self._costs, None, self._mixed, rows=some)
                run["sectors.2"](self._mixed, self._shown, net.begin, rows=some)

        net.through(
            {
                "image.0": lambda rows: run["image.0"](self._folded, None, self._seen, rows=rows),
                "image.2": lambda rows: run["image.2"](self._seen, None, self._shown, rows=rows),
                "begin": begin,
                "logits": lambda rows: run["logits"](net.found, None, self._logits, rows=rows),
                "peak": lambda rows: run["peak"](self._logits, first, step=step, rows=rows, **maps),
            },
        )
