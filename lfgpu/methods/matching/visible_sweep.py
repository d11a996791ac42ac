"""A plane sweep in which each view takes part where it sees a pixel past a surface."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from lfgpu.contract import Array, KernelSet, PlaneSweep, SweepCost
from lfgpu.methods.matching.some_views import SomeViews


class VisibleSweep:
    """A sweep past surfaces, with all memory allocated.

    Parameters
    ----------
    sweep
        The sweep, planned for views of `shape` [n, y, x, c] with `offsets`.
    shape, offsets
        Of these views; the offsets a field [n, 2].
    nearest
        Workspace [n, y, x].
    reaches
        By how many pixels surfaces may be widened before they hide what is behind them.
    kernels
        Where it is computed.
    some
        Which of the views that come are compared. Default None: all.
    """

    def __init__(
        self,
        sweep: PlaneSweep,
        shape: Sequence[int],
        offsets: Array,
        nearest: Array,
        kernels: KernelSet,
        *,
        reaches: Collection[int],
        some: SomeViews | None = None,
    ) -> None:
        self._sweep, self._nearest, self._some = sweep, nearest, some
        self._hiding = {reach: kernels.z_buffer(shape, offsets, reach=reach) for reach in reaches}

    def load(self, image: Array, views: Array, valid: Array | None) -> None:
        """Take a reference image [y, x, c], views [n, y, x, c], and their masks [n, y, x] or None."""
        if self._some is not None:
            views, valid = self._some.of(views, valid)
        self._sweep.load(image, views, valid)

    def __call__(self, surface: Array, volume_out: Array, *, reach: int, cost: SweepCost) -> None:
        """Costs [l, y, x] past a map [y, x] that is widened by `reach`; see `PlaneSweep.by_visibility`."""
        self._hiding[reach](surface, self._nearest)
        self._sweep.by_visibility(self._nearest, cost, volume_out)
