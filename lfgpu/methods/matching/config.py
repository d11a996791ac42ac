"""The parameters of matching, and its presets."""

from __future__ import annotations

from dataclasses import dataclass

from lfgpu.config import Config, Section, choice, number
from lfgpu.methods.sections import PriorConfig


@dataclass(frozen=True)
class SweepConfig(Section):
    """The plane sweep: every view is compared with the reference at a row of disparities."""

    views: str = choice(
        "alternate", ("full", "alternate", "star", "cross"), "views that are used. full: all. alternate: all in the "
        "last step of the alignment; before, every other one of a grid, as the squares of one colour on a chessboard, "
        "if that leaves 40 or more, and in the sweeps between the first and the last those of every other row and "
        "column, if that leaves 25; so in all these steps if the chessboard leaves fewer. star: those in the "
        "reference's row, column and diagonals. cross: those in its row and column; before the last step of the "
        "alignment every other one, if that leaves 9. If fewer than four are left beside the reference, all are used"
    )  # fmt: skip
    first_views: str = choice(
        "cross", ("all", "cross"), "views that the first sweep compares: all that are used, or of these those in the "
        "reference's row and column. If fewer than four are left beside the reference, all are compared"
    )  # fmt: skip
    resweeps: int = number(
        3, 0, 8, "how many more sweeps there are; at most one where the views are on one side or in one line. Each "
        "compares the views that see a pixel past the surface that was found so far"
    )  # fmt: skip
    step: float = number(0.45, 0.02, 2.0, "distance between two disparities, pixels in the farthest view")
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
    reduced_contrast: float = number(
        0.08, 1e-3, 1000.0, "beside adjacent pixels of a reduced view that differ by this, reduced_weight is half as "
        "high, intensity. Only where at most one more sweep follows: several mend what reduced views do to outlines"
    )  # fmt: skip
    truncation: float = number(0.1, 1e-3, 10.0, "larger differences in intensity count as this one")
    resweep_truncation: float = number(
        0.07, 1e-3, 10.0, "the same in the sweeps between the first and the last, which compare intensities only: the "
        "gradient beside an outline is that of what is nearer"
    )  # fmt: skip
    gradient_weight: float = number(
        0.5, 0.0, 100.0, "weight of image gradients against intensities in the first sweep"
    )  # fmt: skip
    resweep_gradient_weight: float = number(
        0.15, 0.0, 100.0, "the same in the last sweep, if there are several"
    )  # fmt: skip
    gradient_truncation: float = number(
        0.035, 1e-4, 10.0, "larger differences in image gradients count as this one, intensity per pixel"
    )
    softness: float = number(
        0.2, 0.0, 1000.0, "larger differences in intensity count by their square root, so that faint texture counts "
        "beside strong edges; in units of the noise; 0 counts all as they are"
    )  # fmt: skip
    view_set_angle: float = number(
        180.0, 10.0, 180.0, "opening angle of the partial view sets around the reference, degrees"
    )  # fmt: skip
    view_set_penalty: float = number(
        0.2, 0.0, 10.0, "a partial view set must agree better than all views by this share to be preferred"
    )  # fmt: skip
    tolerance: float = number(
        1.2, 0.0, 100.0, "a surface hides only what lies behind it by more than this, pixels in the farthest view"
    )  # fmt: skip
    ambiguity: float = number(
        0.3, 0.01, 1.0, "where a map is uneven and more than this share of the disparities is as good as the best one, "
        "it was guessed: there only the farther surfaces hide what lies behind them; 1: no surface counts as guessed"
    )  # fmt: skip
    min_share: float = number(
        0.02, 0.0, 1.0, "share of the views, but at least one, that must see a pixel in further sweeps"
    )  # fmt: skip

    @property
    def kind(self) -> str:
        """Which weights of the confidence (`trust.py`) it has: "again" if more than one sweep follows the first."""
        return "again" if self.resweeps > 1 else "once"


@dataclass(frozen=True)
class SemiGlobalConfig(Section):
    """Semi-global matching (Hirschmüller 2008): the best surface through the costs of the sweep."""

    window: int = number(3, 3, 31, "side of the window over which costs are averaged, pixels", odd=True)
    small_penalty: float = number(0.0006, 0.0, 10.0, "cost of a change by one disparity", symbol="P1")
    large_penalty: float = number(0.0034, 0.0, 10.0, "cost of a larger change", symbol="P2")
    contrast: float = number(
        0.03, 1e-3, 10.0, "difference in intensity of adjacent pixels that lowers both penalties to 1/e after the "
        "first sweep: surfaces end where the image has edges"
    )  # fmt: skip
    resweep_factor: float = number(
        0.7, 0.1, 100.0, "factor on large_penalty after further sweeps, and in frames that start from the last map"
    )  # fmt: skip
    resweep_contrast: float = number(
        2.0, 1e-3, 10.0, "contrast after further sweeps, and in frames that start from the last map"
    )  # fmt: skip


@dataclass(frozen=True)
class AlignmentConfig(Section):
    """Gauss-Newton steps: the disparity of each pixel moves to where the views that see it agree best."""

    iterations: int = number(3, 1, 100, "number of steps, each over all pixels")
    gradient_weight: float = number(2.0, 0.0, 100.0, "weight of image gradients against intensities")
    contrast: float = number(
        0.06, 1e-4, 100.0, "difference of adjacent pixels that halves gradient_weight two pixels around, intensity: "
        "the gradient beside an outline is that of what is nearer"
    )  # fmt: skip
    robust: float = number(
        0.01, 1e-4, 10.0, "scale of the robust loss: larger differences from the mean of the views count less, "
        "intensity"
    )  # fmt: skip
    support: float = number(
        0.18, 1e-3, 100.0, "difference in disparity that halves the weight of a neighbour, pixels in the farthest view"
    )  # fmt: skip
    ridge: float = number(
        1.0, 1e-3, 1e6, "variance of the places in a window below which its plane becomes level, pixel²"
    )  # fmt: skip
    stiffness: float = number(
        0.1, 0.0, 100.0, "a pixel whose curvature over robust² is below this follows its neighbours, 1 / pixel²"
    )  # fmt: skip
    longest_step: float = number(0.4, 1e-3, 10.0, "longest step, pixels in the farthest view")
    reach: float = number(
        1.8, 0.1, 1000.0, "a pixel that has moved farther than this is put back to where it was matched: it followed a "
        "reflection. In steps between the disparities that the sweep compares"
    )  # fmt: skip


@dataclass(frozen=True)
class BoundariesConfig(Section):
    """Boundary refinement: a pixel at a depth edge goes to the side whose colour it has."""

    step: float = number(
        0.84, 0.01, 100.0, "between adjacent pixels whose disparities differ by more than this there is a depth edge, "
        "pixels in the farthest view"
    )  # fmt: skip
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
    tolerance: float = number(1e-7, 1e-8, 1e-1, "relative residual at which the solver stops")
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
        "sweep.occlusions": "sweep.resweeps",
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
        sweep=SweepConfig(views="cross", resweeps=1, reduced_weight=0.3),
        semi_global=SemiGlobalConfig(large_penalty=0.003),
        alignment=AlignmentConfig(iterations=1, support=0.4),
    ),
}
"""`accurate` matches the reference's row and column of views, and then three times the views that see a pixel: all, or
of large grids of every other one. `fast` matches the reference's row and column of views, twice."""
