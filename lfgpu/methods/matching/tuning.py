"""Numbers of matching that users do not set: each with its unit, its reason, and what the ablation says of it.

`ablation` names the variant of `python -m benchmarks ablation` (`benchmarks/results/ablation.json`) in which the number
has no effect or another one. For an experiment, `MatchingConfig.with_tuning` changes numbers by `section.number`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from lfgpu.config import Tuning, tuned

INTENSITY, SLOPE = "intensity", "intensity per pixel"
PIXELS, FARTHEST = "pixels", "pixels in the farthest view"


@dataclass(frozen=True)
class SweepTuning:
    """Numbers of the plane sweeps."""

    first_views: str = tuned(
        "cross", "", "Rule for the views of the first sweep: row and column show most surfaces in a fifth of the time.",
        ablation="first sweep over all views",
    )  # fmt: skip
    reduced_weight: float = tuned(
        0.15, "", "Weight of the costs of reduced views, a quarter as wide and high: faint texture shows in them."
    )
    reduced_contrast: float = tuned(
        0.08, INTENSITY, "Difference of adjacent pixels of a reduced view beside which reduced_weight is halved, as "
        "reduced views blur outlines. Used only where at most one more sweep follows: several mend the outlines."
    )  # fmt: skip
    truncation: float = tuned(
        0.1, INTENSITY, "Larger differences count as this one: what is hidden may differ by anything.",
        ablation="sweep: intensities not truncated",
    )  # fmt: skip
    resweep_truncation: float = tuned(
        0.07, INTENSITY, "The same in the sweeps between the first and the last.",
        ablation="sweeps between truncated as the others",
    )  # fmt: skip
    gradient_weight: float = tuned(
        0.5, "", "Weight of image gradients against intensities in the first sweep: cameras differ in brightness.",
        ablation="sweep: no gradients",
    )  # fmt: skip
    resweep_gradient_weight: float = tuned(
        0.15, "", "The same in the last sweep: beside an outline the gradient is that of the nearer surface.",
        ablation="last sweep: gradients weigh as in the first",
    )  # fmt: skip
    gradient_truncation: float = tuned(
        0.035, SLOPE, "Larger differences in image gradients count as this one.",
        ablation="sweep: gradients not truncated",
    )  # fmt: skip
    softness: float = tuned(
        0.2, "noise", "Larger differences count by their square root: faint texture counts beside strong edges.",
        ablation="sweep: differences as they are, not their roots",
    )  # fmt: skip
    view_set_angle: float = tuned(
        180.0, "degrees", "Opening angle of the partial view sets: one half of the views sees past most outlines.",
        ablation="apertures of a quarter of the views",
    )  # fmt: skip
    view_set_penalty: float = tuned(
        0.2, "", "Share by which a partial view set must agree better than all views: noise must not choose it.",
        ablation="apertures not held back",
    )  # fmt: skip
    tolerance: float = tuned(
        1.2, FARTHEST, "A surface hides only what lies behind it by more: it must not hide itself.",
        ablation="nothing hides anything",
    )  # fmt: skip
    ambiguity: float = tuned(
        0.3, "", "Share of the disparities that are as good as the best one, above which an uneven map was guessed; "
        "1: no surface counts as guessed.", ablation="guessed surfaces hide as all others",
    )  # fmt: skip
    min_share: float = tuned(
        0.02, "", "Share of the views, but at least one view, that must see a pixel in further sweeps."
    )


@dataclass(frozen=True)
class SemiGlobalTuning:
    """Numbers of semi-global matching."""

    window: int = tuned(
        3, PIXELS, "Side of the window over which costs are averaged: larger ones blur the corners of outlines.",
        ablation="costs over 5 pixels",
    )  # fmt: skip
    contrast: float = tuned(
        0.03, INTENSITY, "Difference of adjacent pixels that lowers both penalties to 1/e after the first sweep: "
        "surfaces end where the image has edges.", ablation="first sweep: steps as dear at edges of the image",
    )  # fmt: skip
    resweep_factor: float = tuned(
        0.7, "", "Factor on large_penalty after further sweeps, whose costs are right beside outlines, too."
    )
    resweep_contrast: float = tuned(
        2.0, INTENSITY, "contrast after further sweeps: so large that edges of the image no longer matter.",
        ablation="further sweeps: steps cheaper at edges, too",
    )  # fmt: skip
    most_noisy: float = tuned(
        4.0,
        "noise",
        "Most by which the costs around a pixel raise its penalties: grain and gloss differ by chance.",
    )


@dataclass(frozen=True)
class AlignmentTuning:
    """Numbers of the alignment."""

    gradient_weight: float = tuned(
        2.0, "", "Weight of image gradients against intensities.", ablation="alignment: no gradients"
    )
    contrast: float = tuned(
        0.06, INTENSITY, "Difference of adjacent pixels that halves gradient_weight two pixels around: beside an "
        "outline the gradient is that of the nearer surface.", ablation="alignment: gradients beside steps, too",
    )  # fmt: skip
    robust: float = tuned(
        0.01, INTENSITY, "Scale of the robust loss: views that see something else must not count.",
        ablation="alignment: not robust",
    )  # fmt: skip
    support: float = tuned(
        0.18, FARTHEST, "Difference in disparity that halves the weight of a neighbour: about that of one surface.",
        ablation="alignment: across surfaces",
    )  # fmt: skip
    ridge: float = tuned(
        1.0, "pixel²", "Variance of the places in a window below which its plane becomes level: too few places tilt it."
    )
    stiffness: float = tuned(
        0.1, "1 / pixel²", "Curvature over robust² below which a pixel follows its neighbours: it has no texture.",
        ablation="alignment: no stiffness",
    )  # fmt: skip
    longest_step: float = tuned(
        0.4, FARTHEST, "Longest step: images are linear only so far.", ablation="next to no alignment"
    )
    reach: float = tuned(
        1.8, "steps of the sweep", "A pixel that has moved farther returns to where it was matched: it followed a "
        "reflection.", ablation="alignment: nothing put back",
    )  # fmt: skip
    matched: float = tuned(
        0.04, "", "Weight of the network's map against the views, in units of robust over its standard deviation; far "
        "below 1, as its errors are those of its neighbours, too."
    )  # fmt: skip
    still: float = tuned(
        1e-2, "", "Weight of a pixel without texture in the mean of its window, so that means exist everywhere."
    )
    least_curvature: float = tuned(
        1e-2, "1 / pixel²", "Curvature over robust² that holds a pixel where only noise would move it."
    )


@dataclass(frozen=True)
class BoundariesTuning:
    """Numbers of the boundary refinement."""

    step: float = tuned(
        0.84, FARTHEST, "Between adjacent pixels whose disparities differ by more there is a depth edge.",
        ablation="outlines: only where surfaces hide each other",
    )  # fmt: skip
    turned: float = tuned(
        40.0, PIXELS, "A surface that goes through the whole range over so many pixels or more is turned, and its "
        "pixels lie at no depth edge, however much the farthest view shows them apart."
    )  # fmt: skip
    share: float = tuned(0.5, "", "A pixel with a smaller share of the nearer side's colour goes to the farther side.")
    second_share: float = tuned(0.6, "share", "The same for the second pixel of a blurred outline.")
    second_contrast: float = tuned(4.0, "contrast", "contrast for that pixel: only a clear mixture counts.")


@dataclass(frozen=True)
class HoleFillingTuning:
    """Numbers of the hole filling."""

    stiffness: float = tuned(
        0.02, "1 / pixel²", "Curvature over robust² at which a pixel's own estimate counts as much as one similar "
        "neighbour.", ablation="alignment: not robust",
    )  # fmt: skip
    tolerance: float = tuned(1e-7, "", "Relative residual at which the solver stops: below it no pixel moves by 1e-3.")


@dataclass(frozen=True)
class PriorTuning:
    """Numbers of the non-local-means weights."""

    patch: int = tuned(3, PIXELS, "Side of the patches that are compared.", ablation="pixels compared, not patches")
    sigma_color: float = tuned(
        0.04, INTENSITY, "Root mean square difference of patches at which the weight falls to 1/e; so large that "
        "edges of shadows do not count.", ablation="means over the window, like or not",
    )  # fmt: skip
    sigma_gradient: float = tuned(10.0, SLOPE, "The same of gradients; so large that gradients do not count.")
    floor: float = tuned(1e-4, "", "Smallest weight between two pixels of a window; it keeps every pixel connected.")


@dataclass(frozen=True)
class MatchingTuning(Tuning):
    """All numbers of matching that users do not set."""

    prior: PriorTuning = PriorTuning()
    sweep: SweepTuning = SweepTuning()
    semi_global: SemiGlobalTuning = SemiGlobalTuning()
    alignment: AlignmentTuning = AlignmentTuning()
    boundaries: BoundariesTuning = BoundariesTuning()
    hole_filling: HoleFillingTuning = HoleFillingTuning()
    passes: str = "matching"
    """The table of sweeps: a row of `passes.TABLES`."""


ACCURATE = MatchingTuning("accurate")
FAST = MatchingTuning(
    "fast",
    # Few views and one more sweep: what reduced views show is missed more, and means are over more pixels.
    sweep=replace(ACCURATE.sweep, reduced_weight=0.3),
    alignment=replace(ACCURATE.alignment, support=0.4),
)
LEARNED = MatchingTuning("learned", sweep=replace(ACCURATE.sweep, first_views="all"), passes="learned")
SUREST = replace(FAST, name="surest", alignment=ACCURATE.alignment, passes="both")


_DIFFER = 3.0  # times as much as elsewhere, in wide ranges


def in_wide_ranges(tuning: MatchingTuning) -> MatchingTuning:
    """Return the numbers for ranges so wide that sweeps compare views near the reference only.

    There surfaces turn so far between the views that gradients are not alike, and intensities less. What holds a pixel
    when holes are filled stays the same.
    """
    alignment, prior, filling = tuning.alignment, tuning.prior, tuning.hole_filling
    return replace(
        tuning,
        prior=replace(prior, sigma_color=_DIFFER * prior.sigma_color),
        alignment=replace(alignment, gradient_weight=0.0, robust=_DIFFER * alignment.robust),
        hole_filling=replace(filling, stiffness=filling.stiffness / _DIFFER**2),
    )
