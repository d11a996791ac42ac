"""The light field: views of one scene, the positions of their cameras, and the reference view."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.data import summary
from lfgpu.data.geometry import Geometry
from lfgpu.data.layout import ViewLayout
from lfgpu.data.light_field_checks import (
    POSITION_TOLERANCE,
    array_of_numbers,
    check_distinct,
    check_grid,
    check_number,
    check_values,
    check_whole,
    span,
    texts,
    without_mask,
)
from lfgpu.data.mapping import check_unchanged, each_view
from lfgpu.data.reading import NOTHING, Reading
from lfgpu.errors import LightFieldError
from lfgpu.printable import printable

_FARTHEST = 1e6  # view steps: the largest coordinate of a position
_LONGEST_NAME = 300  # characters


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The true disparity of one view. It is used for evaluation only, never by an estimate.

    Parameters
    ----------
    disparity
        float32 [y, x], pixels per view step; larger is nearer; NaN where unknown.
    position
        (u, v) position of the view that it belongs to, as in `LightField.positions`.
    mask
        bool [y, x], True at scored pixels. Default None: all pixels are scored.

    Raises
    ------
    LightFieldError
        If a value has another shape or type than above.

    Examples
    --------
    >>> lfgpu.GroundTruth(np.zeros((64, 80), np.float32), position=(2.0, 2.0)).disparity.mean()
    np.float32(0.0)
    """

    disparity: NDArray[np.float32]
    position: tuple[float, float]
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        disparity = array_of_numbers("disparity", self.disparity, np.float32)
        if disparity.ndim != 2 or disparity.size == 0:
            raise LightFieldError(f"disparity must be [y, x], found shape {disparity.shape}.")
        position = array_of_numbers("position", self.position, np.float64)
        if position.shape != (2,) or not (np.abs(position) <= _FARTHEST).all():
            raise LightFieldError(f"position must be a pair of numbers (u, v), not {self.position!r:.60}.")
        mask = None if self.mask is None else array_of_numbers("mask", self.mask)
        if mask is not None and (mask.shape != disparity.shape or mask.dtype != np.bool_):
            raise LightFieldError(f"mask must be bool {disparity.shape}, found {mask.dtype} {mask.shape}.")
        for name, value in (("disparity", disparity), ("position", tuple(position.tolist())), ("mask", mask)):
            object.__setattr__(self, name, value)

    @property
    def scored(self) -> NDArray[np.float32]:
        """The true disparity [y, x], pixels per view step; NaN where it is unknown or not scored."""
        return self.disparity if self.mask is None else np.where(self.mask, self.disparity, np.float32(np.nan))

    def __repr__(self) -> str:
        scored = "everywhere" if self.mask is None else f"on {self.mask.mean():.1%}"
        return (
            f"<GroundTruth of the view at {summary.view_at(self.position)}: {summary.pixels(self.disparity.shape)}\n "
            f"disparity {summary.span(self.disparity, summary.UNIT)}; scored {scored}>"
        )


@dataclass(frozen=True, eq=False)
class LightField(summary.InNotebooks):
    """Views of one scene from parallel cameras in one plane.

    A point at (x, y) of the reference view with disparity d is at (x - d*du, y - d*dv) in the view whose camera is du
    view steps to the right of and dv below the reference camera. Larger d is nearer.

    Parameters
    ----------
    views
        [n, y, x, c] or [n, y, x], n >= 2, c = 1 or 3, uint8, uint16 or float32 in [0, 1]; stored as given. What a NumPy
        masked array masks is not `valid`. An array of
        another library (DLPack) is accepted; from a GPU it is copied to the CPU. `DepthPipeline.upload` takes views on
        a GPU without that copy.
    positions
        [n, 2], the position (u, v) of each camera: u to the right, v down, in view steps (units of the nominal
        baseline). In a grid these are column and row: methods that name a view take (row, column) = (v, u), as the
        command line does. All different. Where rows of cameras stand closer or farther than
        columns, or pixels are not square, v is scaled such that one disparity holds for both (`Geometry.positions`).
    reference
        Index of the reference view, whose disparity is estimated. Default None: the view nearest to the middle of the
        positions.
    grid_shape
        (rows, columns) if the positions are places of a grid, some of which may be empty. Default None: not a grid.
    valid
        bool [n, y, x], False at unusable pixels (vignetting, dead pixels). Default None: all pixels are valid.
    geometry
        The camera geometry, which relates disparity to metric depth. Default None: unknown.
    truth
        Ground truth of one view, for evaluation. Default None: unknown.
    name
        What to call the scene in messages; what is not printable in it is written out ("\\x1b").
    notes
        Remarks of the reader about the files, one sentence each.
    files
        The image file of each view; empty where views have no files of their own.
    white
        Stored value that is intensity 1: 4095 where cameras of 12 bits fill uint16. Default None: the largest of the
        type. It means nothing for float32.
    reading
        What the reader took for what, and why. Default: nothing was read.

    Raises
    ------
    LightFieldError
        If shapes, dtypes, values or positions are wrong; the message says which.

    Examples
    --------
    >>> views = np.random.default_rng(0).random((6, 32, 40, 3), np.float32)
    >>> positions = np.array([(u, v) for v in range(2) for u in range(3)], float)
    >>> mine = lfgpu.LightField(views, positions, reference=1, name="mine")
    >>> mine.size, mine.offsets[0].tolist()
    ((32, 40), [-1.0, 0.0])
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
    reading: Reading = NOTHING

    def __post_init__(self) -> None:
        for name, kind in (("name", str), ("geometry", Geometry), ("truth", GroundTruth), ("reading", Reading)):
            value = getattr(self, name)
            if not isinstance(value, kind) and not (value is None and name in ("geometry", "truth")):
                raise LightFieldError(f"{name} must be a {kind.__name__}, not {type(value).__name__}.")
        given, masked = without_mask(self.views, self.valid)
        views = array_of_numbers("views", given)
        check_unchanged(views)
        if views.ndim == 3:
            views = views[..., None]
        if views.ndim != 4 or views.shape[3] not in (1, 3) or 0 in views.shape:
            raise LightFieldError(
                f"views must be [n, y, x] or [n, y, x, c] with c = 1 or 3; found shape {views.shape}."
            )
        if views.dtype not in (np.uint8, np.uint16, np.float32):
            raise LightFieldError(f"views must be uint8, uint16 or float32; found {views.dtype}; convert them first.")
        if len(views) < 2:
            raise LightFieldError(f"{self.name} has a single view, but depth needs at least two views of the scene.")
        positions = array_of_numbers("positions", self.positions, np.float64).copy()
        if positions.shape != (len(views), 2) or not (np.abs(positions) <= _FARTHEST).all():
            raise LightFieldError(
                f"positions must be {len(views)} finite pairs (u, v) within {_FARTHEST:g} view steps, one for each "
                f"view; found shape {positions.shape}."
            )
        check_values(views, positions)
        check_distinct(positions)
        reference = self.reference
        if reference is None:
            middle = (positions.min(0) + positions.max(0)) / 2
            reference = int(np.argmin(np.abs(positions - middle).sum(1)))
        if not isinstance(reference, Integral) or not 0 <= reference < len(views):
            raise LightFieldError(
                f"reference view {reference} does not exist; give an index from 0 to {len(views) - 1}."
            )
        valid = None if masked is None else array_of_numbers("valid", masked)
        if valid is not None and (valid.shape != views.shape[:3] or valid.dtype != np.bool_):
            raise LightFieldError(f"valid must be bool {views.shape[:3]}; found {valid.dtype} {valid.shape}.")
        if self.truth is not None and self.truth.disparity.shape != views.shape[1:3]:
            raise LightFieldError(
                f"truth must be {views.shape[1:3]}, like the views; found {self.truth.disparity.shape}."
            )
        if self.grid_shape is not None:
            check_grid(positions, self.grid_shape)
        if self.white is not None:
            check_whole("white", self.white, 1, np.inf if views.dtype == np.float32 else np.iinfo(views.dtype).max)
        files = texts("files", self.files)
        if files and len(files) != len(views):
            raise LightFieldError(f"files must be one for each of {len(views)} views; found {len(files)}.")
        object.__setattr__(self, "name", printable(self.name, longest=_LONGEST_NAME))
        object.__setattr__(self, "notes", tuple(map(printable, texts("notes", self.notes))))
        object.__setattr__(self, "files", files)
        object.__setattr__(self, "views", views)
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "reference", int(reference))
        object.__setattr__(self, "valid", valid)

    @classmethod
    def from_grid(cls, views: ArrayLike, *, vertical_step: float = 1.0, **fields: Any) -> LightField:
        """Make a light field from a full grid of views.

        Parameters
        ----------
        views
            [v, u, y, x, c] or [v, u, y, x], otherwise as in `LightField`.
        vertical_step
            Parallax from row to row of the grid divided by that from column to column: the vertical camera spacing
            over the horizontal one, times the width of a pixel over its height; > 0, default 1. Disparity is that from
            column to column. If it is not 1, the view in grid row r is at v = r * vertical_step, which `index_of` and
            messages then call its row, and `grid_shape` is None.
        fields
            Other fields of `LightField`. The default reference is the middle view; for even counts it is the view just
            below and to the right of the middle.

        Raises
        ------
        LightFieldError
            As `LightField`.
        """
        check_number("vertical_step", vertical_step, np.finfo(float).tiny, np.finfo(float).max)
        grid = views if isinstance(views, np.ma.MaskedArray) else array_of_numbers("views", views)
        if grid.ndim not in (4, 5):
            raise LightFieldError(f"a grid of views must be [v, u, y, x] or [v, u, y, x, c]; found shape {grid.shape}.")
        if grid.ndim == 4 and grid.shape[-1] in (1, 3, 4):
            raise LightFieldError(
                f"{grid.shape} is the shape of a list of views [n, y, x, c], in which nothing says how many stand in a "
                "row; reshape it to a grid [v, u, y, x, c], or give the views and their positions to LightField."
            )
        rows, columns = grid.shape[:2]
        v, u = np.mgrid[:rows, :columns]
        fields.setdefault("reference", (rows // 2) * columns + columns // 2)
        return cls(
            grid.reshape(rows * columns, *grid.shape[2:]),
            np.stack([u.ravel(), vertical_step * v.ravel()], axis=1).astype(np.float64),
            grid_shape=(rows, columns) if vertical_step == 1 else None,
            **fields,
        )

    # --- properties ---

    @property
    def reference_index(self) -> int:
        """Index of the reference view; `reference` with its default resolved."""
        assert self.reference is not None  # __post_init__ resolved it
        return self.reference

    @property
    def layout(self) -> ViewLayout:
        """The light field without its pixels: all that plans and view rules depend on."""
        return ViewLayout(
            offsets=self.offsets,
            reference=self.reference_index,
            size=self.size,
            channels=self.channels,
            dtype=self.views.dtype,
            scale=self.scale,
            masks=None if self.valid is None else tuple(self.valid),
            name=self.name,
        )

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
        """Factor that brings stored values to [0, 1]."""
        return 1.0 if self.views.dtype == np.float32 else 1.0 / float(self.white or np.iinfo(self.views.dtype).max)

    @property
    def missing(self) -> tuple[tuple[int, int], ...]:
        """(row, column) of each missing view of the grid; empty without a grid."""
        if self.grid_shape is None:
            return ()
        present = {(round(v), round(u)) for u, v in self.positions}
        rows, columns = self.grid_shape
        return tuple((v, u) for v in range(rows) for u in range(columns) if (v, u) not in present)

    def reference_truth(self) -> GroundTruth | None:
        """Return the ground truth if it belongs to the reference view, else None."""
        if self.truth is None or self._find(*self.truth.position) != self.reference_index:
            return None
        return self.truth

    # --- views and EPIs ---

    def image(self, index: int) -> NDArray[np.float32]:
        """View `index` as float32 [y, x, c] in [0, 1]."""
        check_whole("index of a view", index, -len(self.views), len(self.views) - 1)
        check_unchanged(self.views)
        return self.views[index].astype(np.float32) * np.float32(self.scale)

    def view(self, row: float, column: float) -> NDArray[Any]:
        """Return the view at position v = `row`, u = `column`, as stored: [y, x, c]."""
        return np.asarray(self.views[self.index_of(row, column)])

    def index_of(self, row: float, column: float) -> int:
        """Index of the view at position v = `row`, u = `column`; LightFieldError if there is none."""
        check_number("row", row)
        check_number("column", column)
        index = self._find(column, row)
        if index is None:
            raise LightFieldError(
                f"{self.name} has no view at row {row:g}, column {column:g}; "
                f"rows span {span(self.positions[:, 1])}, columns {span(self.positions[:, 0])}."
            )
        return index

    def row(self) -> NDArray[np.intp]:
        """Indices of the views in the reference view's row (same v within 0.1 view steps), from left to right."""
        return self.layout.row()

    def column(self) -> NDArray[np.intp]:
        """Indices of the views in the reference view's column (same u within 0.1 view steps), from top to bottom."""
        return self.layout.column()

    def pattern(self, name: str) -> NDArray[np.bool_]:
        """Membership of each view in one of the `PATTERNS` through the reference view, bool [n]."""
        return self.layout.pattern(name)

    def epi_horizontal(self, y: int) -> NDArray[Any]:
        """Return the epipolar plane image [u, x, c] of image row `y`, from the reference view's row of views."""
        check_whole("row of pixels", y, -self.size[0], self.size[0] - 1)
        return np.asarray(self.views[self.row(), y])

    def epi_vertical(self, x: int) -> NDArray[Any]:
        """Return the epipolar plane image [v, y, c] of image column `x`, from the reference view's column of views."""
        check_whole("column of pixels", x, -self.size[1], self.size[1] - 1)
        return np.asarray(self.views[self.column(), :, x])

    def __repr__(self) -> str:
        grid = "not in a grid"
        if self.grid_shape is not None:
            grid = f"in a grid of {self.grid_shape[0]} x {self.grid_shape[1]} (rows x columns)"
        here = summary.view_at(self.positions[self.reference_index], self.positions)
        truth = "none" if self.truth is None else f"of the view at {summary.view_at(self.truth.position)}"
        return (
            f"<LightField {self.name!r}: {len(self.views)} views {grid}, reference at {here}\n "
            f"{summary.pixels(self.size)}, {'grey' if self.channels == 1 else 'colour'}, {self.views.dtype}"
            f"{'' if self.valid is None else ', with masks'}; "
            f"depth in metres: {'no geometry' if self.geometry is None else 'yes'}; ground truth: {truth}>"
        )

    # --- derived light fields ---

    def with_reference(self, index: int) -> LightField:
        """Return the same light field with view `index` as the reference, an index as of `index_of`."""
        return replace(self, reference=index)

    def subset(self, which: str | Sequence[int] | NDArray[Any]) -> LightField:
        """Return a light field with some of the views.

        Parameters
        ----------
        which
            One of the `PATTERNS` through the reference view, indices of views, or a mask bool [n]. The reference view
            is always kept.

        Raises
        ------
        LightFieldError
            If fewer than two views remain, or an index or pattern is unknown.
        """
        kept = self.layout.chosen(which)
        if len(kept) == len(self.views):
            return self
        check_unchanged(self.views)
        return replace(
            self,
            views=self.views[kept],
            valid=None if self.valid is None else self.valid[kept],
            positions=self.positions[kept],
            reference=int((kept < self.reference_index).sum()),
            files=tuple(self.files[index] for index in kept) if self.files else (),
        )

    def crop(self, y: slice, x: slice) -> LightField:
        """Crop every view to the same window; `y` and `x` are slices of pixel rows and columns, without a step."""
        height, width = self.size
        try:
            (top, bottom, y_step), (left, right, x_step) = y.indices(height), x.indices(width)
        except (AttributeError, TypeError):
            raise LightFieldError(
                f"crop needs slices of pixel rows and columns, such as slice(0, {height}) and slice(0, {width}); found "
                f"{y!r:.40} and {x!r:.40}."
            ) from None
        if y_step != 1 or x_step != 1 or top >= bottom or left >= right:
            raise LightFieldError(
                f"crop {y}, {x} must have no step and leave pixels of the {height} x {width} views; give other slices."
            )
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

    def downsampled(self, factor: int) -> LightField:
        """Downsample all views by averaging blocks of `factor` x `factor` pixels.

        Views become float32, and disparities shrink by `factor`. A block is valid if all its pixels are. Incomplete
        blocks at the right and lower edge are dropped, and so are geometry and ground truth.
        """
        check_whole("factor", factor, 1, min(self.size))
        height, width = (side // factor for side in self.size)
        views = np.empty((len(self.views), height, width, self.channels), np.float32)

        def shrink(place: int, view: NDArray[Any]) -> None:
            # Sums over rows first, then over columns: faster than a mean over blocks.
            blocks = view[: height * factor].reshape(height, factor, -1, self.channels)
            rows = np.add.reduce(blocks, axis=1, dtype=np.float32)[:, : width * factor]
            np.einsum("yxkc->yxc", rows.reshape(height, width, factor, -1), out=views[place])
            views[place] *= np.float32(self.scale / factor**2)

        each_view(self.views, range(len(views)), shrink)
        valid = None
        if self.valid is not None:
            cut = self.valid[:, : height * factor, : width * factor]
            valid = np.asarray(cut.reshape(len(cut), height, factor, width, factor).all(axis=(2, 4)))
        return replace(self, views=views, valid=valid, geometry=None, truth=None, files=())

    # --- helpers ---

    def _find(self, u: float, v: float) -> int | None:
        found = np.flatnonzero(np.abs(self.positions - (u, v)).max(1) < POSITION_TOLERANCE)
        return int(found[0]) if len(found) else None


def check_light_field(lf: object) -> None:
    """Raise LightFieldError that says how to make a light field if `lf` is no `LightField`, but an array or a path."""
    if isinstance(lf, LightField):
        return
    if isinstance(lf, (str, os.PathLike)):
        remedy = f"read it first: lfgpu.read({os.fspath(lf)!r})"
    else:
        remedy = "make one first: lfgpu.LightField.from_grid(views) of [v, u, y, x, c], or lfgpu.read(path)"
    shape = getattr(lf, "shape", None)
    found = f"{type(lf).__name__}{'' if shape is None else f' of shape {tuple(shape)}'}"
    raise LightFieldError(f"lf must be a LightField, found {found}; {remedy}.")
