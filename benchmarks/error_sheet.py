"""Errors of maps as pictures on one sheet: a row for each scene, a column for each preset and range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lfgpu.io.atomic import atomic_write

_REACH = 0.21  # pixels per view step at the ends of the colours: three times what makes a pixel bad
_CELL = 2.2  # inches
_DPI = 110


@dataclass(frozen=True, eq=False)
class Picture:
    """The error of one map, for drawing."""

    scene: str
    title: str
    """Preset and range, "fast, range found" for example."""
    view: NDArray[np.uint8]
    """The reference view, [y, x, 3]."""
    error: NDArray[np.float32]
    """Estimate less truth, [y, x], pixels per view step; NaN where it is not scored."""
    badpix_07: float
    """Percent."""


def write(pictures: Sequence[Picture], out: Path) -> None:
    """Draw the sheet as a PNG, whole or not at all: red is too near, blue too far, grey is not scored or unknown."""
    scenes, titles = (list(dict.fromkeys(names)) for names in zip(*((p.scene, p.title) for p in pictures), strict=True))
    colours = colormaps["RdBu_r"].with_extremes(bad="0.6")
    figure = Figure((_CELL * (1 + len(titles)), _CELL * 1.12 * len(scenes) + 0.3), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"Error, white 0, blue -{_REACH} (too far) to red {_REACH} px per view step (too near)", fontsize=9)
    axes = figure.subplots(len(scenes), 1 + len(titles), squeeze=False)
    for cell in axes.ravel():
        cell.set_axis_off()
    for picture in pictures:
        row = axes[scenes.index(picture.scene)]
        row[0].imshow(picture.view)
        row[0].set_title(picture.scene, fontsize=8)
        cell = row[1 + titles.index(picture.title)]
        cell.imshow(np.ma.masked_invalid(picture.error), cmap=colours, vmin=-_REACH, vmax=_REACH)
        cell.set_title(f"{picture.title}: {picture.badpix_07:.1f} % bad", fontsize=8)
    with atomic_write(out) as temporary:
        figure.savefig(temporary, format="png")
