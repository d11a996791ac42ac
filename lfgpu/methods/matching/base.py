"""The interfaces of what the table of sweeps names, costs and aggregations, and a mean that passes share.

`views.ViewRule` is the interface of view rules.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

from lfgpu.contract import Array, KernelSet


class Cost(Protocol):
    """A cost of the views of a sweep. `Frame.on_load` gives it the views of each frame."""

    def by_view_sets(self, volume_out: Array) -> None:
        """Costs [l, y, x] over all views and over partial sets of them, whichever agree best."""

    def by_visibility(self, nearest: Array, volume_out: Array) -> None:
        """Costs [l, y, x] over the views that see a pixel past the nearest surface in them, `nearest` [n, y, x].

        n counts all compared views; of those that the sweep leaves out, `nearest` holds anything.
        """


@dataclass(frozen=True, eq=False)
class Swept:
    """Surfaces and costs that a sweep hands to its aggregation."""

    nearest: (
        Array | None
    )  # nearest surface in each compared view, [n, y, x], by the map so far; None in the first sweep
    volume: Array | None  # costs [l, y, x], which may be overwritten; None if `Aggregation.has_own_costs`
    expect: Callable[[Array], None] | None = None
    """Changes costs [l, y, x] for what is known beforehand, such as the last map of a stream."""


class Aggregation(ABC):
    """A way to find the best surface through costs, planned for the views of a sweep.

    One is made for each row of the table of sweeps. `SweptViews.frame` has the arena, size, disparities, parameters,
    reference image and weights of like pixels. An aggregation with costs of its own, at disparities of its own or for
    sets of views, takes the views from `Frame.used`, or has them from `Frame.on_load`.
    """

    has_own_costs: ClassVar[bool] = False
    """True if the aggregation computes costs itself: `Swept.volume` is None."""

    evidence: tuple[Array, Array] | None = None
    """Costs and path costs, fields [l, y, x] after each call, by which the map is judged; None if it judges itself."""

    confidence: Array | None = None
    """The confidence [y, x], 0 to 1, of the last map; None if it is judged by `evidence`."""

    variance: Array | None = None  # the variance of the disparity [y, x], (pixels per view step)², with `confidence`

    @abstractmethod
    def __call__(self, swept: Swept, disparity_out: Array) -> None:
        """Find the disparity [y, x] of each pixel, pixels per view step."""


def square_mean(kernels: KernelSet, values: Array, *, reach: int, workspace: Array, means_out: Array) -> None:
    """Average each pixel of a map [y, x] and the pixels at most `reach` rows and columns from it.

    Only pixels in the image count. `values`, `workspace` [y, x] and `means_out` are different fields.
    """
    kernels.line_mean(values, axis=0, reach=reach, means_out=workspace)
    kernels.line_mean(workspace, axis=1, reach=reach, means_out=means_out)
