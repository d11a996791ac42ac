"""The parameters of matching that users set, and its presets. `tuning.py` has all other numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self

from lfgpu.config import Config, Section, choice, number, parameters
from lfgpu.methods.matching import tuning
from lfgpu.methods.matching.tuning import MatchingTuning


@dataclass(frozen=True)
class SweepConfig(Section):
    """The plane sweeps: every view is compared with the reference view at a row of disparities."""

    views: str = choice(
        "alternate", ("full", "alternate", "star", "cross"), "views that are used. full: all. star: the reference's "
        "row, column and diagonals. cross: its row and column. alternate: all, but of large grids every other until "
        "the last step. With fewer than four views beside the reference, all are used"
    )  # fmt: skip
    resweeps: int = number(
        3, 0, 8, "number of sweeps after the first one. Each leaves out the views from which the surface found so far "
        "hides a pixel. At most one where all views are on one side or in one line"
    )  # fmt: skip
    step: float = number(
        0.45, 0.02, 2.0, "distance between two compared disparities, pixels in the farthest view; smaller is slower"
    )
    max_labels: int = number(
        256,
        3,
        4096,
        "largest number of disparities that sweeps compare; in a range that needs more, views near the reference are "
        "compared first, at last in longer steps. Networks compare as many as they were trained with",
    )
    noise: float = number(
        0.0, 0.0, 1.0, "root mean square difference between views that show the same point, intensity; 0 measures it"
    )
    smoothing: float = number(
        2.0, 0.0, 100.0, "strength of the smoothing of noisy views before they are compared: differences between "
        "pixels that are averaged, in units of the noise of one view; 0 does not smooth"
    )  # fmt: skip


@dataclass(frozen=True)
class SemiGlobalConfig(Section):
    """Semi-global matching (Hirschmüller 2008): the best surface through the costs of a sweep."""

    small_penalty: float = number(
        0.0006, 0.0, 10.0, "cost of a change by one disparity between adjacent pixels; larger is smoother", symbol="P1"
    )
    large_penalty: float = number(
        0.0034, 0.0, 10.0, "cost of a larger change; larger leaves fewer depth edges", symbol="P2"
    )


@dataclass(frozen=True)
class AlignmentConfig(Section):
    """Gauss-Newton steps: the disparity of each pixel moves to where the views that see it agree best."""

    iterations: int = number(3, 1, 100, "number of steps, each over all pixels")


@dataclass(frozen=True)
class BoundariesConfig(Section):
    """Boundary refinement: a pixel at a depth edge goes to the side whose colour it has."""

    contrast: float = number(
        0.005, 1e-4, 10.0, "smallest difference in colour of the two sides for which pixels are moved, intensity; 10 "
        "moves none"
    )  # fmt: skip


@dataclass(frozen=True)
class HoleFillingConfig(Section):
    """Hole filling: surfaces without texture continue those around them."""

    max_iterations: int = number(100, 0, 10000, "largest number of iterations of the solver; 0 fills nothing")


@dataclass(frozen=True)
class NeighbourhoodConfig(Section):
    """Non-local-means weights, which say how likely two nearby pixels lie on the same surface."""

    window: int = number(
        9, 3, 31, "side of the square neighbourhood, pixels; larger is smoother and slower", symbol="N", odd=True
    )


@dataclass(frozen=True)
class MatchingConfig(Config):
    """All parameters of matching, by stage."""

    method = "matching"
    renamed = {  # noqa: RUF012 - a ClassVar of the base
        "sweep.occlusions": "sweep.resweeps",
        "sweep.most_labels": "sweep.max_labels",
        "matching.small_step": "semi_global.small_penalty",
        "matching.large_step": "semi_global.large_penalty",
        "matching": "semi_global",
        "outlines": "boundaries",
        "filling": "hole_filling",
    }
    fixed = frozenset(
        f"{section.name}.{tuned.name}"
        for section in fields(MatchingTuning)
        if section.name not in ("name", "passes")
        for tuned in fields(section.default)  # type: ignore[arg-type]  # sections are dataclasses
    ) | {"sweep.aperture", "sweep.preference", "sweep.least_share"}

    prior: NeighbourhoodConfig = NeighbourhoodConfig()
    sweep: SweepConfig = SweepConfig()
    semi_global: SemiGlobalConfig = SemiGlobalConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    boundaries: BoundariesConfig = BoundariesConfig()
    hole_filling: HoleFillingConfig = HoleFillingConfig()
    tuning: MatchingTuning = tuning.ACCURATE
    weights: str = ""
    """The weights of the network, a `WeightsFile`; "" for those that lfgpu comes with."""

    def with_tuning(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with some numbers of the tuning or parameters changed, for experiments: files keep none."""
        own = dict(parameters(self))
        config = self.with_values({name: value for name, value in values.items() if name in own})
        others = {name: value for name, value in values.items() if name not in own}
        return replace(config, tuning=config.tuning.with_values(others)) if others else config


PRESETS = {
    "accurate": MatchingConfig(),
    "fast": MatchingConfig(
        sweep=SweepConfig(views="cross", resweeps=1),
        semi_global=SemiGlobalConfig(large_penalty=0.003),
        alignment=AlignmentConfig(iterations=1),
        tuning=tuning.FAST,
    ),
    "learned": MatchingConfig(
        sweep=SweepConfig(resweeps=0, step=0.5, smoothing=0.0),
        boundaries=BoundariesConfig(contrast=10.0),
        tuning=tuning.LEARNED,
    ),
    "surest": MatchingConfig(
        sweep=SweepConfig(resweeps=1),
        alignment=AlignmentConfig(iterations=2),
        semi_global=SemiGlobalConfig(large_penalty=0.003),
        tuning=tuning.SUREST,
    ),
}
"""`accurate` compares all views, or every other one of large grids, in four sweeps. `fast` compares the reference's row
and column of views in two sweeps. `surest` has the map of two sweeps over such views, and that of `learned`."""
