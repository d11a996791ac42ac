"""The public functions: they check their arguments and make light fields of the scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.data.light_field_checks import check_number, check_whole
from lfgpu.errors import LightFieldError
from lfgpu.scenes import render
from lfgpu.scenes.catalogue import SCENES, Stage
from lfgpu.scenes.still_life import still_life

_BUILDERS = {**SCENES, "still_life": still_life}

NAMES: tuple[str, ...] = tuple(_BUILDERS)
"""The scenes: relief, planes, boxes, bars, textureless, moving, still_life."""

_SMALLEST = 8  # pixels along each side
_FOCAL_LENGTH = 100 / 35  # in picture widths: a 100 mm lens on a 35 mm wide sensor
_NEAREST_M, _FARTHEST_M = 4.0, 8.0  # depths of the two ends of the disparity range
_GREY = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601
_MOVING = ("moving",)


def make(
    name: str,
    *,
    seed: int = 0,
    grid: tuple[int, int] = (9, 9),
    size: tuple[int, int] = (512, 512),
    disparity_range: tuple[float, float] = (-1.5, 1.5),
    noise: float = 0.0,
    reference: tuple[int, int] | None = None,
    time: float = 0.0,
    dtype: DTypeLike = np.uint8,
    channels: int = 3,
    displaced: ArrayLike | None = None,
) -> LightField:
    """Make a light field of a synthetic scene, with the exact disparity of its reference view.

    The views do not depend on the choice of the reference view. Each pixel is the mean over 2 x 2 rays. The true
    disparity is that of the first hit of the ray through the centre of the pixel.

    Parameters
    ----------
    name
        One of `NAMES`: "relief" (smooth hills without occlusions), "planes" (slanted and overlapping), "boxes" (boxes
        and balls in a room), "bars" (rods 2 to 8 px wide in front of a wall), "textureless" (regions of constant
        colour), "moving" (the objects of "boxes" in motion), "still_life" (things on a table, with soft shadows).
    seed
        Seed of positions, colours, textures and noise, >= 0; default 0.
    grid
        (rows, columns) of views, each >= 1, at least two views in all.
    size
        (height, width) of each view in pixels, each >= 8.
    disparity_range
        (far, near) in pixels per view step, far < near. True disparities use most of this range. Default (-1.5, 1.5).
    noise
        Standard deviation of Gaussian noise that is added to intensities, 0 to 1; results are clipped to [0, 1].
        Default 0.
    reference
        (row, column) of the reference view. Default None: the middle one, as in `LightField.from_grid`.
    time
        Time of the scene "moving", 0 to 1; its motion has the period 1. Must be 0 (default) for all other scenes.
    dtype
        uint8, uint16 or float32 (in [0, 1]).
    channels
        3 for colour, 1 for grey.
    displaced
        [rows * columns, 2], view steps (u, v) by which each view is taken beside its place in the grid, row by row;
        positions and the truth stay those of the places. None is nowhere.

    Returns
    -------
    LightField
        Views [rows * columns, y, x, c] with `grid_shape`, `truth` (float32), `name` and a `geometry` that puts the
        ends of the disparity range at depths of about 8 m and 4 m.

    Raises
    ------
    LightFieldError
        If an argument is wrong; the message says which.

    Examples
    --------
    >>> lfgpu.scenes.make("planes", seed=3, grid=(3, 3), size=(48, 64)).truth.disparity.shape
    (48, 64)
    """
    scene = _scene(name, seed, grid, size, disparity_range)
    record = _recorder(scene, noise, reference, dtype, channels)
    return record(_time(name, time), _displaced(displaced, scene.grid))


def sequence(
    name: str = "moving",
    *,
    frames: int,
    seed: int = 0,
    grid: tuple[int, int] = (9, 9),
    size: tuple[int, int] = (512, 512),
    disparity_range: tuple[float, float] = (-1.5, 1.5),
    noise: float = 0.0,
    reference: tuple[int, int] | None = None,
    dtype: DTypeLike = np.uint8,
    channels: int = 3,
) -> Iterator[LightField]:
    """Make the frames of a moving scene, one at a time. Frame i is that of `make` at time i / frames, so they loop.

    Parameters
    ----------
    name
        A scene that moves: "moving".
    frames
        Number of frames, >= 1.
    seed, grid, size, disparity_range, noise, reference, dtype, channels
        As in `make`.

    Raises
    ------
    LightFieldError
        If an argument is wrong. It is raised by the call, not by the first frame.

    Examples
    --------
    >>> [frame.name for frame in lfgpu.scenes.sequence("moving", frames=2, grid=(3, 3), size=(24, 32))]
    ['moving', 'moving']
    """
    check_whole("frames", frames, 1)
    scene = _scene(name, seed, grid, size, disparity_range)
    if name not in _MOVING:
        raise LightFieldError(f"a sequence needs a scene that moves ({', '.join(_MOVING)}), found {name!r}.")
    record = _recorder(scene, noise, reference, dtype, channels)
    return (record(index / frames) for index in range(frames))


def true_disparity(
    name: str,
    row: int,
    column: int,
    *,
    seed: int = 0,
    grid: tuple[int, int] = (9, 9),
    size: tuple[int, int] = (512, 512),
    disparity_range: tuple[float, float] = (-1.5, 1.5),
    time: float = 0.0,
) -> NDArray[np.float64]:
    """Compute the exact disparity, float64 [y, x], of the view at grid position (`row`, `column`).

    Parameters
    ----------
    name, seed, grid, size, disparity_range, time
        As in `make`.
    row, column
        The view, counted from 0.

    Raises
    ------
    LightFieldError
        If an argument is wrong; the message says which.

    Examples
    --------
    >>> lfgpu.scenes.true_disparity("planes", 0, 2, grid=(3, 3), size=(48, 64)).shape
    (48, 64)
    """
    scene = _scene(name, seed, grid, size, disparity_range)
    place = _place((row, column), scene.grid)
    return render.disparity(scene.at(_time(name, time)), scene.frame, scene.offset(place))


def true_motion(
    row: int,
    column: int,
    times: tuple[float, float],
    *,
    seed: int = 0,
    grid: tuple[int, int] = (9, 9),
    size: tuple[int, int] = (512, 512),
    disparity_range: tuple[float, float] = (-1.5, 1.5),
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Compute the exact motion of each pixel of a view of the scene "moving" between two times.

    Parameters
    ----------
    times
        Two times as in `make`.
    seed, grid, size, disparity_range, row, column
        As in `true_disparity`.

    Returns
    -------
    float64 [3, y, x]: motion to the right and down in pixels, and change of disparity in pixels per view step; and
    int [y, x]: the index of the object that the pixel shows at the first time.

    Raises
    ------
    LightFieldError
        If an argument is wrong; the message says which.

    Examples
    --------
    >>> motion, owner = lfgpu.scenes.true_motion(1, 1, (0.0, 0.1), grid=(3, 3), size=(48, 64))
    >>> motion.shape
    (3, 48, 64)
    """
    scene = _scene("moving", seed, grid, size, disparity_range)
    place = _place((row, column), scene.grid)
    before, after = (_time("moving", time) for time in times)
    return render.motion(scene.things, (before, after), scene.frame, scene.offset(place))


@dataclass(frozen=True, eq=False)
class _Scene:
    name: str
    grid: tuple[int, int]
    frame: render.Frame
    seed: int

    def offset(self, place: tuple[int, int]) -> tuple[float, float]:
        """Return (du, dv) of the view at (row, column) from the middle view."""
        return float(place[1] - self.grid[1] // 2), float(place[0] - self.grid[0] // 2)

    def at(self, time: float) -> list[render.Thing]:
        """Return the objects at a time."""
        return [thing.at(time, self.frame.unit) for thing in self.things]

    @cached_property
    def things(self) -> list[render.Thing]:
        """The objects; built when first needed, after all arguments were checked."""
        rng = np.random.default_rng([self.seed, NAMES.index(self.name)])
        return _BUILDERS[self.name](Stage(self.frame, _farthest(self.grid), rng))


def _scene(
    name: str, seed: int, grid: tuple[int, int], size: tuple[int, int], disparity_range: tuple[float, float]
) -> _Scene:
    if name not in NAMES:
        raise LightFieldError(f"unknown scene {name!r}; known are {', '.join(NAMES)}.")
    check_whole("seed", seed, 0)
    rows, columns = _pair("grid", "(rows, columns)", grid, 1)
    if rows * columns < 2:
        raise LightFieldError(f"grid must have at least two views, found {rows} x {columns}.")
    height, width = _pair("size", "(height, width)", size, _SMALLEST)
    far, near = _range(disparity_range)
    frame = render.Frame(height, width, far, near)
    slope = max(frame.slope(_farthest((rows, columns))))
    if slope > 1.0:
        raise LightFieldError(
            f"views of {height} x {width} pixels are too small for a grid of {rows} x {columns} and disparities "
            f"{far:g} to {near:g}, because objects would shift by {slope * frame.unit:.0f} pixels against each other; "
            "give larger views, a smaller grid or a narrower range."
        )
    return _Scene(name, (rows, columns), frame, seed)


def _farthest(grid: tuple[int, int]) -> tuple[float, float]:
    """Return the largest |du| and |dv| of a view from the middle view."""
    return float(grid[1] // 2), float(grid[0] // 2)


def _record(
    scene: _Scene,
    noise: float,
    reference: tuple[int, int],
    dtype: np.dtype[Any],
    channels: int,
    time: float,
    displaced: NDArray[np.float64] | None = None,
) -> LightField:
    """Record all views of a scene at a time, and the ground truth of the reference view."""
    rows, columns = scene.grid
    frame, things = scene.frame, scene.at(time)
    views = np.empty((rows, columns, frame.height, frame.width, channels), dtype)
    for row, column in np.ndindex(rows, columns):
        du, dv = scene.offset((row, column))
        if displaced is not None:
            du, dv = (du, dv) + displaced[row * columns + column]
        colours = render.picture(things, frame, (du, dv))
        if channels == 1:
            colours = np.tensordot(_GREY, colours, axes=1)[None]
        intensities = np.moveaxis(colours, 0, 2)
        if noise:
            # One generator per view and time, so that the noise of a view does not depend on the other views.
            rng = np.random.default_rng([scene.seed, row, column, round(time * 2**32)])
            grain = rng.standard_normal(intensities.shape, np.float32)
            intensities = intensities + np.float32(noise) * grain
        intensities = np.clip(intensities, 0.0, 1.0)
        views[row, column] = intensities if dtype == np.float32 else np.rint(intensities * np.iinfo(dtype).max)
    row, column = reference
    truth = render.disparity(things, frame, scene.offset(reference)).astype(np.float32)
    return LightField.from_grid(
        views,
        reference=row * columns + column,
        geometry=_geometry(scene),
        truth=GroundTruth(truth, (float(column), float(row))),
        name=scene.name,
    )


def _geometry(scene: _Scene) -> Geometry:
    """Return cameras for which the disparity range reaches from 8 m to 4 m."""
    frame, middle = scene.frame, _farthest(scene.grid)
    focal_length = _FOCAL_LENGTH * frame.width
    if frame.far > frame.near - frame.far:
        # No frames shifted outwards: they stay as they are, and the far end comes nearer than 8 m.
        return Geometry(focal_length, _NEAREST_M * frame.near / focal_length)
    scale = (frame.near - frame.far) / (1 / _NEAREST_M - 1 / _FARTHEST_M)  # baseline times focal length
    vergence = 1 / _FARTHEST_M - frame.far / scale  # of the plane of disparity 0, in 1 / m
    focus_distance = 1 / vergence if vergence > 0 else math.inf
    return Geometry(focal_length, scale / focal_length, focus_distance, unshifted_at=middle)


# --- arguments ---


def _pair(what: str, parts: str, value: Any, low: int) -> tuple[int, int]:
    try:
        first, second = value
        check_whole(what, first, low)
        check_whole(what, second, low)
    except (TypeError, ValueError):
        raise LightFieldError(f"{what} must be {parts}, whole numbers >= {low}, found {value!r}.") from None
    return int(first), int(second)


def _range(value: Any) -> tuple[float, float]:
    try:
        far, near = (float(end) for end in value)
    except (TypeError, ValueError):
        far = near = math.nan
    if not (math.isfinite(far) and math.isfinite(near) and far < near):
        raise LightFieldError(f"disparity_range must be two finite numbers (far, near), far < near, found {value!r}.")
    return far, near


def _place(value: Any, grid: tuple[int, int]) -> tuple[int, int]:
    if value is None:
        return grid[0] // 2, grid[1] // 2
    row, column = _pair("reference view", "(row, column)", value, 0)
    if row >= grid[0] or column >= grid[1]:
        raise LightFieldError(
            f"reference view (row {row}, column {column}) does not exist in a grid of {grid[0]} x {grid[1]}."
        )
    return row, column


def _displaced(value: ArrayLike | None, grid: tuple[int, int]) -> NDArray[np.float64] | None:
    if value is None:
        return None
    moved = np.asarray(value, np.float64)
    if moved.shape != (grid[0] * grid[1], 2) or not np.isfinite(moved).all():
        raise LightFieldError(
            f"displaced must be {grid[0] * grid[1]} finite pairs, one for each view, found shape {moved.shape}."
        )
    return moved


def _time(name: str, value: float) -> float:
    check_number("time", value, 0, 1)
    if value != 0 and name not in _MOVING:
        raise LightFieldError(f"time must be 0 for a scene that does not move, found {value!r} for {name!r}.")
    return float(value)


def _dtype(value: DTypeLike) -> np.dtype[Any]:
    try:
        dtype = np.dtype(value)
    except TypeError:
        dtype = None
    if dtype not in (np.uint8, np.uint16, np.float32):
        raise LightFieldError(f"dtype must be uint8, uint16 or float32, found {value!r}.")
    return dtype


def _recorder(
    scene: _Scene, noise: float, reference: tuple[int, int] | None, dtype: DTypeLike, channels: int
) -> Callable[..., LightField]:
    """Check how a scene is recorded; returns a function of the time, and of displacements."""
    check_number("noise", noise, 0, 1)
    if isinstance(channels, bool) or channels not in (1, 3):
        raise LightFieldError(f"channels must be 1 (grey) or 3 (colour), found {channels!r}.")
    return partial(_record, scene, float(noise), _place(reference, scene.grid), _dtype(dtype), channels)
