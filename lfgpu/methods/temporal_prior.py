"""How much the last map of a stream says about the next one."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

from lfgpu.errors import LightFieldError

_RANGES = {
    "persistence": (0, 0.99),
    "strength": (0, 10),
    "reach": (0.5, 100),
    "tolerance": (0.5, 100),
    "support": (1e-3, 100),
}


@dataclass(frozen=True)
class TemporalPrior:
    """How much the last map says about the next one. LightFieldError where a value is out of range.

    Parameters
    ----------
    persistence
        Share of the frames so far that still count one frame later where nothing changed, 0 to 0.99: in the long run
        1 / (1 - persistence) frames are averaged. Default 0.8.
    strength
        Cost of being far from the last map, in units of `semi_global.large_penalty`; 0 to 10, default 0.5.
    reach
        Distance from which on that cost stays the same, in steps of the sweep; 0.5 to 100, default 2.
    tolerance
        Mean change of intensity, over 3 x 3 pixels, that makes a pixel half trusted; in units of the noise of the
        views, 0.5 to 100, default 1.5.
    support
        Difference to the last map that halves how much of it is kept, pixels in the farthest view; 0.001 to 100,
        default 0.4.
    """

    persistence: float = 0.8
    strength: float = 0.5
    reach: float = 2.0
    tolerance: float = 1.5
    support: float = 0.4

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real) or not low <= float(value) <= high:
                raise LightFieldError(f"{name} of the temporal prior must lie in {low:g} to {high:g}, not {value!r}.")
