"""Values of options that are more than one word: pairs and settings, from text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    from lfgpu.config import Config


def parse_range(option: str, text: str) -> tuple[float, float]:
    """ "-2,2" as (low, high), finite and low < high; LightFieldError otherwise."""
    low, high = numbers(option, text, ",", "LOW,HIGH such as -2,2")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise LightFieldError(f"{option} must be two finite numbers, LOW below HIGH, not {text!r}.")
    return low, high


def parse_place(option: str, text: str) -> tuple[float, float]:
    """ "4,4" as (row, column) of a view; whether there is one is not known yet. LightFieldError if not two numbers."""
    row, column = numbers(option, text, ",", "ROW,COL such as 4,4")
    if not (math.isfinite(row) and math.isfinite(column)):
        raise LightFieldError(f"{option} must be two finite numbers ROW,COL, not {text!r}.")
    return row, column


def parse_size(option: str, text: str, what: str) -> tuple[int, int]:
    """ "9x9" as two whole numbers; `what` names them in the sentence of the LightFieldError for anything else."""
    first, second = numbers(option, text.lower(), "x", what)
    if not (first.is_integer() and second.is_integer()):
        raise LightFieldError(f"{option} must be {what}, not {text!r}.")
    return int(first), int(second)


def parse_grid(text: str | None) -> tuple[int, int] | None:
    """ "9x9" of the option --grid as (rows, columns); None where it was not given."""
    return None if text is None else parse_size("--grid", text, "ROWSxCOLUMNS such as 9x9")


def reading(
    format_name: str | None, grid: str | None, every: int | None, flip: str, *, allow_missing: bool = False
) -> dict[str, Any]:
    """The options of `lfgpu.read` that were given, as keywords; LightFieldError if --grid is no pair of numbers."""
    options = {
        "format": format_name,
        "grid": parse_grid(grid),
        "every": every,
        "flip": flip,
        "allow_missing": allow_missing,
    }
    return {name: value for name, value in options.items() if value not in (None, "", False)}


def parse_policy(option: str, text: str) -> tuple[str, int | None]:
    """ "latest", "block" or "queue:8" as (name, how many wait or None); LightFieldError for anything else."""
    from lfgpu.pipelines.inbox import POLICIES

    name, colon, count = text.partition(":")
    if name not in POLICIES or (colon and not count.isdecimal()):
        raise LightFieldError(f"{option} must be latest, block or queue:N such as queue:8, not {text!r}.")
    return name, int(count) if colon else None


def numbers(option: str, text: str, separator: str, what: str) -> tuple[float, float]:
    """Two numbers with a separator between them; LightFieldError that says `what` they should be otherwise."""
    try:
        first, second = (float(part) for part in text.split(separator))
    except ValueError:
        raise LightFieldError(f"{option} must be {what}, not {text!r}.") from None
    return first, second


def use_threads(option: str, count: int | None) -> None:
    """Compute on `count` threads of the CPU at most; None leaves it as it is. LightFieldError if there are none."""
    from lfgpu.threads import set_threads

    if count is None:
        return
    if count < 1:
        raise LightFieldError(f"{option} must be a whole number from 1 on, not {count}.")
    set_threads(count)


def configured(preset_name: str, settings: Sequence[str]) -> Config:
    """A preset with `stage.parameter=value` settings applied; LightFieldError if one is wrong or unknown."""
    from lfgpu.methods import preset

    config = preset(preset_name)
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals:
            raise LightFieldError(f"--set must be stage.parameter=value, not {setting!r}.")
        config = config.with_values({name.strip(): value.strip()})
    return config


def check_pattern(option: str, name: str) -> None:
    """LightFieldError if there is no such pattern of views."""
    from lfgpu.data.lightfield import PATTERNS

    if name not in PATTERNS:
        raise LightFieldError(f"{option} must be one of {', '.join(PATTERNS)}, not {name!r}.")
