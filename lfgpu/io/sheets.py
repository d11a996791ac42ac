"""One picture that holds many views: whether it shows them side by side, or a pixel of each under every microlens."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.io.parallax import SMALLEST, shrunk

_MOST = 32  # views along a side that are looked for
_ALIKE = 0.7  # correlation of neighbouring views; that of parts of one picture is 0.5 at most, as a rule
_ALIKE_PERHAPS = 0.4  # correlation of neighbouring views that move far, or one of which is upside down
_MORE = 0.2  # how much more than with half of a view in between
_SMALLEST = 8  # reduced pixels along the side of a view that is looked for

_LEAST, _LARGEST = 2, 32  # blocks that are looked for
_EXPLAINED = 0.25  # share of the variation of neighbouring differences that repeats with the blocks: 0.9 in real
# mosaics, 0.2 at most in pictures
_NEARLY = 0.85  # of the best share: multiples of the block explain as much as the block


def tiles_in(image: NDArray[Any], *, factor: int = 4) -> tuple[int, int] | None:
    """Find (rows, columns) of the views that a picture [y, x, c] shows side by side; None if it shows none, or does not
    tell how many.

    It is looked at `factor` times smaller, so that patterns of fewer pixels say nothing.
    """
    grey = shrunk(image.mean(axis=2, dtype=np.float64), factor) if min(image.shape[:2]) >= 4 * factor else None
    if grey is None:
        return None
    rows, columns = _count(grey, image.shape[0]), _count(grey.T, image.shape[1])
    return None if rows is None or columns is None or rows * columns == 1 else (rows, columns)


def _count(grey: NDArray[np.float64], side: int) -> int | None:
    """Find the largest number of parts of a picture along its first axis that look like their neighbours; 1 if none do,
    None if some may."""
    found: int | None = 1
    for count in range(min(_MOST, len(grey) // _SMALLEST), 1, -1):
        if side % count == 0:
            step = round(len(grey) / count)
            alike = _alike(grey, step)
            if alike < _ALIKE_PERHAPS or alike < _alike(grey, step // 2) + _MORE:  # smooth pictures resemble themselves
                continue
            if alike > _ALIKE:
                return None if _shows_views(grey[:step], side // count) else count
            found = None
    return found


def _shows_views(grey: NDArray[np.float64], side: int) -> bool:
    """Tell whether a part of a picture has parts along its first axis two of which are alike: others may be upside
    down."""
    for count in range(2, len(grey) // _SMALLEST + 1):
        step = len(grey) // count
        for start in range(0, len(grey) - 2 * step + 1, step) if side % count == 0 else ():
            pair = grey[start : start + 2 * step]
            if _alike(pair, step) > max(_ALIKE, _alike(pair, step // 2) + _MORE):
                return True
    return False


def _alike(grey: NDArray[np.float64], step: int) -> float:
    """Correlation of a picture with itself, moved along its first axis."""
    a, b = grey[:-step], grey[step:]
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1]) if a.std() > 0 and b.std() > 0 else 0.0


def block_in(image: NDArray[Any]) -> tuple[int | None, int | None]:
    """Find (rows, columns) of the block under a microlens: the smallest that divides a picture [y, x, c] and with which
    differences of neighbouring pixels repeat; None where they do not, as in some mosaics, or views are too small.
    """
    grey = image.mean(axis=2, dtype=np.float32)
    return _period(np.abs(np.diff(grey, axis=0)).mean(axis=1)), _period(np.abs(np.diff(grey)).mean(axis=0))


def _period(profile: NDArray[np.float32]) -> int | None:
    """Find the smallest period that explains nearly as much of a profile as the best one; None if that is little."""
    length = len(profile) + 1
    if length < SMALLEST * _LEAST or not profile.mean() > 0:
        return None
    # In logarithms, and without the mean of each cycle, so that the picture itself counts less.
    levels = np.append(np.log(profile + 1e-3 * profile.mean()), np.nan)
    explained = {}
    for period in range(_LEAST, _LARGEST + 1):
        if length % period == 0 and length >= SMALLEST * period:
            cycles = levels.reshape(-1, period)
            cycles = cycles - np.nanmean(cycles, axis=1, keepdims=True)
            share = float(np.nanmean(cycles, axis=0).var() / max(float(np.nanvar(cycles)), 1e-12))
            explained[period] = 1 - (1 - share) * len(cycles) / (len(cycles) - 1)  # of few cycles more is chance
    best = max(explained.values(), default=0.0)
    return None if best < _EXPLAINED else next(p for p, share in explained.items() if share >= _NEARLY * best)
