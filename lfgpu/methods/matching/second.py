"""The second map of a table of sweeps, which a network finds, and the choice between both maps at each pixel."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Array
from lfgpu.methods.matching.alignment import Alignment
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.passes import Sweeps

_UNHELD = 1e12  # variance of pixels that no second map holds


class SecondMap:
    """The choice of the surer map at each pixel: that of the sweeps, or that of the network.

    Both say how likely they are right, and neither knows of the other. They fail at different places: the network on
    large plain walls, the sweeps at gaps, thin things, gloss and noise.

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
        network = sweeps.second.aggregation
        assert network.confidence is not None
        assert network.variance is not None
        self._kernels, self._sweeps, self._second = frame.kernels, sweeps, sweeps.second
        self._confidence, self._variance = network.confidence, network.variance
        self._is_chosen, self._map, self._held, self._judged = (
            arena.field(f"second map, {name}", size) for name in ("chosen", "map", "held", "judged")
        )
        self._unheld = arena.constant("unheld", np.full(size, _UNHELD))

    def take(self, alignment: Alignment, unhidden: Array | None, map_: Array) -> None:
        """Replace the pixels of an aligned map [y, x] of which the network is surer, and align once more.

        `unhidden` as for `Judging.run`.
        """
        kernels = self._kernels
        self._sweeps.judge(self._sweeps.last, map_, unhidden, self._judged)
        self._sweeps.find(self._second, None, self._map)
        kernels.axpby(1.0, self._confidence, -1.0, self._judged, self._is_chosen)
        kernels.threshold(self._is_chosen, 0.0, self._is_chosen)
        kernels.select(self._is_chosen, self._map, map_, self._map)
        kernels.select(self._is_chosen, self._variance, self._unheld, self._held)
        alignment.run(self._map, self._held, map_, 1, None)

    def judge(self, confidence: Array) -> None:
        """Put the network's confidence and variance in place of those of a judged map [y, x] where it was chosen."""
        variance = self._sweeps.judging.variance
        self._kernels.select(self._is_chosen, self._confidence, confidence, confidence)
        self._kernels.select(self._is_chosen, self._variance, variance, variance)
