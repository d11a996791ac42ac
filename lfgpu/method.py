"""What a method is to those who run it: stages that leave a map and a confidence on the device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

from lfgpu.solvers.solution import Solution
from lfgpu.types import Array, Float32Array

Callback: TypeAlias = Callable[[int, float], None]
"""Called as callback(iteration, value) after each iteration of a stage."""

Stage: TypeAlias = Callable[[Callback | None], None]
"""Work to ask the device for; with None instead of a callback it can be captured."""


class Method(Protocol):
    """One method for light fields of one kind; everything is allocated when it is made."""

    disparity: Array
    confidence: Array
    """The results, fields [y, x]."""

    decided: str
    """The stage after which `check` knows whether anything will come of the run."""

    def stages(self, views: Array) -> dict[str, Stage]:
        """What there is to do for `views` [n, y, x, c], as stored, by name and in order."""

    def check(self, name: str) -> None:
        """LightFieldError, with the light field's name, if nothing came of the last run; waits for the device."""

    def is_finite(self) -> bool:
        """Whether the last run met finite numbers only; waits for the device."""

    def maps(self) -> dict[str, Float32Array]:
        """The map after each stage, float32 [y, x], NaN where it is undefined; waits for the device."""

    def solution(self) -> Solution:
        """How the iterations of the last run went; waits for the device."""
