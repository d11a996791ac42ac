"""The choice between two maps of a table of sweeps: that of the sweeps, and that of a network.

Neither knows of the other, and they fail at different places. A second, small network, which looks at both maps and
what they say of themselves, tells which to believe, and how likely the result is right. `benchmarks/choosing.py`
trains it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from lfgpu.contract import COMPARED, DECISIONS, FOLD, Array, Scalar
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.aggregation import Learned
from lfgpu.methods.matching.alignment import Alignment
from lfgpu.methods.matching.base import square_mean
from lfgpu.methods.matching.completion import Completion
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.learned import checked_weights, read_file
from lfgpu.methods.matching.passes import Sweeps
from lfgpu.methods.matching.unet import PIXELS, STORED, Layer, Layers, Source, UNet, Weights, level_layers, widths_of

BUILT_IN = Path(__file__).with_name("choice.npz")
"""The file of the weights of the choice."""

REACHES = 4, 16
"""Pixels on each side over which maps are averaged, to see how a pixel differs from those around it."""

_STRIDES = dict.fromkeys(range(1, 5), (1, 2, 2))


def layers(widths: Sequence[int]) -> Layers:
    """List the convolutions of a choice with these channels at each resolution: window, and channels in and out."""
    c0, flat, pixel = widths[0], (1, 3, 3), (1, 1, 1)
    return {
        "image.0": (pixel, 4 * FOLD**2, 2 * c0),
        "features.0": (pixel, COMPARED * FOLD**2, 2 * c0),
        "features.2": (pixel, 2 * c0, c0),
        **level_layers(widths, whole=flat),
        "decisions": (flat, c0, DECISIONS * FOLD**2),
    }


def read_choice(path: Path) -> Weights:
    """Read the weights of a choice; LightFieldError if the file holds something else."""
    weights = read_file(path)
    return checked_weights(path, weights, layers(widths_of(weights)), {})


@cache
def _built_in() -> Weights:
    return read_choice(BUILT_IN)


class Choice:
    """The network that chooses, a U-Net over the pixels of images [y, x, c], with all memory allocated.

    Its volumes are `stored` as float16 or float32.
    """

    def __init__(self, arena: Arena, weights: Weights, size: tuple[int, int], *, stored: type = STORED) -> None:
        self._kernels = arena.kernels
        self._net = UNet(arena, weights, strides=_STRIDES, linear=(".coarse", "image.0", "decisions"))
        rows, columns = (-(-side // PIXELS) * PIXELS // FOLD for side in size)
        shape = 1, rows, columns
        with arena.scratch() as scratch:
            self.image, self.features = (
                scratch.image((*shape, channels * FOLD**2), stored) for channels in (4, COMPARED)
            )
            width, names = len(weights["features.0.bias"]), ("image.0", "features.0")
            before = [Layer(names[0], rows), Layer(names[1], rows, (Source(names[0]),))]
            before.append(Layer("features.2", rows, (Source(names[1]),)))
            after = [Layer("decisions", rows, (Source("back0", 1),))]
            held = self._net.allocate(scratch, shape, stored, before=before, after=after)
            self._seen, self._mixed = (scratch.image((1, held[name], columns, width), stored) for name in names)
            self._decisions = scratch.image((*shape, DECISIONS * FOLD**2), np.float32)

    def see(
        self, image: Array, factor: Scalar, first: Sequence[Array], second: Sequence[Array], *, farthest: float,
        span: float | Scalar,
    ) -> None:  # fmt: skip
        """Take two maps, as `KernelSet.compare_maps` does, of a reference image [y, x, c] times a factor."""
        self._kernels.fold(image, factor, folded_out=self.image)
        self._kernels.compare_maps(first, second, farthest=farthest, span=span, features_out=self.features)

    def __call__(self) -> Array:
        """Find the decisions of `KernelSet.choose`."""
        run, net = self._net.parts, self._net
        net.through(
            {
                "image.0": lambda rows: run["image.0"](self.image, None, self._seen, rows=rows),
                "features.0": lambda rows: run["features.0"](self.features, self._seen, self._mixed, rows=rows),
                "features.2": lambda rows: run["features.2"](self._mixed, None, net.begin, rows=rows),
                "decisions": lambda rows: run["decisions"](net.found, None, self._decisions, rows=rows),
            }
        )
        return self._decisions


class SecondMap:
    """The map of the network, aligned and filled as that of the sweeps is, and the choice between both.

    Parameters
    ----------
    frame
        The views.
    sweeps
        The sweeps, with a second one.
    """

    def __init__(self, frame: Frame, sweeps: Sweeps) -> None:
        arena, size = frame.arena, frame.size
        assert sweeps.second is not None
        self._kernels, self._sweeps, self._second = frame.kernels, sweeps, sweeps.second
        self._farthest, self._steps = frame.layout.farthest, frame.config.alignment.iterations
        self._span = arena.number(lambda: frame.bounds[1] - frame.bounds[0])
        self._matched = arena.field("second map, matched", size)
        self.map = arena.field("second map", size)
        """The map of the network [y, x]."""
        self.first = arena.field("first map", size)
        """The map of the sweeps [y, x]."""
        with arena.scratch() as scratch:
            self._workspace = scratch.field(size)
            self._means = [scratch.fields(2, size) for _ in REACHES]
            self.choice = Choice(arena, _built_in(), size)

    def take(
        self, alignment: Alignment, completion: Completion, unhidden: Array | None, map_: Array, confidence_out: Array
    ) -> None:
        """Find the second map, and make `map_` [y, x], that of the sweeps, the chosen one.

        Its variance is that of the judging. `unhidden` as for `Judging.run`.
        """
        self._kernels.copy(map_, self.first)
        self._compare(alignment, completion, unhidden, confidence_out)
        self._kernels.choose(
            self.choice(),
            self.first,
            self.map,
            farthest=self._farthest,
            disparity_out=map_,
            confidence_out=confidence_out,
            variance_out=self._sweeps.judging.variance,
        )

    def _compare(
        self, alignment: Alignment, completion: Completion, unhidden: Array | None, confidence_out: Array
    ) -> None:
        """Find the second map, and show the choice both; the confidence is that of the first one."""
        network = self._second.aggregation
        assert isinstance(network, Learned)
        self._sweeps.find(self._second, None, self._matched)
        completion.restore_prior()
        alignment.run(self._matched, network.variance, self.map, self._steps, None, trust_out=None)
        completion.fill(self.map, alignment.curvature)
        self._sweeps.judge(self._sweeps.last, self.first, unhidden, confidence_out)
        own = [self.first, confidence_out, self._sweeps.judging.variance]
        others = [self.map, network.confidence, network.variance]
        for reach, means in zip(REACHES, self._means, strict=True):
            for values, mean in zip((own, others), means, strict=True):
                square_mean(self._kernels, values[0], reach=reach, workspace=self._workspace, means_out=mean)
                values.append(mean)
        self.choice.see(network.image, network.factor, own, others, farthest=self._farthest, span=self._span)
