"""Checks of the options of a stream."""

from __future__ import annotations

import math
from numbers import Integral, Real

from lfgpu.errors import LightFieldError
from lfgpu.pipelines.inbox import POLICIES
from lfgpu.pipelines.stamps import checked_tolerance

_MOST_WAITING = 1000


def check_options(cut: float, budget_ms: float | None, tolerance: float | None) -> None:
    """Check that `cut` is a share, `budget_ms` and `tolerance` times, or None; else LightFieldError."""
    checked_tolerance(tolerance)
    if not (_is_number(cut) and 0 <= cut <= 1):
        raise LightFieldError(f"cut must be a share, 0 to 1, not {cut!r}.")
    if budget_ms is not None and not (_is_number(budget_ms) and 0 < budget_ms < math.inf):
        raise LightFieldError(f"budget_ms must be a number of milliseconds > 0, not {budget_ms!r}.")


def most_waiting(policy: str, waiting: int | None) -> int:
    """Find the number of frames that may wait; LightFieldError if the policy is unknown, or forbids the number."""
    if policy not in POLICIES:
        raise LightFieldError(f"policy must be one of {', '.join(POLICIES)}, not {policy!r}.")
    if waiting is None:
        return POLICIES[policy]
    if not isinstance(waiting, Integral) or isinstance(waiting, bool) or not 1 <= waiting <= _MOST_WAITING:
        raise LightFieldError(f"waiting must be a whole number from 1 to {_MOST_WAITING}, not {waiting!r}.")
    if policy == "latest" and waiting != 1:
        raise LightFieldError(f"waiting must be 1 for the policy latest, not {waiting!r}.")
    return int(waiting)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
