"""Guessed surfaces: where nothing says how far away things are, only the farther ones hide what is behind them.

Noise on a wall without texture is matched at random, near and far. If all of that hid what is behind it, its nearest
pixels would hide the wall from nearly all views, and after a few sweeps they would be all that is left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfgpu.contract import Array, KernelSet
from lfgpu.methods.matching.square_mean import square_mean

_AROUND = 4  # pixels on each side of one, of which most must be uneven
_MOST = 0.7  # of them: fewer are uneven along an outline or a thin bar
_WIDE = 8  # pixels on each side of one, of whose surfaces the farther ones count
_PASSES = 2  # of leaving out what is nearer than the mean
_LITTLE = 1e-3  # what that counts nevertheless, so that means exist
_EQUAL = 1e-4  # pixels per view step: what is nearer by less is not
_LEAST = 0.01  # pixels per view step: less is not uneven

GUESS_REACH = _WIDE * (1 + _PASSES)
"""Rows and columns from a pixel to the farthest ones that say what it hides."""


class GuessedSurfaces:
    """Replaces guessed surfaces by the farther ones around them.

    Parameters
    ----------
    kernels
        Where it is computed.
    share
        The disparity of a pixel is ambiguous if more than this share of the disparities is as good as the best one.
    step, count
        The distance of the disparities that are compared, pixels per view step, and their number.
    tolerance
        A map is uneven where it differs by about this or more within 5 x 5 pixels, pixels per view step. Where most
        pixels around are both ambiguous and uneven, the map was guessed.
    ones, zeros
        Fields [y, x] of these numbers.
    workspace
        Five fields [y, x]; nothing is kept in them between two runs.
    """

    def __init__(
        self,
        kernels: KernelSet,
        *,
        share: float,
        step: float,
        count: int,
        tolerance: float,
        ones: Array,
        zeros: Array,
        workspace: Sequence[Array],
    ) -> None:
        self._kernels, self._ones, self._zeros = kernels, ones, zeros
        self._most_evidence, self._least_relief = -math.log(share * count * step), math.log(max(tolerance, _LEAST))
        self._line, *self._fields = workspace

    def run(self, evidence: Array, surface: Array, surface_out: Array) -> None:
        """What of a map [y, x] hides anything; `evidence` [y, x] is that of the costs from which it was found."""
        guessed, *others = self._fields
        self._find(evidence, surface, guessed, *others)
        self._push_back(surface, surface_out, *others)
        self._kernels.select(guessed, surface_out, surface, surface_out)

    def _find(self, evidence: Array, surface: Array, guessed_out: Array, *workspace: Array) -> None:
        """Above 0 where the map was guessed."""
        k, ones, (clear, relief, _) = self._kernels, self._ones, workspace
        k.unevenness(surface, bend_out=clear, relief_out=relief)
        k.copy(evidence, clear)
        k.axpby(-self._most_evidence, ones, 1.0, clear, clear)
        k.axpby(1.0, relief, -self._least_relief, ones, relief)
        k.select(relief, ones, self._zeros, relief)
        k.select(clear, self._zeros, relief, relief)
        self._mean(relief, _AROUND, guessed_out)
        k.axpby(1.0, guessed_out, -_MOST, ones, guessed_out)

    def _push_back(self, surface: Array, farther_out: Array, *workspace: Array) -> None:
        """The mean of the surfaces around each pixel that are farther than most, or the pixel's own if that is."""
        k, (counted, weighted, sums) = self._kernels, workspace
        self._mean(surface, _WIDE, farther_out)
        for _ in range(_PASSES):
            k.axpby(1.0, farther_out, -1.0, surface, counted)
            k.axpby(1.0, counted, _EQUAL, self._ones, counted)
            k.select(counted, self._ones, self._zeros, counted)
            k.axpby(1.0, counted, _LITTLE, self._ones, counted)
            k.multiply(counted, surface, weighted)
            self._mean(weighted, _WIDE, sums)
            self._mean(counted, _WIDE, farther_out)
            k.divide(sums, farther_out, farther_out)
        k.axpby(1.0, surface, -1.0, farther_out, counted)
        k.select(counted, farther_out, surface, farther_out)

    def _mean(self, values: Array, reach: int, means_out: Array) -> None:
        square_mean(self._kernels, values, reach=reach, workspace=self._line, means_out=means_out)
