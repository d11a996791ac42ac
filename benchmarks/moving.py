"""Films of the moving scene with their truth and their true motion, for all benchmarks of streams."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import cases
from benchmarks.cases import Case
from benchmarks.errors import BenchmarkError
from lfgpu import scenes
from lfgpu.contract import Float32Array
from lfgpu.data import LightField
from lfgpu.threads import get_threads

RANGE = (-1.5, 1.5)
BORDER = 15  # pixels, as in the benchmark's metrics


@dataclass(frozen=True)
class Film:
    """`count` frames of the scene, of `period` that go round once; so things move 240 / period times as fast as by
    default, where the fastest moves by 1 pixel a frame in views of 375 pixels.
    """

    grid: tuple[int, int]
    size: tuple[int, int]
    count: int
    period: int = 240
    noise: float = 0.005
    seed: int = 0

    @classmethod
    def of(cls, name: str, count: int, **options: Any) -> Film:
        """Return a film of views of a case; BenchmarkError if that has a span, as things move within `RANGE`."""
        case = cases.parse(name)
        if case.span != Case.span:
            raise BenchmarkError(f"{name!r} has @SPAN, but films always span {Case.span:g} px; leave it out.")
        return cls(case.grid, case.size, count, **options)

    @property
    def options(self) -> dict[str, Any]:
        """The options that all functions of `scenes` take."""
        return {"seed": self.seed, "grid": self.grid, "size": self.size, "disparity_range": RANGE}

    def frames(self) -> list[LightField]:
        """Cast all frames; each process makes some."""
        indices = range(self.count)
        with ProcessPoolExecutor(min(get_threads(), self.count), mp_context=get_context("spawn")) as pool:
            return list(pool.map(_frame, [self] * self.count, indices))

    def motions(self) -> Iterator[Motion]:
        """Yield the motion from each frame to the next."""
        middle = self.grid[0] // 2, self.grid[1] // 2
        ends = [
            scenes.true_motion(*middle, (i / self.period, (i + 1) / self.period), **self.options)
            for i in range(self.count)
        ]
        for index, (moves, owner) in enumerate(ends[:-1]):
            yield Motion.between(moves, owner, ends[index + 1][1])


class Motion(NamedTuple):
    """Motion of the pixels, and which of them count."""

    moves: NDArray[np.float64]  # [3, y, x]: right, down, disparity
    counts: NDArray[np.bool_]  # [y, x]: the same surface before and after, with all of its neighbours

    @classmethod
    def between(cls, moves: NDArray[np.float64], owner: NDArray[np.intp], later: NDArray[np.intp]) -> Motion:
        """Count a pixel if it and its neighbours show one thing, and so do the 4 x 4 pixels around its later place."""
        height, width = owner.shape
        y, x = np.mgrid[:height, :width]
        left, top = (np.floor(place).astype(int) for place in (x + moves[0], y + moves[1]))
        counts = (left >= 1) & (top >= 1) & (left < width - 2) & (top < height - 2)
        counts[:BORDER] = counts[-BORDER:] = False
        counts[:, :BORDER] = counts[:, -BORDER:] = False
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                counts &= np.roll(owner, (dy, dx), (0, 1)) == owner
        for dy in range(-1, 3):
            for dx in range(-1, 3):
                counts &= later[(top + dy).clip(0, height - 1), (left + dx).clip(0, width - 1)] == owner
        return cls(moves, counts)

    def flicker(self, before: Float32Array, after: Float32Array) -> NDArray[np.float64]:
        """Measure |change of the map along the true motion, less the true change| where pixels count, px per step."""
        y, x = np.nonzero(self.counts)
        dx, dy, dd = self.moves[:, y, x]
        left, top = np.floor(x + dx).astype(int), np.floor(y + dy).astype(int)
        ax, ay = x + dx - left, y + dy - top
        upper = (1 - ax) * after[top, left] + ax * after[top, left + 1]
        lower = (1 - ax) * after[top + 1, left] + ax * after[top + 1, left + 1]
        return np.abs((1 - ay) * upper + ay * lower - before[y, x] - dd)

    def still(self) -> NDArray[np.bool_]:
        """Tell which of the pixels that count do not move."""
        return np.asarray((self.moves == 0).all(0)[self.counts])


def to_and_fro(frames: Sequence[Any]) -> Iterator[Any]:
    """Yield frames forwards and backwards for ever, without a jump."""
    while True:
        yield from frames
        yield from frames[-2:0:-1]


def _frame(film: Film, index: int) -> LightField:
    return scenes.make("moving", time=index / film.period, noise=film.noise, **film.options)
