"""The sweeps of matching as a table: views x cost x visibility x widening x aggregation.

The first sweep compares a row and a column of views; partial view sets see past occluders. Further sweeps leave out the
views from which the surface found so far hides a pixel. Beside an outline, costs are those of the nearer surface: its
gradients and its smoothed values reach beyond it. So the first surfaces are too large, and hide the place beside them
from itself. Later surfaces are nearly right, and what they hide is widened by a pixel. Gradients count for less in the
last sweep, and for nothing in the sweeps between the first and the last.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from lfgpu.contract import Array
from lfgpu.methods.matching import aggregation, costs
from lfgpu.methods.matching.aggregation import AGGREGATIONS
from lfgpu.methods.matching.base import Cost, Swept
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.costs import COSTS
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.guesses import GuessedSurfaces
from lfgpu.methods.matching.judging import Judging


@dataclass(frozen=True)
class Sweep:
    """A row of a table of sweeps."""

    views: str  # a row of `views.VIEWS`: the views that are compared
    cost: str  # a row of `costs.COSTS`
    past: str  # what sees past occluders: "view sets", or "surface", the views that see a pixel past the map
    widening: int  # pixels by which surfaces are widened before they hide anything
    aggregation: str  # a row of `aggregation.AGGREGATIONS`


ACCURATE = (
    #     views          cost                        past         widening  aggregation
    Sweep("cross", "gradients, reduced views", "view sets", 0, "semi-global, cut at edges"),
    Sweep("every other", "intensities", "surface", 0, "semi-global"),
    Sweep("every other", "intensities", "surface", 1, "semi-global"),
    Sweep("all", "few gradients", "surface", 1, "semi-global"),
)
FAST = (
    Sweep("cross", "gradients, reduced views", "view sets", 0, "semi-global, cut at edges"),
    Sweep("all", "few gradients", "surface", 0, "semi-global"),
)

LEARNED = (Sweep("all", "", "view sets", 0, "learned"),)
"""A network, which has costs of its own; after other sweeps it finds a second map, see `choice.py`."""


def matching_sweeps(resweeps: int) -> tuple[Sweep, ...]:
    """Return the table for a number of sweeps after the first: `ACCURATE` with its third row left out or repeated."""
    first, second, third, last = ACCURATE
    if resweeps < len(FAST):
        return FAST[: 1 + resweeps]
    return (first, second, *(third,) * (resweeps - 2), last)


TABLES: Mapping[str, Callable[[int], tuple[Sweep, ...]]] = {
    "matching": matching_sweeps,
    "learned": lambda resweeps: LEARNED,
    "both": lambda resweeps: (*matching_sweeps(resweeps), *LEARNED),
}
"""Tables of sweeps by name (`MatchingTuning.passes`), each for a number of sweeps after the first."""


def sweeps_of(config: MatchingConfig) -> tuple[Sweep, ...]:
    """Return the table that parameters name."""
    first, *further = TABLES[config.tuning.passes](config.sweep.resweeps)
    return (replace(first, views=config.tuning.sweep.first_views), *further)


def follow(table: tuple[Sweep, ...]) -> bool:
    """Tell whether all numbers of a table that depend on noise and range are the arena's (`Arena.number`)."""
    return all(row.cost in ("", *costs.FOLLOWING) and row.aggregation in aggregation.FOLLOWING for row in table)


class PlannedSweep:
    """A row of the table for light fields of one kind, allocated."""

    def __init__(self, row: Sweep, frame: Frame) -> None:
        self.row, self._views = row, frame.swept(row.views)
        self._hiding, arena = frame.hiding, frame.arena
        with arena.scratch() as scratch:
            self._nearest = scratch.field(frame.layout.shape[:3]) if row.past == "surface" else None
            self.aggregation = AGGREGATIONS[row.aggregation](self._views)
        self._cost: Cost | None = None
        self._volume: Array | None = None
        if not self.aggregation.has_own_costs:
            self._cost = self._views.cost(row.cost, COSTS[row.cost])
            self._volume = arena.field("costs", (frame.disparities.slices, *frame.size))

    def __call__(
        self, surface: Array | None, disparity_out: Array, expect: Callable[[Array], None] | None = None
    ) -> None:
        """Find a map [y, x]; `surface` [y, x] is what hides anything in the views, `expect` as in `Swept`."""
        if self._nearest is not None:
            self._hiding(surface, self._views.offsets, self._nearest, reach=self.row.widening)
        if self._cost is not None and self._nearest is not None:
            self._cost.by_visibility(self._nearest, self._volume)
        elif self._cost is not None:
            self._cost.by_view_sets(self._volume)
        self.aggregation(Swept(self._nearest, self._volume, expect), disparity_out)


class Sweeps:
    """All sweeps of a table for light fields of one kind; `kind` is a key of the weights in `trust.py`."""

    def __init__(self, frame: Frame, *, kind: str, is_live: bool) -> None:
        arena, size = frame.arena, frame.size
        config, tuning, bounds = frame.config, frame.config.tuning.sweep, frame.bounds
        self._frame, self._put_far = frame, frame.known.putting_far(bounds[0])  # an unknown pixel hides nothing
        first, *further = sweeps_of(config)
        second = further.pop() if further and further[-1] in LEARNED else None
        self._guesses = None
        with frame.planning() as scratch:
            self._hides, self._evidence = scratch.fields(2, size)
            self.judging = Judging(frame, kind=kind)
            if further and tuning.ambiguity < 1:
                self._guesses = GuessedSurfaces(
                    arena,
                    size,
                    share=tuning.ambiguity,
                    disparities=lambda: frame.disparities,
                    tolerance=tuning.tolerance / frame.reach,
                    ones=frame.prior.ones,
                )
            self._first, self._further = PlannedSweep(first, frame), [PlannedSweep(row, frame) for row in further]
            self.second = None if second is None else PlannedSweep(second, frame)
            """The sweep that finds a second map, None if there is none."""
            self.past = self._planned_past(first) if is_live else self.last
            """The last sweep; in streams planned to look past a surface even if no sweep follows the first one."""
        self.unhidden = arena.field("evidence of the first sweep", size) if further else None
        """The evidence [y, x] of the sweep in which no surface hid anything; None if no sweep follows it."""

    @property
    def are_several(self) -> bool:
        """True if sweeps follow the first one."""
        return bool(self._further)

    @property
    def last(self) -> PlannedSweep:
        """The last sweep."""
        return self._further[-1] if self._further else self._first

    def first(self, map_out: Array) -> None:
        """Find a first map [y, x]."""
        self.find(self._first, None, map_out)
        if self.unhidden is not None and self._first.aggregation.evidence is not None:
            self.judging.evidence(*self._first.aggregation.evidence, self.unhidden)

    def further(self, found: Array, map_out: Array) -> None:
        """Find a better map [y, x], past the surfaces of the first one."""
        before, evidence = self._first, self.unhidden
        for sweep in self._further:
            self.find(sweep, self._hiding_part(found, before, evidence), map_out)
            before, found, evidence = sweep, map_out, None

    def _planned_past(self, first: Sweep) -> PlannedSweep:
        """Return `past` for a stream. Aggregations with costs of their own look past surfaces by themselves."""
        if self._further or self._first.aggregation.has_own_costs:
            return self.last
        return PlannedSweep(replace(first, past="surface", aggregation=ACCURATE[-1].aggregation), self._frame)

    def judge(self, sweep: PlannedSweep, map_: Array, unhidden: Array | None, confidence_out: Array) -> None:
        """Find the confidence [y, x] and the variance of a map [y, x] to which a sweep led; see `Judging.run`."""
        by = sweep.aggregation
        if by.evidence is not None:
            self.judging.run(*by.evidence, map_, unhidden, confidence_out)
        else:
            assert by.confidence is not None
            assert by.variance is not None
            self.judging.kernels.copy(by.confidence, confidence_out)
            self.judging.kernels.copy(by.variance, self.judging.variance)

    def find(
        self,
        sweep: PlannedSweep,
        surface: Array | None,
        map_out: Array,
        expect: Callable[[Array], None] | None = None,
    ) -> None:
        """Find a map [y, x] by a sweep, past a surface [y, x] that is known beforehand if one is given."""
        sweep(surface, map_out, expect)
        self._put_far(map_out)

    def _hiding_part(self, found: Array, before: PlannedSweep, evidence: Array | None) -> Array:
        """Return the surfaces of a found map that hide anything: guessed ones are replaced by farther ones."""
        if self._guesses is None or before.aggregation.evidence is None:
            return found
        if evidence is None:
            evidence = self._evidence
            self.judging.evidence(*before.aggregation.evidence, evidence)
        self._guesses.run(evidence, found, self._hides)
        return self._hides
