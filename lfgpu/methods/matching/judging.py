"""Confidence and variance of a map, from its costs and its shape around each pixel."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Array, Float32Array
from lfgpu.methods.matching import trust
from lfgpu.methods.matching.base import square_mean
from lfgpu.methods.matching.costs import noise_cost
from lfgpu.methods.matching.frame import Frame

FEATURES = ("conflict", "evidence", "bend", "relief", "wide", "cost")
"""The maps on which confidence and variance depend, in the order of `KernelSet.judge`."""

_AROUND = 4  # pixels on each side of a pixel over which conflict and evidence are averaged
_WIDE = 16  # pixels on each side over which evidence and costs farther around are averaged


def kind_of(resweeps: int) -> str:
    """Return the key of the weights in `trust.py` for a number of sweeps after the first one."""
    return "again" if resweeps > 1 else "once"


class Judging:
    """The confidence of a map, and its variance.

    `kind` is a key of the weights in `trust.py` (`kind_of`).
    """

    def __init__(self, frame: Frame, *, kind: str) -> None:
        arena, size = frame.arena, frame.size
        self.kernels, self._share, self._spread = arena.kernels, trust.SHARE[kind], trust.SPREAD[kind]
        self._step, self._labels = frame.disparities.step, frame.labels
        self._span = arena.number(lambda: frame.bounds[1] - frame.bounds[0])
        # Nothing is less certain than a disparity that may be anywhere between the bounds.
        self._most = arena.number(lambda: (frame.bounds[1] - frame.bounds[0]) ** 2 / 12)
        self._unit = arena.number(lambda: noise_cost(frame.config))
        self.variance = arena.field("variance", size)
        """The variance of the disparity [y, x], (pixels per view step)²."""
        with arena.scratch() as scratch:
            self._fields = scratch.fields(len(FEATURES), size)

    def evidence(self, costs: Array, path_costs: Array, evidence_out: Array) -> None:
        """Compute -log of the width of the disparities that are as good as the best one, a field [y, x]."""
        conflict, cost, *_ = self._fields
        self._evaluate(costs, path_costs, conflict, evidence_out, cost)

    def run(
        self, costs: Array, path_costs: Array, disparity: Array, unhidden: Array | None, confidence_out: Array
    ) -> None:
        """Compute the confidence of a disparity map [y, x] from `costs` and `path_costs` [l, y, x], and the variance.

        Both depend on six maps, all logarithms, with the weights in `trust.py`:

        - `conflict`: the cost of the best surface through a pixel, over that of the pixel's best disparity. It is large
          beside occlusions, and where a surface continues past an edge.
        - `evidence`: the inverse width of the disparities that are as good as the best one. Like `conflict` it is a
          mean over a square: errors at an edge lie on a band along the edge.
        - `bend`, `relief`: the distance of the map around a pixel from a plane, and from one disparity.
        - `wide`: the evidence farther around; it is small where the views show nothing.
        - `cost` farther around: it is large where the views show different things.

        `wide` is a mean over `unhidden` [y, x], the evidence of a sweep in which no surface hid anything; None takes
        that of `costs`. Later sweeps take disparities behind a surface for bad, as no view sees them, be the surface
        right or wrong.
        """
        k = self.kernels
        conflict, evidence, bend, relief, wide, cost = self._fields
        self._evaluate(costs, path_costs, evidence, bend, wide)
        around = (evidence, _AROUND, conflict), (bend, _AROUND, evidence)
        farther = evidence if unhidden is None else unhidden
        for values, reach, means in (*around, (wide, _WIDE, cost), (farther, _WIDE, wide)):
            square_mean(k, values, reach=reach, workspace=relief, means_out=means)
        k.unevenness(disparity, bend_out=bend, relief_out=relief)
        k.judge(
            self._fields,
            span=self._span,
            share=self._share,
            spread=self._spread,
            confidence_out=confidence_out,
            variance_out=self.variance,
        )
        k.clamp(self.variance, 0.0, self._most, self.variance)

    def features(self) -> dict[str, Float32Array]:
        """Copy the six maps of the last run to the host, float32 [y, x] by name; they last until another pass runs."""
        found = zip(FEATURES, self._fields, strict=True)
        return {name: self.kernels.numpy(field).astype(np.float32) for name, field in found}

    def deviation(self) -> Float32Array:
        """Copy the standard deviation of the disparity to the host, float32 [y, x]; waits for the device."""
        variance = self.kernels.numpy(self.variance)
        return np.asarray(np.sqrt(variance, out=variance), np.float32)

    def _evaluate(self, costs: Array, path_costs: Array, conflict: Array, evidence: Array, cost: Array) -> None:
        self.kernels.evidence(
            costs,
            path_costs,
            step=self._step,
            unit=self._unit,
            conflict_out=conflict,
            evidence_out=evidence,
            cost_out=cost,
            **self._labels,
        )
