"""Matching: the disparity of each pixel of the reference view at which the views that see it look most alike.

`sweep` and `resweep` compare views at a row of disparities and find the best surface through the costs: `passes.py` has
the table of sweeps. `align` makes the disparity continuous. `boundaries` gives each pixel at a depth edge to the side
whose colour it has, and fills surfaces without texture from those around them.
"""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Array, Device, Float32Array
from lfgpu.data.layout import ViewLayout
from lfgpu.errors import LightFieldError
from lfgpu.methods.arena import Arena
from lfgpu.methods.base import Callback, Work
from lfgpu.methods.matching.alignment import Alignment
from lfgpu.methods.matching.choice import SecondMap
from lfgpu.methods.matching.completion import Completion
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.disparities import compared_reach
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.judging import kind_of
from lfgpu.methods.matching.noise import in_units_of, noise_of_views, smoothing_deviation
from lfgpu.methods.matching.passes import Sweeps, follow, sweeps_of
from lfgpu.methods.matching.views import chosen_views
from lfgpu.methods.measured import Measured
from lfgpu.solvers.solution import Solution


class MatchingPlan:
    """Matching for light fields of one kind, with all memory allocated."""

    decided = "align"
    is_live = False
    """True if views may come with masks that the layout does not have, and maps are compared with those before."""

    def __init__(self, layout: ViewLayout, measured: Measured, config: MatchingConfig, device: Device) -> None:
        kind, bounds, self._exposure = kind_of(config.sweep.resweeps), measured.disparity_range, measured.exposure
        chosen = chosen_views(layout, bounds, config.sweep)
        self._given = chosen.adapt(config)
        self._config = config = self._in_units(measured)
        # What unknown pixels hold does not follow, and streams keep what they measured first.
        follows = layout.masks is None and not self.is_live and follow(sweeps_of(config))
        self._arena = arena = Arena(device, follows=follows)
        self._kernels, deviation = device.kernels, smoothing_deviation(measured.grain, config.sweep)
        self._frame = frame = Frame(arena, chosen, bounds, config, deviation=deviation, masked=self.is_live)
        frame.goes_with(self)
        self._alignment = Alignment(frame)  # first, as its views are the largest of what shares memory
        self._sweeps = Sweeps(frame, kind=kind, is_live=self.is_live)
        self.trust = device.scalar(0.0)
        """A number on the device: 0 if the last run found no estimate."""
        are_two = self._sweeps.second is not None
        # A CPU computes the weights of like pixels again for the second map: they are quickly found, and large.
        self._completion = Completion(frame, keeps_prior=self.is_live or (are_two and device.is_gpu))
        self.second = SecondMap(frame, self._sweeps) if are_two else None
        """The second map, if the table of sweeps has one."""
        self._put_unknown = frame.known.putting_nan()
        names = ("swept", "aligned", "disparity", "confidence")
        self._swept, self._aligned, self.disparity, self.confidence = (arena.field(name, frame.size) for name in names)
        """`disparity` and `confidence` are the results, fields [y, x]."""
        self._matched = arena.field("matched", frame.size) if self._sweeps.are_several else self._swept
        self._steps = config.alignment.iterations
        arena.follow()

    def _in_units(self, measured: Measured) -> MatchingConfig:
        """Return the parameters in units of a measured noise."""
        assert measured.noise is not None  # this method measures it
        # Root mean square difference between views that agree, intensity.
        self.noise = noise_of_views(measured.noise, measured.grain, self._given.sweep)
        return in_units_of(measured.noise, self._given, grain=measured.grain, exposure=measured.exposure)

    def follow(self, measured: Measured) -> bool:
        """Go on with what was measured on other views; tell whether that is possible. If not, the plan is used up."""
        if self._arena.changing is None or measured.exposure != self._exposure:
            return False
        if compared_reach(self._frame.layout.offsets, measured.disparity_range, self._given.sweep) != self._frame.reach:
            return False
        config, deviation = self._in_units(measured), smoothing_deviation(measured.grain, self._given.sweep)
        return self._frame.follow(measured.disparity_range, config, deviation=deviation)

    def stages(self, views: Array) -> dict[str, Work]:
        """Return the work of each stage on `views` [n, y, x, c], as stored, by name and in order."""
        again: dict[str, Work] = {"resweep": self._sweep_again} if self._sweeps.are_several else {}
        return {"sweep": lambda _: self._sweep(views), **again, "align": self._align, "boundaries": self._finish}

    def check(self, name: str, trust: float) -> None:
        """Raise LightFieldError, which names `name`, if that number says that the last run found no estimate."""
        if not trust > 0:
            raise LightFieldError(
                f"{name}: no pixel shows anything that other views show as well: the views have no texture, are "
                "masked, or the disparity range is wrong; give another one."
            )

    def is_finite(self) -> bool:
        """Tell whether all numbers of the last run were finite; waits for the device."""
        return bool(np.isfinite(self._kernels.number(self._alignment.moves[0])))

    def maps(self, *stages: str) -> dict[str, Float32Array]:
        """Copy the map after each stage, or some, to the host, float32 [y, x] by name, NaN where it is undefined."""
        again = {"resweep": self._matched} if self._sweeps.are_several else {}
        kept = {"sweep": self._swept, **again, "align": self._aligned, "boundaries": self.disparity}
        found = {name: self._kernels.numpy(kept[name]).astype(np.float32, copy=False) for name in stages or kept}
        return {name: self._frame.known.on_host(map_) for name, map_ in found.items()}

    def solution(self) -> Solution:
        """Report the outcome of the alignment; waits for the device."""
        return self._alignment.solution(self.noise)

    def features(self) -> dict[str, Float32Array]:
        """Copy the maps on which the confidence of the last run depends to the host, float32 [y, x] by name."""
        return self._sweeps.judging.features()

    def uncertainty(self) -> Float32Array:
        """Copy the standard deviation of the disparity to the host, float32 [y, x], NaN where it is undefined."""
        return self._frame.known.on_host(self._sweeps.judging.deviation())

    def _sweep(self, views: Array) -> None:
        self._frame.load(views)
        self._sweeps.first(self._swept)

    def _sweep_again(self, _: Callback | None) -> None:
        self._sweeps.further(self._swept, self._matched)

    def _align(self, callback: Callback | None) -> None:
        variance = self._sweeps.last.aggregation.variance
        self._alignment.run(self._matched, variance, self._aligned, self._steps, callback, trust_out=self.trust)

    def _finish(self, _: Callback | None) -> None:
        self._complete()
        self._put_unknown(self.disparity)  # until here they hold a number, for their neighbours' sums

    def _complete(self) -> None:
        self._completion.run(self._aligned, self._alignment.curvature, self.disparity)
        if self.second is not None:
            self.second.take(self._alignment, self._completion, self._unhidden, self.disparity, self.confidence)
        self._judge()

    @property
    def _unhidden(self) -> Array | None:
        """The evidence of a sweep of this frame in which nothing was hidden; see `Judging.run`."""
        return self._sweeps.unhidden

    def _judge(self) -> None:
        """Find confidence and variance, which the choice of a second map gives if there is one."""
        if self.second is None:
            self._sweeps.judge(self._sweeps.last, self.disparity, self._unhidden, self.confidence)
        self._frame.known.take_out(self.confidence)
