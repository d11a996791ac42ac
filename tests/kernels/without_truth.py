"""Checks of what equal values do not show: precision, loops, and where a solver ends."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import programs
import solver_checks
import vector_checks


class Check(NamedTuple):
    """A check, the module whose mutants it must notice ("" if none is), and what makes its further arguments."""

    module: str
    run: Callable[..., Any]
    case: str = ""
    make: Callable[[np.random.Generator], tuple[Any, ...]] = lambda rng: ()

    def __str__(self) -> str:
        return "-".join(part for part in (self.run.__name__.removeprefix("check_"), self.case) if part)


CHECKS = (
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
    Check("vector", vector_checks.check_numbers_in_double),
    Check("control", programs.check_repeat),
    Check("control", programs.check_repeat_looks_seldom),
)
