"""The parameters of matching, and its presets."""

from __future__ import annotations

from dataclasses import dataclass

from lfgpu.config import Config, Section, choice, number
from lfgpu.methods.sections import PriorConfig


@dataclass(frozen=True)
class SweepConfig(Section):
    """The plane sweep: every view is compared with the reference at a row of disparities."""

    views: str = choice(
        "alternate", ("full", "alternate", "star", "cross"), "views that are used. full: all. alternate: all, but "
        "until the last step of the alignment every other one, as the squares of one colour on a chessboard, if that "
        "leaves 40 or more of a grid. star: those in the reference's row, column and diagonals. cross: those in its "
        "row and column. If fewer than four are left beside the reference, all are used"
    )  # fmt: skip
    occlusions: str = choice(
        "twice", ("once", "twice"), "once compares partial view sets; twice sweeps again with the views that see a "
        "pixel past the first surface"
    )  # fmt: skip
    step: float = number(0.4, 0.02, 2.0, "distance between two disparities, pixels in the farthest view")
    max_labels: int = number(256, 3, 4096, "most disparities; a range that needs more gets longer steps")
    noise: float = number(
        0.0, 0.0, 1.0, "difference between views that agree, intensity; 0 measures it. Thresholds on what views may "
        "differ by grow with it, and how far views are smoothed"
    )  # fmt: skip
    smoothing: float = number(
        2.0, 0.0, 100.0, "before views are compared, pixels of a view that differ by less than about this are "
        "averaged; in units of the grain, the noise of one view; 0 compares views as they are"
    )  # fmt: skip
    reduced_weight: float = number(
        0.15, 0.0, 10.0, "weight of the costs of reduced views, a quarter as wide and as high, in the first sweep; 0 "
        "leaves them out"
    )  # fmt: skip
    truncation: float = number(0.1, 1e-3, 10.0, "larger differences in intensity count as this one")
    gradient_weight: float = number(2.0, 0.0, 100.0, "weight of image gradients against intensities")
    gradient_truncation: float = number(
        0.05, 1e-4, 10.0, "larger differences in image gradients count as this one, intensity per pixel"
    )
    view_set_angle: float = number(
        90.0, 10.0, 180.0, "opening angle of the partial view sets around the reference, degrees"
    )  # fmt: skip
    view_set_penalty: float = number(
        0.2, 0.0, 10.0, "a partial view set must agree better than all views by this share to be preferred"
    )  # fmt: skip
    tolerance: float = number(
        1.2, 0.0, 100.0, "a surface hides only what lies behind it by more than this, pixels in the farthest view"
    )  # fmt: skip
    min_share: float = number(
        0.02, 0.0, 1.0, "share of the views, but at least one, that must see a pixel in the second sweep"
    )  # fmt: skip
    hiding_margin: float = number(
        0.1, 0.0, 100.0, "a surface may lie farther away than it was found: as far as its costs are higher by at "
        "most this; it hides something for certain only from there on; units of the noise"
    )  # fmt: skip
    certain_penalty: float = number(
        0.01, 0.0, 100.0, "added to the mean cost over the views that see a pixel past what hides for certain, "
        "units of the noise"
    )  # fmt: skip


@dataclass(frozen=True)
class SemiGlobalConfig(Section):
    """Semi-global matching (Hirschmüller 2008): the best surface through the costs of the sweep."""

    window: int = number(3, 3, 31, "side of the window over which costs are averaged, pixels", odd=True)
    small_penalty: float = number(0.0005, 0.0, 10.0, "cost of a change by one disparity", symbol="P1")
    large_penalty: float = number(0.0035, 0.0, 10.0, "cost of a larger change", symbol="P2")
    resweep_factor: float = number(
        0.7, 0.1, 100.0, "factor on large_penalty after the second sweep, and in frames that start from the last map"
    )  # fmt: skip
    contrast: float = number(2.0, 1e-3, 10.0, "difference in intensity that lowers both penalties to 1/e")


@dataclass(frozen=True)
class AlignmentConfig(Section):
    """Gauss-Newton steps: the disparity of each pixel moves to where the views that see it agree best."""

    iterations: int = number(3, 1, 100, "number of steps, each over all pixels")
    gradient_weight: float = number(2.0, 0.0, 100.0, "weight of image gradients against intensities")
    robust: float = number(
        0.01, 1e-4, 10.0, "scale of the robust loss: larger differences from the mean of the views count less, "
        "intensity"
    )  # fmt: skip
    support: float = number(
        0.4, 1e-3, 100.0, "difference in disparity that halves the weight of a neighbour, pixels in the farthest view"
    )  # fmt: skip
    ridge: float = number(
        1.0, 1e-3, 1e6, "variance of the places in a window below which its plane becomes level, pixel²"
    )  # fmt: skip
    stiffness: float = number(
        0.1, 0.0, 100.0, "a pixel whose curvature over robust² is below this follows its neighbours, 1 / pixel²"
    )  # fmt: skip
    longest_step: float = number(0.4, 1e-3, 10.0, "longest step, pixels in the farthest view")


@dataclass(frozen=True)
class BoundariesConfig(Section):
    """Boundary refinement: a pixel at a depth edge goes to the side whose colour it has."""

    share: float = number(
        0.5, 0.0, 1.0, "a pixel with less than this share of the nearer side's colour goes to the farther side"
    )  # fmt: skip
    contrast: float = number(0.005, 1e-4, 10.0, "least difference in colour of the two sides, intensity")


@dataclass(frozen=True)
class HoleFillingConfig(Section):
    """Hole filling: surfaces without texture continue those around them. A quadratic problem."""

    stiffness: float = number(
        0.02, 1e-6, 100.0, "curvature over robust² at which a pixel's own estimate counts as much as one similar "
        "neighbour, 1 / pixel²"
    )  # fmt: skip
    tolerance: float = number(3e-7, 1e-8, 1e-1, "relative residual at which the solver stops")
    max_iterations: int = number(100, 0, 10000, "most iterations of the solver")


@dataclass(frozen=True)
class MatchingConfig(Config):
    """All parameters of matching, by stage.

    Raises
    ------
    LightFieldError
        If a value is out of range.
    """

    method = "matching"
    renamed = {  # noqa: RUF012 - a ClassVar of the base
        "sweep.most_labels": "sweep.max_labels",
        "sweep.aperture": "sweep.view_set_angle",
        "sweep.preference": "sweep.view_set_penalty",
        "sweep.least_share": "sweep.min_share",
        "matching.small_step": "semi_global.small_penalty",
        "matching.large_step": "semi_global.large_penalty",
        "matching": "semi_global",
        "outlines": "boundaries",
        "filling": "hole_filling",
    }

    prior: PriorConfig = PriorConfig(window=9, sigma_color=0.04, sigma_gradient=10.0)  # shadows' edges are no edges
    sweep: SweepConfig = SweepConfig()
    semi_global: SemiGlobalConfig = SemiGlobalConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    boundaries: BoundariesConfig = BoundariesConfig()
    hole_filling: HoleFillingConfig = HoleFillingConfig()


PRESETS = {
    "accurate": MatchingConfig(),
    "fast": MatchingConfig(
        sweep=SweepConfig(views="cross", occlusions="once", view_set_angle=180.0, reduced_weight=0.0),
        alignment=AlignmentConfig(iterations=1),
    ),
}
"""`accurate` matches all views, of large grids every other one at first, and sweeps twice. `fast` matches the
reference's row and column of views, once."""
