"""The alignment: Gauss-Newton steps make a matched map continuous."""

from __future__ import annotations

import math

import numpy as np

from lfgpu import contract
from lfgpu.contract import Array, Float64Array, Scalar
from lfgpu.methods.base import Callback
from lfgpu.methods.matching.frame import Frame
from lfgpu.solvers.solution import Solution

_SUREST = 0.02  # pixels in the farthest view: no map is better than this
_BESIDE = 1  # pixels beside an edge in another view where both sides are mixed: they are left out


class Alignment:
    """Steps on the common evidence of the views that see a pixel, and the plane through similar pixels after each.

    Of large grids, every other view is compared until the last step, but all where sweeps compare near views only.
    """

    def __init__(self, frame: Frame) -> None:
        arena, config = frame.arena, frame.config
        self._frame, self._kernels, self._prior = frame, frame.kernels, frame.prior
        self._bounds, self._farthest = (frame.low, frame.high), frame.layout.farthest
        self._tuning = tuning = config.tuning.alignment
        self._reach = self._tuning.reach * frame.disparities.step
        self._floor = arena.number(lambda: tuning.least_curvature * frame.config.tuning.alignment.robust**2)
        self._stiffness = arena.number(lambda: tuning.stiffness * frame.config.tuning.alignment.robust**2)
        self._of_matched = arena.number(lambda: (tuning.matched * frame.config.tuning.alignment.robust) ** 2)
        self.moves = [arena.device.scalar(0.0) for _ in range(config.alignment.iterations)]
        """Sums over the squares of each step."""
        self.curvature = arena.field("curvature", frame.size)
        """The curvature of the views' differences at the map [y, x] of the last step."""
        with arena.scratch() as scratch:
            self._last = self._first = _Step(frame, frame.layout.offsets)
            if frame.compared_layout is not frame.layout and not frame.is_wide:
                self._first = _Step(frame, frame.compared_offsets, self._last)
            self._slope, self._certainty, self._workspace = scratch.fields(3, frame.size)
            self._variance, self._matched_weight = scratch.fields(2, frame.size)
            self._room = scratch.room(self._last.align, frame.layout.dtype)

    def run(
        self,
        matched: Array,
        variance: Array | None,
        map_out: Array,
        steps: int,
        callback: Callback | None,
        *,
        trust_out: Scalar | None,
    ) -> None:
        """Align a matched map [y, x] by so many steps.

        With its `variance` [y, x] it counts beside the views: each pixel goes to where both together are likeliest, and
        then back by most of its way if it has moved farther than the map's deviation. `trust_out`, if any, is the
        amount of texture; 0 if there was none.
        """
        self._last.align.load(self._frame.image, *self._frame.used, self._room)
        if variance is not None:
            self._weigh_matched(variance)
        kernels, tuning, workspace = self._kernels, self._tuning, self._workspace
        wide, reach = self._frame.is_wide, self._frame.reach
        longest, support = tuning.longest_step / reach, tuning.support / reach
        kernels.copy(matched, map_out)
        if wide:
            kernels.copy(self._prior.ones, self._certainty)
        for iteration, moved in enumerate(self.moves[:steps], 1):
            if wide:
                self._fit_planes(map_out, support)
            step = self._last if iteration == steps else self._first
            step(map_out, self.curvature, self._slope)
            if variance is not None:
                self._hold(matched, map_out)
            self._prior.ratio(
                map_out, self._slope, self.curvature, support=support, floor=self._floor, ratio_out=workspace
            )
            kernels.clamp(workspace, -longest, longest, workspace)
            kernels.dot(workspace, workspace, moved)
            kernels.axpby(1.0, map_out, 1.0, workspace, map_out)
            kernels.clamp(map_out, *self._bounds, map_out)
            if iteration == steps:
                if variance is None:
                    self.put_back(matched, map_out)
                else:
                    self._draw_back(matched, map_out)
            self._weigh_texture()
            if not wide:
                self._fit_planes(map_out, support)
            if callback is not None:
                callback(iteration, self._size_of(moved))
        if trust_out is not None:
            kernels.axpby(1.0, self._certainty, -tuning.still, self._prior.ones, workspace)
            kernels.dot(workspace, self._prior.ones, trust_out)

    def solution(self, noise: float) -> Solution:
        """Report the outcome; the trace is the root mean square of each step, pixels per view step.

        It has converged if its last step stays nearer to the compared disparity than halfway to the next one: a step
        is right only near the surface that was matched. `noise` is that between the views, intensity.
        """
        trace, halfway = tuple(map(self._size_of, self.moves)), self._frame.disparities.step / 2
        return Solution(
            converged=trace[-1] <= halfway,
            status=f"Noise between views: {noise:.2g} of full intensity. The last step of the alignment moved "
            f"pixels by {trace[-1]:.2g} px (rms); compared disparities are {2 * halfway:.2g} px apart.",
            iterations=len(trace),
            evaluations=len(trace),
            trace=trace,
        )

    def put_back(self, matched: Array, map_: Array) -> None:
        """Return the pixels of a map to where they were matched, if they are farther than the reach from there.

        The smooth shading of a glossy surface moves with what is mirrored in it, not with the surface. It draws pixels
        away from the surface, a little farther in every step; matching is right there to about one disparity.
        """
        kernels, workspace = self._kernels, self._workspace
        kernels.axpby(1.0, map_, -1.0, matched, workspace)
        kernels.multiply(workspace, workspace, workspace)
        kernels.threshold(workspace, self._reach**2, workspace)
        kernels.select(workspace, matched, map_, map_)

    def _draw_back(self, matched: Array, map_: Array) -> None:
        """Give each pixel of a map its mean with where it was matched, weighted by inverse variances.

        The matched map states its variance. In a reflection the views agree well beside the surface, so their curvature
        says nothing of the error: the deviation of an aligned pixel is taken to be as large as its move.
        """
        kernels, moved, share = self._kernels, self._workspace, self._slope
        kernels.axpby(1.0, map_, -1.0, matched, moved)
        kernels.multiply(moved, moved, share)
        kernels.axpby(1.0, share, 1.0, self._variance, share)
        kernels.divide(self._variance, share, share)
        kernels.multiply(share, moved, moved)
        kernels.axpby(1.0, matched, 1.0, moved, map_)

    def _fit_planes(self, map_: Array, support: float) -> None:
        """Give each pixel of a map [y, x] its value on the plane through similar pixels that are certain."""
        workspace, ridge = self._workspace, self._tuning.ridge
        self._prior.plane(map_, self._certainty, support=support, ridge=ridge, plane_out=workspace)
        self._kernels.copy(workspace, map_)

    def _weigh_matched(self, variance: Array) -> None:
        """Find the curvature of the log likelihood of the matched map, in units of that of the views."""
        kernels, weight = self._kernels, self._matched_weight
        kernels.clamp(variance, (_SUREST / self._farthest) ** 2, np.inf, self._variance)
        kernels.divide(self._prior.ones, self._variance, weight)
        kernels.axpby(self._of_matched, weight, 0.0, weight, weight)

    def _hold(self, matched: Array, map_: Array) -> None:
        """Add the matched map to the curvature and the slope of the views."""
        kernels, weight, workspace = self._kernels, self._matched_weight, self._workspace
        kernels.axpby(1.0, matched, -1.0, map_, workspace)
        kernels.multiply(workspace, weight, workspace)
        kernels.axpby(1.0, self._slope, 1.0, workspace, self._slope)
        kernels.axpby(1.0, self.curvature, 1.0, weight, self.curvature)

    def _weigh_texture(self) -> None:
        """certainty = curvature / (curvature + stiffness) + a little, so that means exist where nothing is certain."""
        kernels, tuning, ones = self._kernels, self._tuning, self._prior.ones
        kernels.axpby(1.0, self.curvature, self._stiffness, ones, self._certainty)
        kernels.divide(self.curvature, self._certainty, self._certainty)
        kernels.axpby(1.0, self._certainty, tuning.still, ones, self._certainty)

    def _size_of(self, moved: Scalar) -> float:
        height, width = self._frame.size
        return math.sqrt(self._kernels.number(moved) / (height * width))


class _Step:
    """A step over some of the used views: which of them see a pixel, and how well these agree.

    Parameters
    ----------
    frame
        The views.
    offsets
        (du, dv) of each used view [n, 2], NaN if it is left out.
    shared
        A step over more views, which has them loaded. Default: None, the step loads all.
    """

    def __init__(self, frame: Frame, offsets: Float64Array, shared: _Step | None = None) -> None:
        arena, tuning = frame.arena, frame.config.tuning
        self._hiding, self._offsets = frame.hiding, arena.device.field(offsets)
        self.align: contract.Alignment = arena.kernels.alignment(
            frame.layout.shape,
            self._offsets,
            scale=frame.layout.scale,
            gradient_weight=tuning.alignment.gradient_weight,
            contrast=arena.number(lambda: frame.config.tuning.alignment.contrast),
            robust=arena.number(lambda: frame.config.tuning.alignment.robust),
            tolerance=tuning.sweep.tolerance / frame.layout.farthest,
            shared=None if shared is None else shared.align,
        )
        with arena.scratch() as scratch:
            self._nearest = scratch.field(frame.layout.shape[:3])

    def __call__(self, map_: Array, curvature_out: Array, slope_out: Array) -> None:
        """Curvature and slope [y, x] of how the views differ at a map [y, x]."""
        self._hiding(map_, self._offsets, self._nearest, reach=_BESIDE)
        self.align(map_, self._nearest, curvature_out, slope_out)
