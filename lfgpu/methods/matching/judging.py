"""Confidence and variance of a map, from what its costs and its shape say about each pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lfgpu.contract import Array, Float32Array, KernelSet
from lfgpu.methods.matching import trust
from lfgpu.methods.matching.square_mean import square_mean

_AROUND = 4  # pixels on each side of one, whose costs are judged with its own
_WIDE = 16  # pixels on each side of those, in which there may be something to go by


class Judging:
    """How sure a map is.

    Parameters
    ----------
    kernels
        Where it is computed.
    kind
        Which weights there are for it: `SweepConfig.kind`.
    bounds
        The range of disparities, pixels per view step.
    step
        The distance of the disparities that are compared, pixels per view step.
    unit
        What a difference between views as large as the noise costs.
    workspace
        Six fields [y, x]; until `run` they may be used otherwise.
    variance
        A field [y, x] for the variance of the disparity, (pixels per view step)².
    """

    def __init__(
        self,
        kernels: KernelSet,
        *,
        kind: str,
        bounds: tuple[float, float],
        step: float,
        unit: float,
        workspace: Sequence[Array],
        variance: Array,
    ) -> None:
        self._kernels, self._share, self._spread = kernels, trust.SHARE[kind], trust.SPREAD[kind]
        self._span, self._step, self._unit = bounds[1] - bounds[0], step, unit
        self._fields, self._variance = tuple(workspace), variance

    def evidence(self, costs: Array, path_costs: Array, evidence_out: Array) -> None:
        """What the costs [l, y, x] of a sweep alone say about how far away things are, a field [y, x]."""
        conflict, cost, *_ = self._fields
        self._said(costs, path_costs, conflict, evidence_out, cost)

    def run(
        self, costs: Array, path_costs: Array, disparity: Array, unhidden: Array | None, confidence_out: Array
    ) -> None:
        """The confidence of a disparity map, and its variance, from six maps, all logarithms.

        `conflict` says how much more the best surface through a pixel costs than the pixel's best disparity: beside
        occlusions, and where a surface goes on past an edge, a pixel and what lies around it disagree. `evidence` says
        how few disparities are as good as the best one. Both are means over a square, as what is wrong at an edge is
        wrong on a band along it. `bend` and `relief` say how far the map around a pixel is from a plane, and from one
        disparity. `wide`, the evidence farther around, says whether there is anything to go by, and `cost` there
        whether the views show the same things at all. `wide` is that of a sweep in which nothing hid anything
        (`unhidden`), if there was one: a later one takes disparities behind the surface for bad, as no view sees them,
        whether there was any reason for that surface. `trust.py` has the weights that were fitted.
        """
        k = self._kernels
        conflict, evidence, bend, relief, wide, cost = self._fields
        self._said(costs, path_costs, evidence, bend, wide)
        around = (evidence, _AROUND, conflict), (bend, _AROUND, evidence)
        farther = evidence if unhidden is None else unhidden
        for values, reach, means in (*around, (wide, _WIDE, cost), (farther, _WIDE, wide)):
            square_mean(k, values, reach=reach, workspace=relief, means_out=means)
        k.unevenness(disparity, bend_out=bend, relief_out=relief)
        k.judge(
            *self._fields,
            span=self._span,
            share=self._share,
            spread=self._spread,
            confidence_out=confidence_out,
            variance_out=self._variance,
        )
        # Between the bounds nothing is more uncertain than anything.
        k.clamp(self._variance, 0.0, self._span**2 / 12, self._variance)

    def features(self) -> dict[str, Float32Array]:
        """What the confidence of the last run was made of, float32 [y, x] by name; waits for the device."""
        names = ("conflict", "evidence", "bend", "relief", "wide", "cost")
        return {
            name: self._kernels.numpy(field).astype(np.float32) for name, field in zip(names, self._fields, strict=True)
        }

    def deviation(self) -> Float32Array:
        """The standard deviation of the disparity, float32 [y, x]; waits for the device."""
        return np.asarray(np.sqrt(self._kernels.numpy(self._variance)), np.float32)

    def _said(self, costs: Array, path_costs: Array, conflict: Array, evidence: Array, cost: Array) -> None:
        self._kernels.evidence(
            costs,
            path_costs,
            step=self._step,
            unit=self._unit,
            conflict_out=conflict,
            evidence_out=evidence,
            cost_out=cost,
        )
