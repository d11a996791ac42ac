"""Whether the disparity range of a stream is too small for what comes."""

from __future__ import annotations

from lfgpu.contract import Float32Array
from lfgpu.methods.range_check import at_ends


class RangeWatch:
    """Looks at the maps of a stream and says, once for each end, that the range is too small.

    Parameters
    ----------
    bounds
        (low, high) of the disparities, pixels per view step.
    """

    def __init__(self, bounds: tuple[float, float]) -> None:
        self._bounds = bounds
        self._said: dict[str, str] = {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What has been said, one sentence for each end of the range."""
        return tuple(self._said.values())

    def look(self, index: int, disparity: Float32Array) -> tuple[bool, tuple[str, ...]]:
        """Look at the map [y, x] of a frame.

        Returns
        -------
        Whether the range was too small for it, and the sentences that are new.
        """
        beyond = at_ends(disparity, self._bounds)
        new = tuple(self._sentence(end, share, index) for end, share in beyond.items() if end not in self._said)
        self._said |= dict(zip((end for end in beyond if end not in self._said), new, strict=True))
        return bool(beyond), new

    def _sentence(self, end: str, share: float, index: int) -> str:
        low, high = self._bounds
        return (
            f"The disparity range from {low:.3g} to {high:.3g} px per view step is too small for what comes: "
            f"{100 * share:.0f} % of the map of frame {index} lies at its {end} end; move that end further out."
        )
