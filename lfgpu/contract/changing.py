"""Numbers that follow what was measured, while planned and captured work stays: scalars on the device."""

from collections.abc import Sequence
from typing import Protocol

from lfgpu.contract.arrays import Scalar
from lfgpu.contract.matching import Disparities, PlaneSweep


class Numbers(Protocol):
    """Scalars of a plan, which are changed together."""

    scalars: Sequence[Scalar]

    def change(self, values: Sequence[float]) -> None:
        """Set the first scalars; work that was asked for before is done when this is called."""


class Changing(Protocol):
    """Operations of a backend whose numbers may be scalars, so that captured work goes on with other numbers.

    These take a `Scalar` in place of a number: `small` and `large` of `semi_global`, `first` of `winner_takes_all`,
    `unit` of `evidence`, `span` of `judge` and `compare_maps`, `contrast` of `edge_weights`, `alignment` and
    `refine_boundaries`, `robust` of `alignment`, `deviation` of `smooth_views`, `sigma_color` of `nlm_weights`, `floor`
    of `nlm_ratio`, the bounds of `clamp`, and `SweepCost.softness`, which then is > 0. `winner_takes_all` and
    `evidence` also take `labels`, the number of the first slices that count.
    """

    def numbers(self, count: int, device: str) -> Numbers:
        """Return so many scalars."""

    def move(self, sweep: PlaneSweep, disparities: Disparities) -> None:
        """Have a sweep go on with other disparities, of the same `slices`."""
