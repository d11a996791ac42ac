"""The cases, as data: sizes of light fields."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.errors import BenchmarkError

CHANNELS = 3


@dataclass(frozen=True)
class Case:
    """A light field of `grid` (rows, columns) of views of `size` (height, width) pixels in colour."""

    grid: tuple[int, int]
    size: tuple[int, int]
    default: bool = True
    """Measured unless other cases are asked for."""
    tiny: bool = False
    """Small enough for the reference backend: float64 NumPy, written to be read."""

    @property
    def name(self) -> str:
        """Rows x columns x height x width."""
        return "x".join(map(str, (*self.grid, *self.size)))

    @property
    def samples(self) -> int:
        """Pixels of all views."""
        return self.grid[0] * self.grid[1] * self.size[0] * self.size[1]


CASES = (
    Case((3, 3), (48, 48), default=False, tiny=True),  # to see whether everything runs
    Case((5, 5), (128, 128), tiny=True),
    Case((5, 5), (256, 256)),
    Case((7, 7), (375, 375)),  # the paper's
    Case((9, 9), (512, 512)),  # the HCI benchmark's
    Case((9, 9), (960, 1280), default=False),
    Case((17, 17), (960, 1280), default=False),
)

STARTUP_CASE = CASES[1]
"""What the time to the first result is measured with: small, so that start-up is most of it."""


def find(name: str) -> Case:
    """The case of that name; BenchmarkError if there is none."""
    for case in CASES:
        if case.name == name:
            return case
    raise BenchmarkError(f"unknown case {name!r}; there are {', '.join(case.name for case in CASES)}.")


def parse(name: str) -> Case:
    """The case "7x7x375x375", listed here or not; BenchmarkError for anything else."""
    try:
        rows, columns, height, width = (int(part) for part in name.split("x"))
    except ValueError:
        raise BenchmarkError(f"{name!r} is no case: it must be ROWSxCOLUMNSxHEIGHTxWIDTH.") from None
    return Case((rows, columns), (height, width))
