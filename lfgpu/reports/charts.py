"""Charts of a report, drawn by matplotlib and put into the page as SVG whose colours follow the page."""

import io
import re
from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lfgpu.cameras import Explanation
from lfgpu.data.geometry import usual_gap
from lfgpu.methods.base import Stage
from lfgpu.metrics import Reliability, Sparsification
from lfgpu.viz.colours import LOOKS
from lfgpu.viz.scales import scale_limits

_INK, _MUTED, _LINE, _ACCENT, _OTHER = "#010101", "#010102", "#010103", "#010104", "#010105"
_COLOURS = {_INK: "--ink", _MUTED: "--muted", _LINE: "--line", _ACCENT: "--accent", _OTHER: "--other"}
"""Colours of charts: the page says what they are, so that they differ in light and dark."""

LEAST_SHARE = 0.1
"""Percent of the pixels: a confidence that fewer of them state has no point in a diagram of reliability."""

_SIZE = 4.5, 2.4  # inches
_BINS = 80
_LARGE = 24  # points: the distance of cameras from which arrows and letters have their full size
_LEAST_ARROW = 0.1  # pixels: the shift whose arrow is as long as two cameras are apart, if none is larger
_SPAN = 20  # of a curve: largest over smallest value from which its axis is logarithmic


def svg(figure: Figure, label: str) -> Markup:
    """Return a chart as SVG for a page; `label` says what it is to those who do not see it."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "lfgpu"}):
        figure.savefig(buffer, format="svg", transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r' id="(?![mpC][0-9a-f]{6,})[^"]*"', "", text)  # others than those of clips and markers
    for colour, name in _COLOURS.items():
        text = text.replace(colour, f"var({name})")
    head = Markup('<svg class="lf-chart" role="img" aria-label="{}"').format(label)
    return head + Markup(re.sub(r'^<svg|(?<=[ "])(?:width|height)="[\d.]+pt"', "", text, count=3))


def distribution(values: NDArray[Any], unit: str, truth: NDArray[Any] | None = None) -> Figure:
    """Draw the distribution of the finite values of a map, and of the truth: percent of the pixels in each bin."""
    known = values[np.isfinite(values)].astype(np.float64)
    true = np.empty(0) if truth is None else truth[np.isfinite(truth)].astype(np.float64)
    limits = [scale_limits(part.astype(np.float32)) for part in (known, true) if part.size]
    low, high = min((low for low, _ in limits), default=0.0), max((high for _, high in limits), default=1.0)
    edges = np.linspace(low, high, _BINS + 1)
    figure, axes = _chart()
    if known.size:
        axes.stairs(100 * np.histogram(known, edges)[0] / known.size, edges, fill=True, color=_ACCENT, label="estimate")
    if true.size:
        axes.stairs(100 * np.histogram(true, edges)[0] / true.size, edges, color=_INK, label="ground truth")
        _legend(axes)
    axes.set_xlim(low, high)
    axes.set_xlabel(unit)
    axes.set_ylabel("pixels in a bin (%)")
    return figure


def sparsification(curve: Sparsification) -> Figure:
    """Draw the share of bad pixels among the most confident ones, and the smallest possible one."""
    figure, axes = _chart()
    axes.plot(curve.kept, curve.bad, color=_ACCENT, marker="o", markersize=3, label="most confident first")
    axes.plot(curve.kept, curve.oracle, color=_OTHER, linestyle="--", label="smallest errors first (oracle)")
    axes.set_xlim(100, 0)
    axes.set_ylim(0, 1.08 * max(float(curve.bad.max()), 1e-3))
    axes.set_xlabel("pixels kept (%)")
    axes.set_ylabel(f"more than {curve.threshold:g} px off (%)")
    _legend(axes)
    return figure


def reliability(diagram: Reliability) -> Figure:
    """Draw the share of right pixels at each confidence, if enough pixels have it; bars show how many have it."""
    figure, axes = _chart()
    enough = diagram.share >= LEAST_SHARE
    axes.plot((0, 1), (0, 100), color=_OTHER, linestyle="--", linewidth=1, label="ideal")
    axes.bar(diagram.said, diagram.share, width=0.05, color=_LINE, label="share of all pixels")
    axes.plot(diagram.said[enough], diagram.right[enough], color=_ACCENT, marker="o", markersize=4, label="found")
    axes.set_xlim(0, 1.02)
    axes.set_ylim(0, 104)
    axes.set_xlabel("confidence")
    axes.set_ylabel(f"pixels within {diagram.threshold:g} px (%)")
    _legend(axes)
    return figure


def trace(stage: Stage, values: NDArray[np.float64]) -> Figure:
    """Draw the value that a stage reports after each iteration; the axis is logarithmic where the values span much."""
    figure, axes = _chart()
    axes.plot(np.arange(len(values)) + (0 if stage.has_start else 1), values, color=_ACCENT, marker="o", markersize=3)
    if (values > 0).all() and values.max() > _SPAN * values.min():
        axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set_xlabel("iteration")
    axes.set_ylabel(", ".join(filter(None, (stage.value, stage.unit))))
    return figure


def times(seconds: Mapping[str, float]) -> Figure:
    """Draw seconds by name as bars, the first on top."""
    figure, axes = _chart(height=0.35 + 0.22 * max(len(seconds), 1))
    names, lengths = list(seconds), list(seconds.values())
    bars = axes.barh(names, lengths, height=0.62, color=_ACCENT)
    axes.bar_label(bars, [f"{length:.2f} s" for length in lengths], padding=3, color=_INK, fontsize=9)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.18 * max([*lengths, 1e-3]))
    axes.xaxis.set_visible(False)
    axes.grid(visible=False)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.tick_params(length=0, labelsize=9, labelcolor=_INK)
    return figure


def cameras(found: Explanation, limits: tuple[float, float]) -> tuple[Figure, float]:
    """Draw the cameras at their places, coloured by how well they are predicted, with arrows of their left-over shifts.

    Returns the figure, and the shift in pixels whose arrow is as long as two cameras are apart.
    """
    places = found.positions
    apart = usual_gap(places) if len(places) > 1 else 1.0
    shifts = np.nan_to_num(found.shift)
    largest = max(_LEAST_ARROW, float(np.hypot(*shifts.T).max(initial=0.0)))
    arrows = shifts / largest * apart
    ends = np.concatenate([places - 0.6 * apart, places + 0.6 * apart, places + 1.1 * arrows])
    (left, top), (right, bottom) = ends.min(0), ends.max(0)
    shape = (bottom - top) / (right - left)
    figure, axes = _chart(height=float(np.clip(3.8 * shape, 0.9, 4.0)))
    colours, (low, high) = colormaps[LOOKS["predicted"].colours], limits
    for n, (u, v) in enumerate(places):
        known = np.isfinite(found.psnr[n])
        fill = colours((found.psnr[n] - low) / max(high - low, 1e-12)) if known else _LINE
        corner = (u - 0.46 * apart, v - 0.46 * apart)
        axes.add_patch(Rectangle(corner, 0.92 * apart, 0.92 * apart, facecolor=fill, linewidth=0))
    small = min(1.0, 72 * (_SIZE[0] - 1) * apart / (right - left) / _LARGE)  # of many cameras the arrows are finer
    others = np.arange(len(places)) != found.reference
    axes.quiver(
        *places[others].T,
        *arrows[others].T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        units="xy",
        width=0.07 * apart,
        minlength=0.5,
        color="white",
        edgecolor="black",
        linewidth=0.8 * small,
        zorder=3,
    )
    u, v = places[found.reference]
    axes.text(u, v, "R", color=_INK, ha="center", va="center", fontsize=2 + 7 * small)
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="column", ylabel="row", aspect="equal")
    axes.grid(visible=False)
    for axis, along in ((axes.xaxis, places[:, 0]), (axes.yaxis, places[:, 1])):
        wanted = MaxNLocator(9, integer=True).tick_values(along.min(), along.max())
        axis.set_ticks([tick for tick in wanted if along.min() <= tick <= along.max()])
    return figure, largest


def _chart(*, height: float = _SIZE[1]) -> tuple[Figure, Axes]:
    figure = Figure((_SIZE[0], height), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.add_subplot()
    for side, spine in axes.spines.items():
        spine.set(color=_LINE, visible=side in ("left", "bottom"))
    axes.tick_params(color=_LINE, labelcolor=_MUTED, labelsize=8)
    axes.xaxis.label.set(color=_MUTED, fontsize=9)
    axes.yaxis.label.set(color=_MUTED, fontsize=9)
    axes.grid(color=_LINE, linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _legend(axes: Axes) -> None:
    axes.legend(frameon=False, fontsize=8, labelcolor=_MUTED)
