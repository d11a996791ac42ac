"""The figure of a sparsification curve."""

from __future__ import annotations

import math
import os
import warnings

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from lfgpu.io.atomic import atomic_write
from lfgpu.metrics import Sparsification
from lfgpu.viz.pictures import short

_SIZE = 6.0, 4.5  # inches


def sparsification_figure(curve: Sparsification, *, name: str = "light field") -> Figure:
    """Draw a sparsification curve: the share of bad pixels among the most confident ones, and that of the oracle.

    Parameters
    ----------
    curve
        The result of `lfgpu.metrics.sparsification`.
    name
        The scene, for the title.
    """
    figure = Figure(_SIZE, dpi=150, facecolor="white", layout="constrained")
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
    axes.set_title(f"{short(name)}: sparsification{area}", parse_math=False)
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
        figure.savefig(temporary, format="png")
