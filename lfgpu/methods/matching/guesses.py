"""Guessed surfaces: where the views do not show how far away things are, only the farther surfaces hide anything.

Noise on a wall without texture is matched at random, near and far. If all of that hid what is behind it, its nearest
pixels would hide the wall from nearly all views, and after a few sweeps they would be all that is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from lfgpu.contract import Array, Disparities
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.base import square_mean

_AROUND = 4  # pixels on each side of a guessed pixel, most of which are uneven
_MOST = 0.7  # share of uneven pixels around a guessed one: along an outline or a thin bar it is smaller
_WIDE = 8  # pixels on each side of a guessed pixel, of which the farther ones replace it
_PASSES = 2  # means over the farther pixels, each over those beyond the mean before
_LITTLE = 1e-3  # weight of the nearer pixels, so that means exist
_EQUAL = 1e-4  # pixels per view step: smaller differences are none
_LEAST = 0.01  # pixels per view step: smaller tolerances count as this one

GUESS_REACH = _WIDE * (1 + _PASSES)
"""Pixels from a pixel to the farthest ones on which its replacement depends."""


class GuessedSurfaces:
    """Replaces guessed surfaces by the farther ones around them.

    A pixel is ambiguous if more than a `share` of the disparities is as good as the best one. A map is uneven where it
    differs by about the `tolerance` or more, pixels per view step, within 5 x 5 pixels. Where most pixels around are
    both, the map was guessed.
    """

    def __init__(
        self,
        arena: Arena,
        size: tuple[int, int],
        *,
        share: float,
        disparities: Callable[[], Disparities],
        tolerance: float,
        ones: Array,
    ) -> None:
        self._kernels, self._ones, self._zeros = arena.kernels, ones, arena.field("zeros", size)
        self._least_width = arena.number(lambda: math.log(share * disparities().count * disparities().step))
        self._least_relief = math.log(max(tolerance, _LEAST))
        with arena.scratch() as scratch:
            self._line, *self._fields = scratch.fields(5, size)

    def run(self, evidence: Array, surface: Array, surface_out: Array) -> None:
        """Replace the guessed surfaces of a map [y, x]; `evidence` [y, x] is that of the costs that gave the map."""
        guessed, *others = self._fields
        self._find(evidence, surface, guessed, *others)
        self._push_back(surface, surface_out, *others)
        self._kernels.select(guessed, surface_out, surface, surface_out)

    def _find(self, evidence: Array, surface: Array, guessed_out: Array, *workspace: Array) -> None:
        """Write numbers above 0 where the map was guessed."""
        k, ones, (clear, relief, _) = self._kernels, self._ones, workspace
        k.unevenness(surface, bend_out=clear, relief_out=relief)
        k.copy(evidence, clear)
        k.axpby(self._least_width, ones, 1.0, clear, clear)
        k.axpby(1.0, relief, -self._least_relief, ones, relief)
        k.select(relief, ones, self._zeros, relief)
        k.select(clear, self._zeros, relief, relief)
        self._mean(relief, _AROUND, guessed_out)
        k.axpby(1.0, guessed_out, -_MOST, ones, guessed_out)

    def _push_back(self, surface: Array, farther_out: Array, *workspace: Array) -> None:
        """Average the disparities around each pixel that are farther than their mean; keep a pixel that is farther."""
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
