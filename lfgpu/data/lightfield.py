"""The light field: views of one scene, where their cameras stand, and which of them is the reference."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.data import hooks, interop, summary
from lfgpu.data.geometry import Geometry
from lfgpu.data.mapping import each_view
from lfgpu.errors import LightFieldError
from lfgpu.printable import printable

PATTERNS = ("full", "star", "cross", "row", "column")
"""Names that `LightField.subset` knows: all views; the reference's row, column and diagonals; row and column; one."""

_POSITION_TOLERANCE = 1e-6  # in view steps: what is nearer is the same place
_NEAREST = 1e-3  # in view steps, to which views must stand apart
_LINE_TOLERANCE = 0.1  # in view steps: measured cameras do not stand exactly in line
_FARTHEST = 1e6  # in view steps
_LONGEST_NAME = 300  # characters


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The true disparity of one view, for evaluation only: no estimate ever looks at it.

    Parameters
    ----------
    disparity
        float32 [y, x], pixels per view step, larger is nearer; NaN where it is not known.
    position
        (u, v) position of the view that it belongs to, as in `LightField.positions`.
    mask
        bool [y, x], True where a benchmark scores; None scores everywhere.
    """

    disparity: NDArray[np.float32]
    position: tuple[float, float]
    mask: NDArray[np.bool_] | None = None

    def __repr__(self) -> str:
        scored = "everywhere" if self.mask is None else f"on {self.mask.mean():.1%}"
        return (
            f"<GroundTruth of the view at {summary.view_at(self.position)}: {summary.pixels(self.disparity.shape)}\n "
            f"disparity {summary.span(self.disparity, summary.UNIT)}; scored {scored}>"
        )


@dataclass(frozen=True, eq=False)
class LightField:
    """Views of one scene from cameras that stand in one plane and look the same way.

    The point at (x, y) of the reference view is at (x - d*du, y - d*dv) in the view whose camera stands (du, dv) view
    steps to the right of and below the reference camera, where d is its disparity: larger d is nearer.

    Parameters
    ----------
    views
        [n, y, x, c] or [n, y, x], c = 1 or 3, uint8, uint16 or float32 in [0, 1]; kept as they came. n >= 2. They may
        be an array of another library (DLPack); one of a GPU is copied to the CPU, where a light field lives. Other
        views of its kind need not be: see `DepthPipeline.upload`.
    positions
        [n, 2], where each camera stands as (u, v): u to the right, v down, in view steps (units of the nominal
        baseline). In a grid these are column and row: methods that name a view take (row, column) = (v, u), as the
        command line does. All different. Where rows of cameras stand closer or farther than
        columns, or pixels are not square, v is scaled such that one disparity holds for both (`Geometry.positions`).
    reference
        Index of the view whose disparity is estimated; None takes the view nearest to the middle of the positions.
    grid_shape
        (rows, columns) where the positions are places in a grid, some of which may be empty; None for any array.
    valid
        bool [n, y, x], False where a view recorded nothing of use (vignetting, dead pixels); None is valid everywhere.
    geometry
        What turns disparity into metres; None if unknown.
    truth
        Ground truth of one view, for evaluation; None if unknown.
    name
        What to call the scene in messages; what is not printable in it is written out ("\\x1b").
    notes
        What a reader noticed about the files, one sentence each.
    files
        The image file of each view; empty where views have no files of their own.
    white
        Stored value that is intensity 1: 4095 where cameras of 12 bits fill uint16. Default None: the largest of the
        type. It means nothing for float32.

    Raises
    ------
    LightFieldError
        If shapes, dtypes, values or positions do not make a light field; the sentence says which.
    """

    views: NDArray[Any]
    positions: NDArray[np.float64]
    reference: int | None = None
    grid_shape: tuple[int, int] | None = None
    valid: NDArray[np.bool_] | None = None
    geometry: Geometry | None = None
    truth: GroundTruth | None = None
    name: str = "light field"
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    white: int | None = None

    def __post_init__(self) -> None:
        views = _array("views", self.views)
        if views.ndim == 3:
            views = views[..., None]
        if views.ndim != 4 or views.shape[3] not in (1, 3) or 0 in views.shape:
            raise LightFieldError(
                f"views must be [n, y, x] or [n, y, x, c] with c = 1 or 3, found shape {views.shape}."
            )
        if views.dtype not in (np.uint8, np.uint16, np.float32):
            raise LightFieldError(f"views must be uint8, uint16 or float32, found {views.dtype}; convert them first.")
        if len(views) < 2:
            raise LightFieldError(f"{self.name} has one view only; depth needs at least two views of the scene.")
        positions = _array("positions", self.positions, np.float64).copy()
        if positions.shape != (len(views), 2) or not (np.abs(positions) <= _FARTHEST).all():
            raise LightFieldError(
                f"positions must be {len(views)} finite pairs (u, v) within {_FARTHEST:g} view steps, one for each "
                f"view, found shape {positions.shape}."
            )
        _check_values(views, positions)
        _check_distinct(positions)
        reference = self.reference
        if reference is None:
            middle = (positions.min(0) + positions.max(0)) / 2
            reference = int(np.argmin(np.abs(positions - middle).sum(1)))
        if not isinstance(reference, Integral) or not 0 <= reference < len(views):
            raise LightFieldError(f"reference view {reference} does not exist: there are views 0 to {len(views) - 1}.")
        valid = None if self.valid is None else _array("valid", self.valid)
        if valid is not None and (valid.shape != views.shape[:3] or valid.dtype != np.bool_):
            raise LightFieldError(f"valid must be bool {views.shape[:3]}, found {valid.dtype} {valid.shape}.")
        if self.truth is not None:
            for values in (self.truth.disparity, self.truth.mask):
                if values is not None and values.shape != views.shape[1:3]:
                    raise LightFieldError(f"truth must be {views.shape[1:3]} as the views are, found {values.shape}.")
        if self.grid_shape is not None:
            _check_grid(positions, self.grid_shape)
        if self.white is not None and (not isinstance(self.white, Integral) or self.white < 1):
            raise LightFieldError(f"white must be a whole number of at least 1, not {self.white}.")
        if self.files and len(self.files) != len(views):
            raise LightFieldError(f"files must be one for each of {len(views)} views, found {len(self.files)}.")
        object.__setattr__(self, "name", printable(self.name, longest=_LONGEST_NAME))
        object.__setattr__(self, "notes", tuple(map(printable, self.notes)))
        object.__setattr__(self, "views", views)
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "reference", int(reference))
        object.__setattr__(self, "valid", valid)

    @classmethod
    def from_grid(cls, views: ArrayLike, *, vertical_step: float = 1.0, **fields: Any) -> LightField:
        """A light field of a full grid: `views` is [v, u, y, x, c] or [v, u, y, x]; `fields` as in `LightField`.

        The reference is the middle view, or for even counts the one right below and to the right of the middle.

        `vertical_step` is how far things move, in pixels, from row to row of the grid over how far they move from
        column to column: the distance of rows over that of columns, times the width of a pixel over its height. A
        disparity is that from column to column. If it is not 1, the view in grid row r stands at v = r * vertical_step,
        which is what `index_of` and messages mean by its row then, and `grid_shape` is None.
        """
        if not (math.isfinite(vertical_step) and vertical_step > 0):
            raise LightFieldError(f"vertical_step must be a positive number, not {vertical_step}.")
        grid = _array("views", views)
        if grid.ndim not in (4, 5):
            raise LightFieldError(f"a grid of views must be [v, u, y, x] or [v, u, y, x, c], found shape {grid.shape}.")
        rows, columns = grid.shape[:2]
        v, u = np.mgrid[:rows, :columns]
        fields.setdefault("reference", (rows // 2) * columns + columns // 2)
        return cls(
            grid.reshape(rows * columns, *grid.shape[2:]),
            np.stack([u.ravel(), vertical_step * v.ravel()], axis=1).astype(np.float64),
            grid_shape=(rows, columns) if vertical_step == 1 else None,
            **fields,
        )

    # --- what it is ---

    @property
    def reference_index(self) -> int:
        """Index of the reference view; `reference` with its default resolved."""
        assert self.reference is not None  # __post_init__ resolved it
        return self.reference

    @property
    def offsets(self) -> NDArray[np.float64]:
        """[n, 2], (du, dv) of each view from the reference view, in view steps."""
        return self.positions - self.positions[self.reference_index]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of each view in pixels."""
        return int(self.views.shape[1]), int(self.views.shape[2])

    @property
    def channels(self) -> int:
        """1 for grey, 3 for colour."""
        return int(self.views.shape[3])

    @property
    def scale(self) -> float:
        """What stored values are multiplied with to lie in [0, 1]."""
        return 1.0 if self.views.dtype == np.float32 else 1.0 / float(self.white or np.iinfo(self.views.dtype).max)

    @property
    def missing(self) -> tuple[tuple[int, int], ...]:
        """(row, column) of each empty place of the grid; empty where there is no grid."""
        if self.grid_shape is None:
            return ()
        present = {(round(v), round(u)) for u, v in self.positions}
        rows, columns = self.grid_shape
        return tuple((v, u) for v in range(rows) for u in range(columns) if (v, u) not in present)

    def reference_truth(self) -> GroundTruth | None:
        """The ground truth if it belongs to the reference view, else None."""
        if self.truth is None or self._find(*self.truth.position) != self.reference_index:
            return None
        return self.truth

    # --- looking at it ---

    def image(self, index: int) -> NDArray[np.float32]:
        """View `index` as float32 [y, x, c] in [0, 1]."""
        return self.views[index].astype(np.float32) * np.float32(self.scale)

    def view(self, row: float, column: float) -> NDArray[Any]:
        """The sub-aperture view at grid place (row, column), that is v and u, as it came: [y, x, c]."""
        return np.asarray(self.views[self.index_of(row, column)])

    def index_of(self, row: float, column: float) -> int:
        """Index of the view at position v = `row`, u = `column`; LightFieldError if there is none."""
        index = self._find(column, row)
        if index is None:
            raise LightFieldError(
                f"{self.name} has no view at row {row:g}, column {column:g}; "
                f"rows span {_span(self.positions[:, 1])}, columns {_span(self.positions[:, 0])}."
            )
        return index

    def row(self) -> NDArray[np.intp]:
        """Indices of the views in the reference's row (same v within 0.1 view steps), from left to right."""
        return self._line(axis=0)

    def column(self) -> NDArray[np.intp]:
        """Indices of the views in the reference's column (same u within 0.1 view steps), from top to bottom."""
        return self._line(axis=1)

    def pattern(self, name: str) -> NDArray[np.bool_]:
        """Which views, [n], lie in a pattern through the reference: "full", "star", "cross", "row" or "column"."""
        du, dv = np.abs(self.offsets).T
        in_row, in_column = dv < _LINE_TOLERANCE, du < _LINE_TOLERANCE
        match name:
            case "full":
                return np.ones(len(self.views), np.bool_)
            case "star":
                return in_row | in_column | (np.abs(du - dv) < _LINE_TOLERANCE)
            case "cross":
                return in_row | in_column
            case "row":
                return in_row
            case "column":
                return in_column
        raise LightFieldError(f"unknown view pattern {name!r}; known are {', '.join(PATTERNS)}.")

    def epi_horizontal(self, y: int) -> NDArray[Any]:
        """The epipolar plane image of image row `y` over the reference's row of views: [u, x, c]."""
        return np.asarray(self.views[self.row(), y])

    def epi_vertical(self, x: int) -> NDArray[Any]:
        """The epipolar plane image of image column `x` over the reference's column of views: [v, y, c]."""
        return np.asarray(self.views[self.column(), :, x])

    def __repr__(self) -> str:
        grid = "not in a grid"
        if self.grid_shape is not None:
            grid = f"in a grid of {self.grid_shape[0]} x {self.grid_shape[1]} (rows x columns)"
        u, v = (float(value) for value in self.positions[self.reference_index])
        truth = "none" if self.truth is None else f"of the view at {summary.view_at(self.truth.position)}"
        return (
            f"<LightField {self.name!r}: {len(self.views)} views {grid}, reference at {summary.view_at((u, v))}\n "
            f"{summary.pixels(self.size)}, {'grey' if self.channels == 1 else 'colour'}, {self.views.dtype}"
            f"{'' if self.valid is None else ', with masks'}; "
            f"depth in metres: {'no geometry' if self.geometry is None else 'yes'}; ground truth: {truth}>"
        )

    def _repr_html_(self) -> str:
        """What notebooks show."""
        return str(hooks.call("light_field_html", self))

    # --- other light fields from it ---

    def with_reference(self, index: int) -> LightField:
        """The same views with view `index` as the reference; use `index_of` to name it by row and column."""
        return replace(self, reference=index)

    def subset(self, which: str | Sequence[int]) -> LightField:
        """Some of the views: a pattern through the reference ("full", "star", "cross", "row", "column") or indices.

        The reference is always kept. LightFieldError if fewer than two views remain.
        """
        keep = self._chosen(which)
        if keep.all():
            return self
        return self._with_views(
            np.flatnonzero(keep), self.views[keep], None if self.valid is None else self.valid[keep]
        )

    def crop(self, y: slice, x: slice) -> LightField:
        """The same window of every view: `y` and `x` are slices of rows and columns of pixels, without a step."""
        height, width = self.size
        (top, bottom, y_step), (left, right, x_step) = y.indices(height), x.indices(width)
        if y_step != 1 or x_step != 1 or top >= bottom or left >= right:
            raise LightFieldError(f"crop {y}, {x} leaves nothing of the {height} x {width} views, or has a step.")
        window = np.s_[top:bottom, left:right]
        geometry, truth = self.geometry, self.truth
        if geometry is not None:
            cx, cy = geometry.principal_point or ((width - 1) / 2, (height - 1) / 2)
            geometry = replace(geometry, principal_point=(cx - left, cy - top))
        if truth is not None:
            mask = None if truth.mask is None else truth.mask[window]
            truth = replace(truth, disparity=truth.disparity[window], mask=mask)
        return replace(
            self,
            views=self.views[:, top:bottom, left:right],
            valid=None if self.valid is None else self.valid[:, top:bottom, left:right],
            geometry=geometry,
            truth=truth,
            files=(),
        )

    def downsampled(self, factor: int, *, which: str | Sequence[int] = "full") -> LightField:
        """A coarser pyramid level: means over `factor` x `factor` pixels as float32; disparities shrink by `factor`.

        A coarse pixel is valid where all its pixels are. Geometry and ground truth belong to full size and are left
        out, as are rows and columns that do not fill a block, and all views but those that `which` names, as for
        `subset`.
        """
        if not 1 <= factor <= min(self.size):
            raise LightFieldError(f"views of {self.size[0]} x {self.size[1]} pixels cannot be shrunk {factor} times.")
        height, width = (side // factor for side in self.size)
        chosen = np.flatnonzero(self._chosen(which))
        views = np.empty((len(chosen), height, width, self.channels), np.float32)

        def shrink(place: int, view: NDArray[Any]) -> None:
            # Whole rows and then columns are added: a mean over blocks goes through memory a pixel at a time.
            blocks = view[: height * factor].reshape(height, factor, -1, self.channels)
            rows = np.add.reduce(blocks, axis=1, dtype=np.float32)[:, : width * factor]
            np.einsum("yxkc->yxc", rows.reshape(height, width, factor, -1), out=views[place])
            views[place] *= np.float32(self.scale / factor**2)

        each_view(self.views, chosen.tolist(), shrink)
        valid = None
        if self.valid is not None:
            cut = self.valid[chosen, : height * factor, : width * factor]
            valid = np.asarray(cut.reshape(len(cut), height, factor, width, factor).all(axis=(2, 4)))
        return self._with_views(chosen, views, valid, geometry=None, truth=None, files=())

    # --- helpers ---

    def _chosen(self, which: str | Sequence[int]) -> NDArray[np.bool_]:
        """Whether each view is one of those that `subset` leaves."""
        if isinstance(which, str):
            keep = self.pattern(which)
        else:
            wanted = np.asarray(which, np.int64)
            if wanted.size and not (wanted.min() >= 0 and wanted.max() < len(self.views)):
                raise LightFieldError(f"view indices must be 0 to {len(self.views) - 1}, found {wanted.tolist()}.")
            keep = np.zeros(len(self.views), np.bool_)
            keep[wanted] = True
        keep[self.reference_index] = True
        if keep.sum() < 2:
            raise LightFieldError(
                f"{self.name}: the subset {which!r} leaves the reference view alone; take more views."
            )
        return keep

    def _with_views(
        self, chosen: NDArray[np.intp], views: NDArray[Any], valid: NDArray[np.bool_] | None, **others: Any
    ) -> LightField:
        """With these views in the place of the chosen ones, without all others, and with other fields changed."""
        fields = {
            "positions": self.positions[chosen],
            "reference": int((chosen < self.reference_index).sum()),
            "files": tuple(self.files[index] for index in chosen) if self.files else (),
        }
        return replace(self, views=views, valid=valid, **{**fields, **others})

    def _find(self, u: float, v: float) -> int | None:
        found = np.flatnonzero(np.abs(self.positions - (u, v)).max(1) < _POSITION_TOLERANCE)
        return int(found[0]) if len(found) else None

    def _line(self, axis: int) -> NDArray[np.intp]:
        on_line = np.flatnonzero(np.abs(self.offsets[:, 1 - axis]) < _LINE_TOLERANCE)
        return on_line[np.argsort(self.positions[on_line, axis])]


def check_light_field(lf: object) -> None:
    """LightFieldError that says how to make one if `lf` is no `LightField`, but an array or a path."""
    if isinstance(lf, LightField):
        return
    if isinstance(lf, (str, os.PathLike)):
        remedy = f"read it first: lfgpu.read({os.fspath(lf)!r})"
    else:
        remedy = "make one first: lfgpu.LightField.from_grid(views) of [v, u, y, x, c], or lfgpu.read(path)"
    shape = getattr(lf, "shape", None)
    found = f"{type(lf).__name__}{'' if shape is None else f' of shape {tuple(shape)}'}"
    raise LightFieldError(f"lf must be a LightField, found {found}; {remedy}.")


def farthest(offsets: NDArray[np.float64]) -> float:
    """How far the farthest view is from the reference in u or in v, view steps."""
    return float(np.abs(offsets).max())


def _array(name: str, values: Any, dtype: Any = None) -> NDArray[Any]:
    if hasattr(values, "__dlpack__") or hasattr(values, "__cuda_array_interface__"):
        values = interop.on_host(name, values)
    try:
        return np.asarray(values, dtype)
    except (TypeError, ValueError) as error:
        raise LightFieldError(f"{name} must be one array of numbers: {error}.") from error


def _check_values(views: NDArray[Any], positions: NDArray[np.float64]) -> None:
    if views.dtype != np.float32:
        return

    def check(index: int, view: NDArray[Any]) -> None:
        low, high = float(view.min()), float(view.max())
        where = f"view {index} (row {positions[index, 1]:g}, column {positions[index, 0]:g})"
        if not np.isfinite(low + high):
            raise LightFieldError(f"{where} has NaN or infinite values; float views must be finite.")
        if low < -0.5 or high > 1.5:  # resampling may overshoot a little; other units are far off
            raise LightFieldError(f"{where} spans {low:g} to {high:g}; float views must be scaled to [0, 1].")

    each_view(views, range(len(views)), check)


def _check_distinct(positions: NDArray[np.float64]) -> None:
    rounded = np.round(positions / _POSITION_TOLERANCE).astype(np.int64)
    unique, counts = np.unique(rounded, axis=0, return_counts=True)
    if len(unique) < len(positions):
        u, v = unique[counts > 1][0] * _POSITION_TOLERANCE
        raise LightFieldError(f"two views stand at row {v:g}, column {u:g}; positions must be different.")
    from scipy.spatial import cKDTree  # only here: it takes a while to load

    distances = cKDTree(positions).query(positions, k=2)[0][:, 1]
    if not distances.min() > _NEAREST:  # what is nearer than that to the reference tells nothing of depth
        raise LightFieldError(
            f"two views stand {distances.min():g} view steps apart, near row {positions[distances.argmin(), 1]:g}, "
            f"column {positions[distances.argmin(), 0]:g}; positions are in units of the distance of neighbours."
        )


def _check_grid(positions: NDArray[np.float64], grid_shape: tuple[int, int]) -> None:
    places = np.round(positions)
    last = (grid_shape[1] - 1, grid_shape[0] - 1)
    if np.abs(positions - places).max() > _POSITION_TOLERANCE or (places < 0).any() or (places > last).any():
        raise LightFieldError(
            f"positions must be places in the grid of {grid_shape[0]} x {grid_shape[1]} views, whole numbers from 0; "
            f"found rows {_span(positions[:, 1])} and columns {_span(positions[:, 0])}."
        )


def _span(values: NDArray[np.float64]) -> str:
    return f"{values.min():g} to {values.max():g}"
