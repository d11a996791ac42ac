"""Whether the disparity range of a stream is too small for what comes.

Maps are clamped to the range, so surfaces beyond it lie exactly at one of its ends. In a range that holds the scene
hardly any pixel does.
"""

from __future__ import annotations

from lfgpu.contract import Float32Array

SHARE = 0.01
"""Share of the pixels at one end of the range from which on it counts as too small."""

_END = 1e-3  # of the width of the range: what is so near to an end lies at it
_SAMPLES = 128  # along each side of the map


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
        samples = disparity[:: max(1, disparity.shape[0] // _SAMPLES), :: max(1, disparity.shape[1] // _SAMPLES)]
        low, high = self._bounds
        close = _END * (high - low)
        shares = {"far": float((samples <= low + close).mean()), "near": float((samples >= high - close).mean())}
        beyond = {end: share for end, share in shares.items() if share >= SHARE}
        new = tuple(self._sentence(end, share, index) for end, share in beyond.items() if end not in self._said)
        self._said |= dict(zip((end for end in beyond if end not in self._said), new, strict=True))
        return bool(beyond), new

    def _sentence(self, end: str, share: float, index: int) -> str:
        low, high = self._bounds
        return (
            f"The disparity range from {low:.3g} to {high:.3g} px per view step is too small for what comes: "
            f"{100 * share:.0f} % of the map of frame {index} lies at its {end} end; move that end further out."
        )
