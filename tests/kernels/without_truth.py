"""The checks that know no truth, with their inputs: backends pass them, and mutants of the reference fail them."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import alignment_checks
import nlm_checks
import numpy as np
import occlusion_checks
import programs
import smoothing_checks
import solver_checks
import splat_checks
import sweep_checks
import vector_checks


class Check(NamedTuple):
    """A check, the module whose mutants it must notice ("" if none is), and what makes its further arguments."""

    module: str
    run: Callable[..., Any]
    case: str = ""
    make: Callable[[np.random.Generator], tuple[Any, ...]] = lambda rng: ()

    def __str__(self) -> str:
        return "-".join(part for part in (self.run.__name__.removeprefix("check_"), self.case) if part)


def _of(module: str, inputs: Callable[..., Any], cases: Iterable[Any], *checks: Callable[..., Any]) -> list[Check]:
    """Make checks of inputs: of each case, in turn."""
    of_case = [(str(case), lambda rng, case=case: (inputs(case, rng),)) for case in cases]
    return [Check(module, check, *named) for check in checks for named in of_case]


def _random(rng: np.random.Generator) -> tuple[np.random.Generator]:
    return (rng,)


FAR = occlusion_checks.OcclusionCase("far", size=(23, 26), disparities=(-50.0, 50.0), exact=False, sharpness=1000.0)
MASKED_SWEEPS = [case for case in sweep_checks.SWEEP_CASES if case.masked][:4]
CHECKS = (
    *_of(
        "splat",
        splat_checks.splat_inputs,
        [case for case in splat_checks.SPLAT_CASES if case.masked],
        splat_checks.check_masked_pixels_do_not_count,
        splat_checks.check_masked_view_is_a_missing_view,
        splat_checks.check_nothing_valid_is_nothing_at_all,
    ),
    *_of("nlm", nlm_checks.nlm_inputs, nlm_checks.NLM_CASES, nlm_checks.check_nlm_symmetric),
    *_of("occlusion", occlusion_checks.occlusion_inputs, [FAR], occlusion_checks.check_safe_whatever_the_range),
    *_of(
        "occlusion",
        occlusion_checks.occlusion_inputs,
        [occlusion_checks.OcclusionCase("any")],
        occlusion_checks.check_front_hides_back,
    ),
    *_of(
        "alignment",
        alignment_checks.alignment_inputs,
        alignment_checks.ALIGNMENT_CASES,
        alignment_checks.check_what_no_view_sees_has_no_slope,
    ),
    *(
        Check(
            "alignment", alignment_checks.check_step_leads_to_the_truth, str(channels), lambda rng, c=channels: (c, rng)
        )
        for channels in (1, 3)
    ),
    *_of(
        "plane_sweep",
        sweep_checks.sweep_inputs,
        MASKED_SWEEPS,
        sweep_checks.check_masked_view_is_a_missing_view,
        sweep_checks.check_nothing_valid_costs_the_most,
    ),
    *_of(
        "plane_sweep",
        sweep_checks.sweep_inputs,
        [sweep_checks.SweepCase("any")],
        sweep_checks.check_a_side_that_sees_is_enough,
    ),
    Check("smoothing", smoothing_checks.check_constant_stays),
    Check("smoothing", smoothing_checks.check_edge_stays),
    Check("smoothing", smoothing_checks.check_noise_falls, "", _random),
    Check("smoothing", smoothing_checks.check_regions_stay_apart, "", _random),
    Check("smoothing", smoothing_checks.check_masked_pixels_say_nothing, "", _random),
    Check("smoothing", smoothing_checks.check_channels_are_alike_together, "", _random),
    Check("lbfgs", solver_checks.check_sufficient_decrease),
    *(
        Check(
            "lbfgs",
            solver_checks.check_lbfgs_converges,
            "x".join(map(str, size)),
            lambda rng, s=size: (solver_checks.quadratic(s[0] * s[1], rng), rng.normal(size=s)),
        )
        for size in ((6, 7), (1, 12))
    ),
    Check("", vector_checks.check_dot_in_double),
    Check("", vector_checks.check_numbers_in_double),
    Check("", programs.check_repeat),
)
