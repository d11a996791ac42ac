"""Values of options from text: pairs of numbers, policies and settings; None for an option that was not given."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    from pathlib import Path

    from lfgpu.config import Config


def parse_range(option: str, text: str | None) -> tuple[float, float] | None:
    """Parse (low, high) from text such as "-2,2"; LightFieldError unless both are finite and low < high."""
    if text is None:
        return None
    low, high = numbers(option, text, ",", "LOW,HIGH such as -2,2")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise LightFieldError(f"{option} must be two finite numbers LOW,HIGH with LOW below HIGH, not {text!r}.")
    return low, high


def parse_place(option: str, text: str | None) -> tuple[float, float] | None:
    """Parse (row, column) from text such as "4,4"; LightFieldError unless both are finite. The view need not exist."""
    if text is None:
        return None
    row, column = numbers(option, text, ",", "ROW,COL such as 4,4")
    if not (math.isfinite(row) and math.isfinite(column)):
        raise LightFieldError(f"{option} must be two finite numbers ROW,COL, not {text!r}.")
    return row, column


def parse_size(option: str, text: str | None, what: str) -> tuple[int, int] | None:
    """Parse two integers from text such as "9x9"; otherwise LightFieldError: "OPTION must be `what`"."""
    if text is None:
        return None
    first, second = numbers(option, text.lower(), "x", what)
    if not (first.is_integer() and second.is_integer()):
        raise LightFieldError(f"{option} must be {what}, not {text!r}.")
    return int(first), int(second)


def parse_policy(option: str, text: str | None) -> tuple[str, int | None] | None:
    """Parse a policy from text: "latest", "block" or "queue:8" as (name, number of waiting frames or None)."""
    from lfgpu.pipelines.inbox import most_waiting

    if text is None:
        return None
    name, colon, count = text.partition(":")
    try:
        waiting = int(count) if colon else None
        most_waiting(name, waiting)
    except ValueError as error:  # and LightFieldError, which is one
        raise LightFieldError(
            f"{option} must be latest, block or queue:N such as queue:8, N from 1 to 1000, not {text!r}."
        ) from error
    return name, waiting


def numbers(option: str, text: str, separator: str, what: str) -> tuple[float, float]:
    """Parse two numbers with a separator between them; otherwise LightFieldError: "OPTION must be `what`"."""
    try:
        first, second = (float(part) for part in text.split(separator))
    except ValueError:
        raise LightFieldError(f"{option} must be {what}, not {text!r}.") from None
    return first, second


def use_threads(option: str, count: int | None) -> None:
    """Set the largest number of CPU threads; None leaves it unchanged. LightFieldError if `count` is below 1."""
    from lfgpu.threads import set_threads

    if count is None:
        return
    if count < 1:
        raise LightFieldError(f"{option} must be an integer >= 1, not {count}.")
    set_threads(count)


def configured(preset_name: str | None, settings: Sequence[str], weights: Path | None = None) -> Config:
    """Apply settings `stage.parameter=value` and weights to a preset; LightFieldError if one is wrong or unknown."""
    from lfgpu import methods

    config = methods.configured(preset_name, weights)
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals:
            raise LightFieldError(
                f"--set must be stage.parameter=value, not {setting!r}; `lfgpu parameters` lists all names."
            )
        config = config.with_values({name.strip(): value.strip()})
    return config


def check_pattern(option: str, name: str) -> None:
    """Raise LightFieldError if there is no pattern of views with this name."""
    from lfgpu.data.layout import PATTERNS

    if name not in PATTERNS:
        raise LightFieldError(f"{option} must be one of {', '.join(PATTERNS)}, not {name!r}.")
