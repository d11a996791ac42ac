"""What a method is to those who run it.

A `Method` is a method with its parameters: it knows its stages, what it measures, how much memory it takes and how far
a pixel reaches. Its `Plan` is the same for light fields of one kind on one device: everything is allocated, and stages
leave a map and a confidence on the device. Pipelines, tiles, streams, batches, the viewer and the command line know
methods by these two classes only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from lfgpu.config import Config
from lfgpu.contract import Array, Float32Array, KernelSet, Scalar, Streaming
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.methods.footprint import Footprint
from lfgpu.methods.measured import Measured, checked_range
from lfgpu.methods.temporal_prior import TemporalPrior
from lfgpu.solvers.solution import Solution

C = TypeVar("C", bound=Config)

SAME_SURFACE = 0.4
"""Pixels in the farthest view: maps that differ by more show different surfaces."""

Callback: TypeAlias = Callable[[int, float], None]
"""Called as callback(iteration, value) after each iteration of a stage."""

Work: TypeAlias = Callable[[Callback | None], None]
"""Work to ask the device for; with None instead of a callback it can be captured."""


@dataclass(frozen=True)
class Stage:
    """One stage of a method.

    Parameters
    ----------
    name
        Its key in `Plan.stages`, `DepthResult.stages` and `DepthResult.timings`.
    label
        What people read, such as "plane sweep".
    value
        What the number is that the stage reports after each iteration, such as "energy"; None if it has no iterations.
    unit
        The unit of that number; None if it has none.
    has_start
        Whether there is such a number before the first iteration, too.
    """

    name: str
    label: str
    value: str | None = None
    unit: str | None = None
    has_start: bool = False


class Plan(Protocol):
    """A method for light fields of one kind on one device; everything is allocated when it is made."""

    disparity: Array
    confidence: Array
    """The results, fields [y, x]."""

    decided: str
    """The stage after which `check` knows whether anything will come of the run."""

    def stages(self, views: Array) -> dict[str, Work]:
        """What there is to do for `views` [n, y, x, c], as stored, by name and in order."""

    def check(self, name: str) -> None:
        """LightFieldError, with the light field's name, if nothing came of the last run; waits for the device."""

    def is_finite(self) -> bool:
        """Whether the last run met finite numbers only; waits for the device."""

    def maps(self) -> dict[str, Float32Array]:
        """The map after each stage, float32 [y, x], NaN where it is undefined; waits for the device."""

    def solution(self) -> Solution:
        """How the iterations of the last run went; waits for the device."""


class LivePlan(Protocol):
    """A plan for a stream of frames: each frame may start from the map before."""

    disparity: Array
    confidence: Array

    @property
    def noise(self) -> float:
        """Difference between views that agree, intensity."""

    @property
    def numbers(self) -> tuple[Scalar, Scalar]:
        """How much evidence there was, 0 if none; and a number that is NaN if something was not finite."""

    @property
    def levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """(steps, work) for a frame on its own, from the least to the most work."""

    @property
    def warm_levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """The same for a frame that starts from the map before."""

    def mask(self, valid: Array | None) -> None:
        """Which pixels of the used views count from now on, a field [n, y, x]; None if all do."""


class Method(ABC, Generic[C]):
    """A method with its parameters.

    Parameters
    ----------
    config
        All parameters, an instance of the method's configuration class.
    """

    STAGES: ClassVar[tuple[Stage, ...]]
    """All stages that there may be, in order."""

    TRACED: ClassVar[str]
    """Name of the stage whose values are the `trace` of a result."""

    def __init__(self, config: C) -> None:
        self.config = config

    # --- what it is ---

    @property
    def name(self) -> str:
        """The name under which it is registered."""
        return self.config.method

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages that these parameters ask for, in order."""
        return self.STAGES

    @property
    def traced(self) -> Stage:
        """The stage whose values are the `trace` of a result."""
        return next(stage for stage in self.STAGES if stage.name == self.TRACED)

    def iterations(self, stage: str) -> int | None:
        """The most iterations that a stage makes; None if it has none."""
        return None

    @property
    def is_on_device(self) -> bool:
        """Whether all solvers run on the device, so that a whole run can be captured."""
        return True

    @property
    def is_recordable(self) -> bool:
        """Whether a run is the same sequence of operations for all views, so that it can be written as a file."""
        return False

    @property
    def for_rendering(self) -> C:
        """The parameters for maps that new views are rendered from."""
        return self.config

    @property
    def is_live(self) -> bool:
        """Whether it can run on streams of frames."""
        return type(self).live_plan is not Method.live_plan

    # --- what it needs to know about a light field ---

    def measure(
        self,
        lf: LightField,
        kernels: KernelSet,
        device: str,
        *,
        disparity_range: tuple[float, float] | None = None,
    ) -> Measured:
        """The disparity range, checked if it is given and found if not, and what else the method measures.

        Raises
        ------
        LightFieldError
            If the range cannot be one of this light field, or none is found.
        """
        bounds = checked_range(disparity_range, lf) if disparity_range is not None else find_disparity_range(lf)
        return Measured(bounds, self.measure_noise(lf, bounds, kernels, device))

    def measure_noise(
        self, lf: LightField, bounds: tuple[float, float], kernels: KernelSet, device: str
    ) -> float | None:
        """Difference between views that agree, intensity; None if the method does not use it."""
        return None

    def given(
        self, lf: LightField, disparity_range: tuple[float, float] | None, noise: float | None = None
    ) -> Measured | None:
        """What `measure` would return without looking at any view; None if it would have to look.

        `noise` stands in for a measured one, where the parameters do not give it.
        """
        return None if disparity_range is None else Measured(checked_range(disparity_range, lf))

    # --- what it takes ---

    def used_views(self, lf: LightField) -> list[int]:
        """Indices of the views that it looks at, in order."""
        return list(range(len(lf.views)))

    @abstractmethod
    def footprint(self, lf: LightField, measured: Measured, *, on_gpu: bool) -> Footprint:
        """The memory of a pipeline for light fields of one kind, whose views are on disk.

        Of `lf` its cameras, channels, stored type and whether it has masks count. With `on_gpu` it is the memory of a
        GPU, else that of the process.
        """

    @abstractmethod
    def halo(self, lf: LightField, measured: Measured) -> tuple[int, int]:
        """Pixels (y, x) around a pixel that its disparity depends on: how far tiles must overlap."""

    def same_surface(self, lf: LightField) -> float:
        """Disparities that differ by up to this are of one surface, pixels per view step."""
        return SAME_SURFACE / float(np.abs(lf.offsets).max())

    # --- running it ---

    @abstractmethod
    def plan(self, lf: LightField, measured: Measured, kernels: KernelSet, device: str) -> Plan:
        """The method for light fields of the kind of `lf`, whose views do not count.

        Raises
        ------
        LightFieldError
            If the cameras do not suit the method.
        """

    def live_plan(
        self,
        lf: LightField,
        measured: Measured,
        kernels: KernelSet,
        device: str,
        *,
        streaming: Streaming,
        prior: TemporalPrior,
    ) -> LivePlan:
        """The method for a stream of frames of the kind of `lf`, which holds the used views only.

        Raises
        ------
        LightFieldError
            If the method cannot run on streams.
        """
        raise LightFieldError(
            f"a stream needs a method that can start from the map before, and {self.name} cannot; take the preset "
            "accurate or fast."
        )
