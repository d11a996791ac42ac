"""The temporal prior: how strongly the map of a frame follows the map of the frame before."""

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
    """Strength with which the map of a frame follows the map of the frame before.

    Parameters
    ----------
    persistence
        Weight that earlier frames keep from one frame to the next, at pixels that did not change. In the long run
        1 / (1 - persistence) frames are averaged. 0 to 0.99, default 0.9.
    strength
        Largest cost of a disparity that differs from the last map, in units of the penalty of large changes in such
        frames (`semi_global.large_penalty` times `semi_global.resweep_factor`). 0 to 10, default 0.7.
    reach
        Difference in disparity from which on this cost is constant, in steps of the sweep. 0.5 to 100, default 2.
    tolerance
        Change of intensity along the motion, averaged over 3 x 3 pixels, that halves the trust in the last map. In
        units of the noise of the views. 0.5 to 100, default 2.
    support
        Difference in disparity that halves the weight of the last map, pixels in the farthest view. 0.001 to 100,
        default 0.4.

    Raises
    ------
    LightFieldError
        If a value is out of range.

    Examples
    --------
    >>> lfgpu.TemporalPrior(strength=0.2).strength
    0.2
    """

    persistence: float = 0.9
    strength: float = 0.7
    reach: float = 2.0
    tolerance: float = 2.0
    support: float = 0.4

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real) or not low <= float(value) <= high:
                raise LightFieldError(f"{name} of the temporal prior must lie in {low:g} to {high:g}, not {value!r}.")
