"""The layout of views: where their cameras stand and how they are stored, without their pixels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError

PATTERNS = ("full", "star", "cross", "row", "column")
"""Names of view patterns for `LightField.subset`.

full: all views. star: the row, the column and both diagonals through the reference view. cross: its row and its column.
row and column: one of them.
"""

_LINE_TOLERANCE = 0.1  # view steps: measured cameras are not exactly in line


@dataclass(frozen=True, eq=False)
class ViewLayout:
    """Views [n, y, x, c] of one scene without their pixels; `LightField.layout` gives that of a light field.

    Plans, view rules and the memory of an estimate depend on the layout alone. A subset copies nothing.
    """

    offsets: NDArray[np.float64]  # float64 [n, 2], (du, dv) of each view from the reference view, in view steps
    reference: int  # index of the reference view
    size: tuple[int, int]  # (height, width) of each view in pixels
    channels: int  # 1 for grey, 3 for colour
    dtype: np.dtype[Any]  # of the stored values: uint8, uint16 or float32
    scale: float  # factor from stored values to intensities in [0, 1]
    masks: tuple[NDArray[np.bool_], ...] | None = None
    """A mask [y, x] for each view, False at unusable pixels; None: all are valid."""
    name: str = "light field"  # of the scene, in messages

    @property
    def count(self) -> int:
        """The number of views."""
        return len(self.offsets)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """The shape [n, y, x, c] of the views."""
        return (self.count, *self.size, self.channels)

    @property
    def farthest(self) -> float:
        """The largest distance of a view from the reference view, along u or v, in view steps."""
        return farthest(self.offsets)

    def is_like(self, other: Self) -> bool:
        """Compare with another layout: equal cameras, reference view, size, stored type, scale and masks."""
        kind, of_other = ((one.shape, one.reference, one.dtype, one.scale) for one in (self, other))
        if kind != of_other or not np.array_equal(self.offsets, other.offsets):
            return False
        if self.masks is None or other.masks is None:
            return self.masks is other.masks
        return all(map(np.array_equal, self.masks, other.masks))

    def row(self) -> NDArray[np.intp]:
        """Indices of the views in the reference view's row (same v within 0.1 view steps), from left to right."""
        return self._line(axis=0)

    def column(self) -> NDArray[np.intp]:
        """Indices of the views in the reference view's column (same u within 0.1 view steps), from top to bottom."""
        return self._line(axis=1)

    def pattern(self, name: str) -> NDArray[np.bool_]:
        """Membership of each view in one of the `PATTERNS` through the reference view, bool [n]."""
        return in_pattern(self.offsets, name)

    def chosen(self, which: str | Sequence[int] | NDArray[Any]) -> NDArray[np.intp]:
        """Find the indices of the views that a subset keeps, in order; the reference view is always kept.

        `which` is one of the `PATTERNS` through the reference view, indices of views, or a mask bool [n].
        LightFieldError if fewer than two views remain, or an index or pattern is unknown.
        """
        if isinstance(which, str):
            keep = self.pattern(which)
        else:
            wanted = np.asarray(which)
            if wanted.size == 0:
                wanted = np.zeros(0, np.intp)
            is_mask = wanted.dtype == np.bool_ and wanted.shape == (self.count,)
            if not is_mask and (wanted.ndim != 1 or wanted.dtype.kind not in "iu"):
                raise LightFieldError(
                    f"views must be a pattern ({', '.join(PATTERNS)}), indices, or a mask bool [{self.count}]; found "
                    f"{which!r:.60}."
                )
            if not is_mask and wanted.size and not (wanted.min() >= 0 and wanted.max() < self.count):
                raise LightFieldError(f"view indices must be from 0 to {self.count - 1}; found {wanted.tolist()}.")
            keep = np.zeros(self.count, np.bool_)
            keep[wanted] = True
        keep[self.reference] = True
        if keep.sum() < 2:
            raise LightFieldError(
                f"{self.name}: the subset {which!r} leaves the reference view alone; choose more views."
            )
        return np.flatnonzero(keep)

    def subset(self, which: str | Sequence[int] | NDArray[Any]) -> Self:
        """Return the layout of some of the views; parameters and errors are those of `chosen`."""
        kept = self.chosen(which)
        if len(kept) == self.count:
            return self
        return replace(
            self,
            offsets=self.offsets[kept],
            reference=int(np.searchsorted(kept, self.reference)),
            masks=None if self.masks is None else tuple(self.masks[index] for index in kept),
        )

    def crop(self, y: slice, x: slice) -> Self:
        """Return the layout of a window of all views, with bounds inside of them."""
        masks = None if self.masks is None else tuple(mask[y, x] for mask in self.masks)
        return replace(self, size=(y.stop - y.start, x.stop - x.start), masks=masks)

    def _line(self, axis: int) -> NDArray[np.intp]:
        on_line = np.flatnonzero(np.abs(self.offsets[:, 1 - axis]) < _LINE_TOLERANCE)
        return on_line[np.argsort(self.offsets[on_line, axis])]


def in_pattern(offsets: NDArray[np.float64], name: str) -> NDArray[np.bool_]:
    """Membership of the views at `offsets` [n, 2] in one of the `PATTERNS` through the reference view, bool [n]."""
    du, dv = np.abs(offsets).T
    in_row, in_column = dv < _LINE_TOLERANCE, du < _LINE_TOLERANCE
    match name:
        case "full":
            return np.ones(len(offsets), np.bool_)
        case "star":
            return in_row | in_column | (np.abs(du - dv) < _LINE_TOLERANCE)
        case "cross":
            return in_row | in_column
        case "row":
            return in_row
        case "column":
            return in_column
    raise LightFieldError(f"unknown view pattern {name!r}; use one of {', '.join(PATTERNS)}.")


def farthest(offsets: NDArray[np.float64]) -> float:
    """Return the largest distance of views at `offsets` [n, 2] from the reference view, along u or v, in view steps."""
    return float(np.abs(offsets).max())
