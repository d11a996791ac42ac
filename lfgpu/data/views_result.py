"""The result of `estimate_all_views`."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu import hooks
from lfgpu.contract import Float32Array
from lfgpu.data import summary
from lfgpu.data.geometry import Geometry
from lfgpu.data.light_field_checks import check_whole
from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.errors import LightFieldError

_SAME_PLACE = 1e-6  # view steps: positions that differ by less are equal


@dataclass(frozen=True, eq=False)
class ViewsResult(summary.InNotebooks):
    """Disparity maps of all views of a light field.

    Parameters
    ----------
    disparities
        float32 [n, y, x], in the order of `LightField.views`, pixels per view step; larger is nearer. The point at
        (x, y) of view a is at (x - d*du, y - d*dv) in the view that is du steps to the right of and dv steps below a.
        NaN where no key view shows the point; `lfgpu.fill_unknown` fills such holes.
    confidences
        float32 [n, y, x], 0 to 1: the mean confidence of the key views that agree, times their share among those that
        agree or see through. 0 where the disparity is NaN.
    positions
        float64 [n, 2], (u, v) of each view, as `LightField.positions`.
    keys
        Indices of the key views, which were estimated directly; the first is the reference view.
    reference
        The estimate of the reference view, as from `estimate_depth`, with its stages, status and parameters. Its map is
        that before the other key views were joined.
    timings
        Seconds: `keys` for the key views, `join` for the maps of all views, `total`.
    """

    disparities: Float32Array
    confidences: Float32Array
    positions: NDArray[np.float64]
    keys: tuple[int, ...]
    reference: DepthResult
    timings: dict[str, float]

    def __repr__(self) -> str:
        about = self.reference
        size = summary.pixels(self.disparities.shape[1:])
        return (
            f"<ViewsResult {about.name!r}: maps of {len(self.disparities)} views, {size}\n "
            f"disparity {summary.span(self.disparities, summary.UNIT)}; "
            f"confidence {np.nanmean(self.confidences):.2f} on average\n "
            f"{about.config.method} with {about.backend} on {about.device}, {len(self.keys)} key views, "
            f"{self.timings.get('total', np.nan):.3g} s>"
        )

    def index_of(self, row: float, column: float) -> int:
        """Index of the view at position v = `row`, u = `column`; LightFieldError if there is none."""
        distance = np.abs(self.positions - (column, row)).max(1)
        if not distance.min() < _SAME_PLACE:
            raise LightFieldError(
                f"there is no map of a view at row {row:g}, column {column:g}; give the position of a view."
            )
        return int(np.argmin(distance))

    def map(self, index: int) -> DisparityMap:
        """Return the map of view `index`, with its metadata."""
        check_whole("index of a view", index, -len(self.disparities), len(self.disparities) - 1)
        u, v = (float(value) for value in self.positions[index])
        about = self.reference
        return DisparityMap(
            self.disparities[index],
            self.confidences[index],
            position=(u, v),
            geometry=about.geometry,
            name=about.name,
            versions=about.versions,
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all maps as .npz; see `lfgpu.save`."""
        hooks.save(self, path)

    @property
    def geometry(self) -> Geometry | None:
        """The camera geometry, the same for all views; None if unknown."""
        return self.reference.geometry

    @property
    def depths(self) -> NDArray[np.float32] | None:
        """Metric depth in metres, float32 [n, y, x], infinity beyond the horizon; None without a geometry."""
        return None if self.geometry is None else self.geometry.depth(self.disparities).astype(np.float32)
