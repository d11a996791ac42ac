"""Figures of maps: each has a colour bar with its unit; maps that are compared share one scale."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike, NDArray

from lfgpu.comparison import Scene, error_map
from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_write
from lfgpu.metrics import Sparsification
from lfgpu.viz.scales import error_reach as error_reach  # those of figures are for others, too
from lfgpu.viz.scales import scale_limits as scale_limits

_DISPARITY = "disparity (px per view step)\nlarger is nearer"
_UNDEFINED = "0.62"  # a grey that occurs in none of the colour maps
_LONG_SIDE = 6.0  # inches: the longer side of a map
_LEAST_PIXELS = 900  # pixels at least: the longer side of a map in the picture
_BAR, _GAP, _TICKS, _MARGIN, _TITLE = 0.2, 0.15, 1.05, 0.15, 0.42  # inches
_DPI = 100  # pixels of an inch beside a picture that is shown as it is
_LEAST_HEIGHT, _LEAST_WIDTH = 2.4, 4.2  # inches: space for the label of a colour bar and the title
_CELL, _BETWEEN, _BELOW = 2.2, 0.06, 0.42  # inches: the width of a map in a comparison, and the space around it
_LONGEST_NAME = 34  # characters of a name that fit above a map
_COMPRESSION = 1  # of PNG: more takes twice as long and saves a third


def map_figure(
    values: ArrayLike,
    *,
    title: str,
    label: str,
    colours: str = "viridis",
    limits: tuple[float, float] | None = None,
) -> Figure:
    """Draw a map with a colour bar.

    Parameters
    ----------
    values
        [y, x]; NaN and infinite pixels are grey.
    title
        The title.
    label
        What the colour bar shows, with its unit.
    colours
        The name of a colour map of matplotlib. Default "viridis".
    limits
        (low, high) of the scale. Default None: the range of the map without a few outliers.

    Raises
    ------
    LightFieldError
        If the map is not [y, x].
    """
    drawn = _map(values)
    layout = _Layout(drawn.shape, rows=1, columns=1)
    axes, bar = layout.axes(0, 0), layout.bar(0)
    image = _show(axes, drawn, colours, limits or scale_limits(drawn))
    _scale(layout.figure, image, bar, label, drawn)
    axes.set_title(title, parse_math=False)  # a name may hold dollar signs
    return layout.figure


def disparity_figure(
    disparity: ArrayLike, *, name: str = "light field", limits: tuple[float, float] | None = None
) -> Figure:
    """Draw a disparity map in viridis, with a colour bar.

    Parameters
    ----------
    disparity
        [y, x], pixels per view step; NaN and infinite pixels are grey.
    name
        The scene, for the title.
    limits
        (low, high) of the scale. Default None: the range of the map without a few outliers.

    Raises
    ------
    LightFieldError
        If the map is not [y, x].
    """
    return map_figure(disparity, title=f"{_short(name)}: disparity", label=_DISPARITY, limits=limits)


def sparsification_figure(curve: Sparsification, *, name: str = "light field") -> Figure:
    """Draw a sparsification curve: the share of bad pixels among the most confident ones, and that of the oracle.

    Parameters
    ----------
    curve
        The result of `lfgpu.metrics.sparsification`.
    name
        The scene, for the title.
    """
    figure = Figure((_LONG_SIDE, 0.75 * _LONG_SIDE), dpi=150, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(curve.kept, curve.bad, color="C0", marker=".", label="most confident first")
    axes.plot(curve.kept, curve.oracle, color="0.4", linestyle="--", label="smallest errors first")
    axes.set_xlim(100, 0)
    axes.set_ylim(0, 1.05 * max(float(curve.bad.max()), 1.0))
    axes.set_xlabel("pixels kept (%)")
    axes.set_ylabel(f"of them bad (%)\nmore than {curve.threshold:g} px per view step off")
    axes.legend(frameon=False)
    area = "" if math.isnan(curve.ause) else f", AUSE {curve.ause:.3f}"
    axes.set_title(f"{_short(name)}: sparsification{area}", parse_math=False)
    return figure


def overview_figure(
    view: ArrayLike,
    disparity: ArrayLike,
    truth: ArrayLike,
    *,
    title: str,
    mask: ArrayLike | None = None,
    border: int = 0,
) -> Figure:
    """Draw the reference view, the error map, and the estimate and the ground truth on one scale.

    Parameters
    ----------
    view
        [y, x, c], c = 1 or 3, in [0, 1].
    disparity, truth
        [y, x], pixels per view step; NaN is grey.
    title
        The title of the figure, such as the scene and its scores.
    mask
        bool [y, x]; the error is grey where it is False. Default None: no mask.
    border
        Width of the border that was not scored, pixels; a dashed line marks it in the error map. Default 0.

    Raises
    ------
    LightFieldError
        If the maps are not [y, x], or differ in size.
    """
    estimated, true, picture = _map(disparity), _map(truth), np.asarray(view, np.float32)
    if not estimated.shape == true.shape == picture.shape[:2]:
        raise LightFieldError(
            f"view, disparity and truth must have the same size; found {picture.shape}, {estimated.shape}, "
            f"{true.shape}."
        )
    error = estimated - true
    if mask is not None:
        error = np.where(np.asarray(mask), error, np.float32(np.nan))
    layout = _Layout(true.shape, rows=2, columns=2, heading=0.5)

    axes = layout.axes(0, 0)
    _show(axes, picture[..., 0] if picture.shape[2] == 1 else picture, "gray", (0.0, 1.0))
    axes.set_title("reference view")

    axes = layout.axes(0, 1)
    reach = error_reach(error)
    image = _show(axes, error, "RdBu_r", (-reach, reach))
    _scale(layout.figure, image, layout.bar(0), "error (px per view step)\nred is too near", error)
    axes.set_title("disparity minus truth")
    _draw_border(axes, error.shape, border)

    limits = scale_limits(true)
    for column, (values, what) in enumerate(((estimated, "disparity"), (true, "truth"))):
        axes = layout.axes(1, column)
        image = _show(axes, values, "viridis", limits)
        axes.set_title(what)
    _scale(layout.figure, image, layout.bar(1), _DISPARITY, np.stack([estimated, true]))
    height = layout.figure.get_figheight()
    layout.figure.suptitle(title, fontsize=13, y=1 - 0.3 / height, va="center", parse_math=False)
    return layout.figure


def comparison_figure(scenes: Sequence[Scene]) -> Figure:
    """Draw error maps of several methods: a row for each scene, a column for each method.

    Parameters
    ----------
    scenes
        The scenes, with the maps of all methods. The first two columns show the view and the ground truth. All error
        maps have one scale. Below each are BadPix(0.07) and the mean squared error times 100.

    Raises
    ------
    LightFieldError
        If there is no scene, or a map and its ground truth differ in size.
    """
    methods = list(dict.fromkeys(method for scene in scenes for method in scene.maps))
    if not methods:
        raise LightFieldError("there is nothing to compare; give at least one scene with the map of one method.")
    errors = {(s.name, m): error_map(values, s.truth) for s in scenes for m, values in s.maps.items()}
    reach = max(error_reach(error) for error in errors.values())
    heights = [_CELL * scene.truth.shape[0] / scene.truth.shape[1] for scene in scenes]
    columns, rows = 2 + len(methods), len(scenes)
    left, top, foot = 0.35, 0.35, 0.95  # inches: names of scenes, of methods, and the scale
    size = left + columns * (_CELL + _BETWEEN), top + sum(heights) + rows * _BELOW + foot
    figure = Figure(size, dpi=150, facecolor="white")
    FigureCanvasAgg(figure)
    tops = size[1] - top - np.cumsum([0.0, *(height + _BELOW for height in heights)])
    for row, scene in enumerate(scenes):
        scores = scene.scores()
        picture = scene.view[..., 0] if scene.view.shape[2] == 1 else scene.view
        panels = [(picture, "gray", (0.0, 1.0)), (_map(scene.truth), "viridis", scale_limits(_map(scene.truth)))]
        missing = np.full(scene.truth.shape, np.nan, np.float32)
        panels += [(errors.get((scene.name, method), missing), "RdBu_r", (-reach, reach)) for method in methods]
        for column, (values, colours, limits) in enumerate(panels):
            place = left + column * (_CELL + _BETWEEN), tops[row] - heights[row], _CELL, heights[row]
            axes = figure.add_axes(_shares(place, size))
            axes.set_xticks([])
            axes.set_yticks([])
            shown = axes.imshow(
                values, cmap=_colours(colours), norm=Normalize(*limits), interpolation="antialiased", aspect="auto"
            )
            if column >= 2:
                _draw_border(axes, scene.truth.shape, scene.border)
                m = scores.get(methods[column - 2])
                text = "no map" if m is None else f"{m.badpix_07:.2f} % bad, MSE {m.mse_100:.2f}"
                axes.set_xlabel(text, fontsize=9)
            if row == 0:
                axes.set_title(["view", "truth", *methods][column], fontsize=11, parse_math=False)
            if column == 0:
                axes.set_ylabel(_short(scene.name), fontsize=11, parse_math=False)
    bar = figure.add_axes(_shares((0.25 * size[0], 0.5, 0.5 * size[0], 0.12), size))
    figure.colorbar(shown, cax=bar, orientation="horizontal", extend="both", extendfrac=0.02)
    bar.set_xlabel("error, px per view step; red is too near; grey: undefined or not scored", fontsize=9)
    return figure


def figure_with_scale(
    picture: NDArray[np.uint8],
    *,
    label: str,
    colours: str,
    limits: tuple[float, float],
    extent: tuple[float, float],
    paper: tuple[int, int, int] = (255, 255, 255),
) -> Figure:
    """A picture as it is, pixel by pixel, with the scale of its colours at its right.

    Parameters
    ----------
    picture
        uint8 [y, x, 3].
    label
        The words beside the scale.
    colours
        The colour map of matplotlib.
    limits
        The ends of the scale.
    extent
        The smallest and the largest value: where one lies beyond the scale, its end is pointed.
    paper
        The colour behind the scale, RGB from 0 to 255. Text is black or white, whichever is read better.
    """
    height, width = picture.shape[:2]
    beside = _MARGIN + _BAR + _TICKS
    size = width / _DPI + beside, (height + 0.01) / _DPI  # pixels are whole: no rounding takes one away
    figure = Figure(size, dpi=_DPI, facecolor=(paper[0] / 255, paper[1] / 255, paper[2] / 255))
    FigureCanvasAgg(figure)
    figure.figimage(picture, xo=0, yo=0)
    tall = min(0.9 * size[1], _LONG_SIDE)
    bar = figure.add_axes(_shares((width / _DPI + _MARGIN, (size[1] - tall) / 2, _BAR, tall), size))
    image = ScalarMappable(Normalize(*limits), _colours(colours))
    _scale(figure, image, bar, label, np.array(extent))
    ink = "black" if sum(paper) > 3 * 127 else "white"
    bar.yaxis.label.set_color(ink)
    bar.tick_params(colors=ink)
    return figure


def save_png(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Save a figure as PNG, atomically.

    Raises
    ------
    LightFieldError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # a name may use a script that the font lacks
        figure.savefig(temporary, format="png", pil_kwargs={"compress_level": _COMPRESSION})


class _Layout:
    """Panels of one size in rows and columns, with a colour bar at the right of each row.

    A pixel of a map becomes k x k pixels of the picture, with an integer k, so that nothing is blurred. The size of
    text relative to the maps does not depend on their number of pixels.
    """

    def __init__(self, shape: tuple[int, ...], *, rows: int, columns: int, heading: float = 0.0) -> None:
        long_side = max(shape)
        self._height, self._width = (_LONG_SIDE * side / long_side for side in shape)
        self._cell_height = max(self._height, _LEAST_HEIGHT) + _TITLE
        self._cell_width = max(self._width, _LEAST_WIDTH if columns == 1 else 0.6 * _LEAST_WIDTH) + _GAP
        self._columns = columns
        self._size = (
            _MARGIN + columns * self._cell_width + _BAR + _TICKS,
            rows * self._cell_height + _MARGIN + heading,
        )
        self._top = self._size[1] - heading
        magnification = math.ceil(_LEAST_PIXELS / long_side)
        self.figure = Figure(self._size, dpi=magnification * long_side / _LONG_SIDE, facecolor="white")
        FigureCanvasAgg(self.figure)

    def axes(self, row: int, column: int) -> Axes:
        """The axes of a map, in the middle of its cell."""
        left = _MARGIN + column * self._cell_width + (self._cell_width - _GAP - self._width) / 2
        axes = self._add(left, self._bottom(row) + self._slack() / 2, self._width, self._height)
        axes.set_xticks([])
        axes.set_yticks([])
        return axes

    def bar(self, row: int) -> Axes:
        """The colour bar of a row."""
        left = _MARGIN + self._columns * self._cell_width
        return self._add(left, self._bottom(row), _BAR, self._height + self._slack())

    def _bottom(self, row: int) -> float:
        return self._top - (row + 1) * self._cell_height

    def _slack(self) -> float:
        return self._cell_height - _TITLE - self._height

    def _add(self, left: float, bottom: float, width: float, height: float) -> Axes:
        return self.figure.add_axes(_shares((left, bottom, width, height), self._size))


def _shares(place: tuple[float, ...], size: tuple[float, float]) -> tuple[float, float, float, float]:
    """A rectangle (left, bottom, width, height) in inches as shares of a figure of that size."""
    left, bottom, width, height = place
    return left / size[0], bottom / size[1], width / size[0], height / size[1]


def _map(values: ArrayLike) -> NDArray[np.float32]:
    array = np.asarray(values, np.float32)
    if array.ndim != 2 or 0 in array.shape:
        raise LightFieldError(f"a map must be [y, x]; found shape {array.shape}.")
    return np.where(np.isfinite(array), array, np.float32(np.nan))


def _show(axes: Axes, values: NDArray[np.float32], colours: str, limits: tuple[float, float]) -> AxesImage:
    return axes.imshow(values, cmap=_colours(colours), norm=Normalize(*limits), interpolation="nearest", aspect="auto")


def _colours(name: str) -> Colormap:
    return colormaps[name].with_extremes(bad=_UNDEFINED)


def _scale(figure: Figure, image: ScalarMappable, bar: Axes, label: str, values: NDArray[Any]) -> None:
    """Draw the colour bar of an image; a pointed end means that some of `values` lie beyond it."""
    defined = values[np.isfinite(values)]
    low, high = image.get_clim()
    below, above = bool((defined < low).any()), bool((defined > high).any())
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}.get((below, above), "neither")
    figure.colorbar(image, cax=bar, extend=extend, extendfrac=0.03).set_label(_with_grey(label, values))


def _with_grey(label: str, values: NDArray[Any]) -> str:
    return label if np.isfinite(values).all() else f"{label}; grey: undefined"


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 3]}..."


def _draw_border(axes: Axes, shape: tuple[int, ...], border: int) -> None:
    height, width = shape
    if 0 < 2 * border < min(shape):
        corner = (border - 0.5, border - 0.5)
        axes.add_patch(
            Rectangle(corner, width - 2 * border, height - 2 * border, fill=False, edgecolor="0.3", linestyle="--")
        )
