"""Engine of a stream: its views, plan and masks on the device, and the levels of work that it may do for a frame.

Levels go from one step of the alignment to all steps of the config. With a budget the engine takes the largest level
that fits, by the time that the device took for it before.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Array, Device, Float64Array
from lfgpu.contract.streaming import Streaming
from lfgpu.data import LightField
from lfgpu.methods.base import Method
from lfgpu.methods.measured import Measured
from lfgpu.methods.temporal_prior import TemporalPrior
from lfgpu.pipelines.rectifier import DeviceViews, Rectifier

SEEN_CHANGE = 4.0
"""In units of the noise: a larger change of a sample counts as a change of the scene."""

_SMOOTHING = 0.1  # weight of the latest frame in the mean time of a level


@dataclass
class Level:
    """Prepared level of work for a frame: steps of the alignment, the work itself, and seconds of the device."""

    steps: int
    work: Callable[[], None]
    seconds: float = 0.0

    def took(self, seconds: float) -> None:
        """Record the seconds that a frame took."""
        self.seconds += _SMOOTHING * (seconds - self.seconds)


class Engine:
    """Device side of a stream, which solves one frame after the other, in at most `budget_ms` of device time.

    `lf` is the first frame as a light field, `pictures` as it came: raw pictures if there is a rectifier.
    """

    def __init__(
        self,
        lf: LightField,
        pictures: LightField,
        rectifier: Rectifier | None,
        device: Device,
        streaming: Streaming,
        *,
        method: Method[Any],
        measured: Measured,
        prior: TemporalPrior | None,
        budget_ms: float | None,
        results: int,
    ) -> None:
        self.used, self.device = list(method.used_views(lf.offsets)), device.name
        self.like = lf if len(self.used) == len(lf.views) else lf.subset(self.used)
        """The first frame, with the views that are used."""
        self.has_prior, self._device, self._budget = prior is not None, device, budget_ms
        self._front = DeviceViews(rectifier, pictures, device, used=self.used)
        self._plan = method.live_plan(
            self.like.layout, measured, device, streaming=streaming, prior=prior or TemporalPrior()
        )
        self.transport = streaming.transport(
            self._front.frame,
            (self._plan.disparity, self._plan.confidence, *self._plan.numbers),
            reference=self.like.reference_index,
            scale=self.like.scale,
            tolerance=SEEN_CHANGE * self._plan.noise,
            results=results,
        )
        self._base = None if self.like.valid is None else device.field(self.like.valid)
        self._mask = device.field(np.ones(self.like.views.shape[:3]))
        self._present = np.ones(len(self.like.views), bool)
        self._set_mask()
        self._cold: list[Level] = []
        self._warm: list[Level] = []

    def prepare(self) -> None:
        """Capture the levels of work and, with a budget, time them; without one only the largest is prepared."""
        some = slice(-1 if self._budget is None else None, None)
        self._cold = [self._prepared(*level) for level in self._plan.levels[some]]
        self._warm = [self._prepared(*level) for level in self._plan.warm_levels[some]] if self.has_prior else []

    def level(self, *, cold: bool) -> Level:
        """Choose the largest level that fits into the budget, or the least of all."""
        levels = self._cold if cold else self._warm
        found = [level for level in levels if self._budget is None or level.seconds * 1000 <= self._budget]
        return found[-1] if found else levels[0]

    def is_over_budget(self, seconds: float) -> bool:
        """Tell whether a frame took more than the budget."""
        return self._budget is not None and seconds * 1000 > self._budget

    def solve(self, level: Level, present: NDArray[np.bool_]) -> Any:
        """Start the work on the frame that was brought, with the cameras that have a picture, bool [n]."""
        masking = None
        if not np.array_equal(present, self._present):
            self._present, masking = present, self._set_mask
        return self.transport.solve(level.work, masking)

    def forget_mask(self) -> None:
        """Set the mask anew with the next frame, after the device failed."""
        self._present = np.zeros_like(self._present)

    def shown(self, present: NDArray[np.bool_]) -> LightField:
        """Copy the views that the device works on; views without a picture are masked."""
        views, valid = self._device.kernels.numpy(self._front.views), self.like.valid
        if not present.all():
            there = np.ones(self.like.views.shape[:3], np.bool_) if valid is None else valid
            valid = there & present[:, None, None]
        return replace(self.like, views=views, valid=valid, truth=None, files=())

    def set_tones(self, tones: Float64Array) -> None:
        """Equalise the next frames with other tones [n, 3, c] of all cameras."""
        self._front.set_tones(tones)

    # --- steps ---

    def _prepared(self, steps: int, work: Callable[[Array], None]) -> Level:
        """Capture a level of work and, with a budget, time it."""
        level = Level(steps, partial(self._front.feed, work))
        with self._device.asking():
            level.work()
        level.work = self.transport.captured(level.work)
        if self._budget is not None:
            self.transport.synchronize()
            start = perf_counter()
            level.work()
            self.transport.synchronize()
            level.seconds = perf_counter() - start
        return level

    def _set_mask(self) -> None:
        if not self._device.is_gpu and self._base is None and self._present.all():
            self._plan.mask(None)  # no mask is faster; a graph captured on a GPU reads it anyway
            return
        self.transport.mask(self._base, self._mask)
        self._plan.mask(self._mask)


def fault(trust: float, moved: float) -> str | None:
    """Say why a map means nothing, by the sum of its confidence and its largest move; None if it means something."""
    if not np.isfinite(moved):
        return "views hold NaN or infinity; mask or replace these values."
    if not trust > 0:
        return "no pixel matches in other views: the views have no texture, or all pixels are masked."
    return None
