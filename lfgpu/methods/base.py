"""The interface of methods.

A `Method` is a method with its parameters. It knows its stages, what it measures, its memory and its halo. A `Plan` is
a method allocated for light fields of one kind on one device; its stages compute a map and a confidence there.
Pipelines, tiles, streams, batches, the viewer and the command line use methods through these two classes only.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from lfgpu.config import Config
from lfgpu.contract import Array, Device, Float32Array, Float64Array, Scalar, Streaming
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.methods.dry_run import dry_run
from lfgpu.methods.footprint import GPU_CONTEXT, PROCESS, SPARE, Footprint
from lfgpu.methods.measured import Measured, Shown, checked_range
from lfgpu.methods.temporal_prior import TemporalPrior
from lfgpu.solvers.solution import Solution

C = TypeVar("C", bound=Config)

SAME_SURFACE = 0.4
"""Largest difference between disparities of the same surface, pixels in the farthest view."""

Callback: TypeAlias = Callable[[int, float], None]
"""Called as callback(iteration, value) after each iteration of a stage."""

Work: TypeAlias = Callable[[Callback | None], None]
"""Starts work on the device. It is called with a callback, or with None; with None it can be captured."""


@dataclass(frozen=True)
class Stage:
    """One stage of a method."""

    name: str  # its key in `Plan.stages`, `DepthResult.stages` and `DepthResult.timings`
    label: str  # its name for people, such as "further sweeps"
    value: str | None = None  # name of the value that it reports after each iteration, such as "energy"
    unit: str | None = None  # unit of that number
    has_start: bool = False  # True if there is such a number before the first iteration, too


class Plan(Protocol):
    """A method for light fields of one kind on one device. All memory is allocated when it is created."""

    disparity: Array
    confidence: Array
    """The results, fields [y, x]."""

    decided: str
    """The stage after which `check` can tell whether the run finds an estimate."""

    def follow(self, measured: Measured) -> bool:
        """Go on with what was measured on other views; tell whether that is possible. If not, the plan is used up."""

    def stages(self, views: Array) -> dict[str, Work]:
        """Return the work of each stage on `views` [n, y, x, c], as stored, by name and in order."""

    @property
    def trust(self) -> Scalar:
        """A number on the device: 0 if the last run found no estimate."""

    def check(self, name: str, trust: float) -> None:
        """Raise LightFieldError, which names `name`, if that number says that the last run found no estimate."""

    def is_finite(self) -> bool:
        """Tell whether all numbers of the last run were finite; waits for the device."""

    def maps(self, *stages: str) -> dict[str, Float32Array]:
        """Copy the map after each stage, or some, to the host, float32 [y, x] by name, NaN where it is undefined.

        That after the last stage is `disparity`.
        """

    def uncertainty(self) -> Float32Array | None:
        """Standard deviation of the disparity, float32 [y, x], None if the method has none; waits for the device."""

    def solution(self) -> Solution:
        """Report the outcome of the solvers in the last run; waits for the device."""


class LivePlan(Protocol):
    """A plan for a stream of frames; each frame may start from the previous map."""

    disparity: Array
    confidence: Array

    @property
    def noise(self) -> float:
        """Root mean square difference between views that show the same point, intensity."""

    @property
    def numbers(self) -> tuple[Scalar, Scalar]:
        """The amount of evidence, 0 if there was none; and a number that is NaN if a value was not finite."""

    @property
    def levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """(steps, work) for a frame without a previous map, from the least to the most work."""

    @property
    def warm_levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """The same for a frame that starts from the previous map."""

    @property
    def state(self) -> dict[str, Array]:
        """The arrays that a frame leaves for the next one, by name."""

    def mask(self, valid: Array | None) -> None:
        """Set the mask of the used views, a field [n, y, x], 0 at invalid pixels; None if all are valid."""


class Method(ABC, Generic[C]):
    """A method with its parameters, an instance of its configuration class."""

    STAGES: ClassVar[tuple[Stage, ...]]
    """All possible stages, in order."""

    TRACED: ClassVar[str]
    """The name of the stage whose values become the `trace` of a result."""

    is_recordable: ClassVar[bool] = False
    """True if it can be exported: a run is the same sequence of operations for all views."""

    MATCHED: ClassVar[str | None] = None
    """The name of the first stage, if surfaces beyond the disparity range lie at its ends in the map of that stage."""

    def __init__(self, config: C) -> None:
        self.config = config

    # --- description ---

    @property
    def name(self) -> str:
        """The name under which it is registered."""
        return self.config.method

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages that run with these parameters, in order."""
        return self.STAGES

    @property
    def traced(self) -> Stage:
        """The stage whose values become the `trace` of a result."""
        return next(stage for stage in self.STAGES if stage.name == self.TRACED)

    def iterations(self, stage: str) -> int | None:
        """Return the largest number of iterations of a stage; None if it is not iterative."""
        return None

    @property
    def is_on_device(self) -> bool:
        """True if all solvers run on the device, so that a whole run can be captured."""
        return True

    @property
    def for_rendering(self) -> C:
        """The parameters for maps from which new views are rendered."""
        return self.config

    @property
    def is_live(self) -> bool:
        """True if it can run on streams of frames."""
        return type(self).live_plan is not Method.live_plan

    # --- measuring a light field ---

    def measure(
        self,
        lf: LightField,
        device: Device,
        *,
        disparity_range: tuple[float, float] | None = None,
        views: Array | None = None,
        held: Sequence[int] | None = None,
    ) -> Measured:
        """Measure the disparity range, or check the given one, and measure what else the method needs.

        `views` and `held` are as for `find_disparity_range`. LightFieldError if the given range is impossible, or none
        is found.
        """
        if disparity_range is not None:
            return self.measured(lf, checked_range(disparity_range, lf.layout), device)
        bounds = find_disparity_range(lf, device, views=views, held=held)
        shown = None if views is None else (views, range(len(lf.views)) if held is None else held)
        return self.measured(lf, bounds, device, shown=shown)

    def measured(
        self, lf: LightField, bounds: tuple[float, float], device: Device, *, shown: Shown | None = None
    ) -> Measured:
        """Measure what the method needs besides a disparity range; some views may be on the device."""
        return Measured(bounds)

    def given(
        self, layout: ViewLayout, disparity_range: tuple[float, float] | None, noise: float | None = None
    ) -> Measured | None:
        """Return the result of `measure` if it needs no views; None if it needs them.

        `noise` is used in place of a measured noise, if the parameters do not give one.
        """
        return None if disparity_range is None else Measured(checked_range(disparity_range, layout))

    # --- what it uses ---

    def used_views(self, offsets: Float64Array) -> list[int]:
        """Indices of the views that it reads, in order, by their offsets [n, 2] from the reference view."""
        return list(range(len(offsets)))

    def footprint(self, layout: ViewLayout, measured: Measured, *, on_gpu: bool) -> Footprint:
        """Foresee the memory of a pipeline for light fields of one kind, whose views are on disk.

        It is the memory of a GPU if `on_gpu`, else that of the process: the views that are used, and what a dry run of
        the plan counts.
        """
        used = layout.subset(self.used_views(layout.offsets))
        views = used.count * used.channels * used.dtype.itemsize
        masks = 0 if used.masks is None else used.count
        host = 0 if on_gpu else views + masks  # the tile as it was cut out
        planned = dry_run(used, lambda small, device: self.plan(small, measured, device), on_gpu=on_gpu)
        kept, spare = host + views + masks + planned.per_pixel, planned.spare_per_pixel
        if not on_gpu:
            return Footprint(kept, PROCESS, per_column=planned.per_column)
        return Footprint(kept, GPU_CONTEXT, spare, SPARE if spare else 0, per_column=planned.per_column)

    @abstractmethod
    def halo(self, layout: ViewLayout, measured: Measured) -> tuple[int, int]:
        """Return the halo (y, x): pixels around a pixel on which its disparity depends. Tiles overlap by it."""

    @staticmethod
    def shifts(layout: ViewLayout, measured: Measured) -> tuple[int, int]:
        """Largest shift (y, x) in any view, and largest difference of shifts, which is what may hide a pixel there."""
        low, high = measured.disparity_range
        x, y = (
            math.ceil(axis * max(abs(low), abs(high))) + math.ceil(axis * (high - low))
            for axis in np.abs(layout.offsets).max(0)
        )
        return y, x

    def same_surface(self, layout: ViewLayout) -> float:
        """Largest difference between disparities of the same surface, pixels per view step."""
        return SAME_SURFACE / layout.farthest

    def doubt(self, layout: ViewLayout, bounds: tuple[float, float]) -> str | None:
        """Say what limits maps within a disparity range, in a sentence; None if nothing does."""
        return None

    # --- running ---

    @abstractmethod
    def plan(self, layout: ViewLayout, measured: Measured, device: Device) -> Plan:
        """Allocate the method for light fields of one layout; LightFieldError if it cannot work with these cameras."""

    def live_plan(
        self,
        layout: ViewLayout,
        measured: Measured,
        device: Device,
        *,
        streaming: Streaming,
        prior: TemporalPrior,
    ) -> LivePlan:
        """Allocate the method for a stream of frames of the used views; LightFieldError if it cannot run on streams."""
        raise LightFieldError(
            f"a stream needs a method that can start from the previous map, but the method {self.name} cannot do that; "
            "use another preset (`lfgpu live --help` lists them)."
        )
