"""A lattice of microlenses on the sensor: hexagonal or square, regular, or drawn out towards one side."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError


@dataclass(frozen=True, eq=False)
class Microlenses:
    """The centres of microlenses: lens k of row l is at origin + (k * along + l * down) / (1 + k * p + l * q)."""

    origin: NDArray[np.float64]  # centre (x, y) of lens (0, 0) in pixels; the middle of the first pixel is (0, 0)
    along: NDArray[np.float64]  # step to the next lens of the row at the origin; nearest to the direction of x
    down: NDArray[np.float64]  # step to a lens of the next row; in a hexagonal lattice half a pitch further on
    square: bool = False  # True if rows and columns of lenses are at right angles; else hexagonal
    slant: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))

    @property
    def pitch(self) -> float:
        """Distance of neighbours in a row at the origin, pixels."""
        return math.hypot(*self.along)

    @property
    def rotation(self) -> float:
        """Of the rows against the x axis, radians, positive from x to y."""
        return math.atan2(self.along[1], self.along[0])

    @property
    def axes(self) -> NDArray[np.float64]:
        """[2, 2], unit vectors (x, y) along the rows and across them, downwards."""
        x = self.along / self.pitch
        return np.array([x, [-x[1], x[0]]])

    @property
    def row_distance(self) -> float:
        """Distance of neighbouring rows at the origin, pixels: sqrt(3) / 2 pitches in an equilateral lattice."""
        return float(self.down @ self.axes[1])

    def centres(self, k: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (x, y) of lenses [..., 2]; `k` and `row` may be fractions."""
        steps = k[..., None] * self.along + row[..., None] * self.down
        if not self.slant.any():
            return self.origin + steps
        return self.origin + steps / (1 + k * self.slant[0] + row * self.slant[1])[..., None]

    def places(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return (k, row) as fractions of pixels at the columns `x` [w] and rows `y` [h]: two arrays [h, w]."""
        if not self.slant.any():
            inverse = np.linalg.inv(np.stack([self.along, self.down], axis=1)).astype(np.float32)
            shift = (inverse @ self.origin).astype(np.float32)
            k = inverse[0, 0] * x + (inverse[0, 1] * y - shift[0])[:, None]
            return k, inverse[1, 0] * x + (inverse[1, 1] * y - shift[1])[:, None]
        # k (along - p D) + row (down - q D) = D, where D is the way from the origin.
        dx, dy = x.astype(np.float64) - self.origin[0], (y.astype(np.float64) - self.origin[1])[:, None]
        ax, ay = (self.along[i] - self.slant[0] * d for i, d in enumerate((dx, dy)))
        bx, by = (self.down[i] - self.slant[1] * d for i, d in enumerate((dx, dy)))
        area = ax * by - bx * ay
        return ((dx * by - bx * dy) / area).astype(np.float32), ((ax * dy - dx * ay) / area).astype(np.float32)

    def nearest(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return (k, row) of the lens nearest to each pixel at columns `x` [w] and rows `y` [h]: two arrays [h, w]."""
        k, row = self.places(x, y)
        if self.square:
            return np.rint(k).astype(np.int32), np.rint(row).astype(np.int32)
        # Rounding of cube coordinates, k + row + rest = 0: of the three the one that was off the most is corrected.
        whole_k, whole_row, whole_rest = np.rint(k), np.rint(row), np.rint(-k - row)
        off_k, off_row, off_rest = np.abs(whole_k - k), np.abs(whole_row - row), np.abs(whole_rest + k + row)
        fix_k = (off_k > off_row) & (off_k > off_rest)
        fix_row = ~fix_k & (off_row > off_rest)
        return (
            np.where(fix_k, -whole_row - whole_rest, whole_k).astype(np.int32),
            np.where(fix_row, -whole_k - whole_rest, whole_row).astype(np.int32),
        )

    def inside(self, shape: tuple[int, ...], margin: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (k, row), [n] each, of the lenses with centres at least `margin` pixels within a picture [y, x]."""
        height, width = shape[:2]
        k, row = self.places(np.array([0, width - 1], np.float32), np.array([0, height / 2, height - 1], np.float32))
        spans = [np.arange(math.floor(a.min()) - 1, math.ceil(a.max()) + 2) for a in (k, row)]
        ks, rows = (grid.ravel() for grid in np.meshgrid(*spans))
        x, y = self.centres(ks.astype(np.float64), rows.astype(np.float64)).T
        there = (x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin)
        return ks[there], rows[there]

    def transposed(self) -> Microlenses:
        """Return the lattice of the transposed picture; its rows may no longer be those nearest to x."""
        return replace(self, origin=self.origin[::-1], along=self.along[::-1], down=self.down[::-1])

    def near(self, point: NDArray[np.float64]) -> Microlenses:
        """Return the same lattice counted from the lens nearest to a point (x, y)."""
        k, row = (np.rint(a.astype(np.float64).ravel()) for a in self.places(*point.astype(np.float32)[:, None]))
        away = self.centres(k, row)[0] - self.origin
        scale = 1 + float(k[0] * self.slant[0] + row[0] * self.slant[1])
        return replace(
            self,
            origin=self.origin + away,
            along=(self.along - self.slant[0] * away) / scale,
            down=(self.down - self.slant[1] * away) / scale,
            slant=self.slant / scale,
        )

    def reduced(self, *, name: str) -> Microlenses:
        """Return it by its shortest steps, along the row nearest to x or y, and down; finds out if it is square.

        LightFieldError, which names `name`, if it is neither square nor hexagonal.
        """
        basis = np.array([[*self.along, self.slant[0]], [*self.down, self.slant[1]]])
        steps = np.array([(i, j) for i in range(-3, 4) for j in range(-3, 4) if (i, j) != (0, 0)]) @ basis
        steps = steps[np.argsort(np.hypot(*steps[:, :2].T))]
        square = np.hypot(*steps[4, :2]) > _DIAGONAL * np.hypot(*steps[0, :2])
        shortest = steps[: 4 if square else 6]
        angles = np.degrees(np.arctan2(shortest[:, 1], shortest[:, 0]))
        off_axis = np.abs((angles + 45) % 90 - 45)
        limits = (-45, 45) if square else (-45, 135)
        candidates = [i for i in range(len(shortest)) if limits[0] < angles[i] <= limits[1]]
        if not candidates:
            raise LightFieldError(
                f"{name} shows a lattice of bright spots that is neither hexagonal nor square, as microlenses are."
            )
        chosen = min(candidates, key=lambda i: off_axis[i])
        # What turns from `along` towards larger y by about 60 or 90 degrees.
        turned = (angles - angles[chosen] + 180) % 360 - 180
        down = shortest[int(np.argmin(np.abs(turned - (90 if square else 60))))]
        slant = np.array([shortest[chosen, 2], down[2]])
        return Microlenses(self.origin, shortest[chosen, :2], down[:2], bool(square), slant)


_DIAGONAL = 1.2  # of the fifth step over the shortest: 1 in a hexagonal lattice, sqrt(2) in a square one
