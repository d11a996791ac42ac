"""The picture of the site's first page: three scenes of the package, their maps, errors and points in space."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from benchmarks.options import check_out
from lfgpu.data import DepthResult, LightField
from lfgpu.io.atomic import atomic_write
from lfgpu.metrics import evaluate
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.scenes import make
from lfgpu.viewer.cloud import Cloud, shown_cloud
from lfgpu.viz import panels as frames
from lfgpu.viz.scales import ERRORS, scale_limits

SCENES = ("still_life", "planes", "relief")
GRID, SIZE = (9, 9), (384, 512)
OUT = Path("docs/gallery.png")

_COLUMNS = ("one view of 81", "disparity", "error", "points in space")
_CELL = 2.7  # inches, the width of a panel
_DPI = 110
_COLOURS = 256  # of the picture: so it stays small
_YAW, _PITCH = 0.30, -0.16  # radians, from where the points are looked at
_SPLAT = 1.35  # size of a point, in pixels at the middle of the cloud
_ZOOM = 0.86  # share of the picture that the cloud fills
_FINER = 2  # pixels of the drawing for one of the picture, each way


def command(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.png", help="File of the picture.")] = OUT,
) -> None:
    """Draw the picture of the site's first page: three scenes, their disparity, its error, and points in space."""
    check_out(out)
    for line in write(out):
        typer.echo(line)


def write(out: Path, *, grid: tuple[int, int] = GRID, size: tuple[int, int] = SIZE) -> list[str]:
    """Make, estimate and draw all scenes; return a line about each."""
    solved = []
    for name in SCENES:
        lf = make(name, grid=grid, size=size)
        solved.append((lf, estimate_depth(lf)))
    figure = _figure(solved)
    with atomic_write(out) as temporary:
        drawn = Image.fromarray(_rendered(figure))
        palette = drawn.quantize(_COLOURS, Image.Quantize.MEDIANCUT, kmeans=2)
        picture = drawn.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
        picture.save(temporary, format="PNG", optimize=True)
    return [f"{lf.name}: {result.timings['total']:.1f} s; {_scores(lf, result)}" for lf, result in solved]


def render(cloud: Cloud, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Render a cloud from the side, [y, x, 3]: nearer points hide farther ones, the background is white."""
    height, width = (side * _FINER for side in size)
    centre = cloud.centre
    turned = (cloud.points - centre) @ Rotation.from_euler("YX", (_YAW, _PITCH)).as_matrix()
    z = turned[:, 2] + centre[2]
    x, y = (turned[:, axis] * centre[2] / z for axis in (0, 1))
    scale = _ZOOM * min(width / np.ptp(x), height / np.ptp(y))  # pixels for one unit, in the middle
    x, y = x * scale, y * scale
    x, y = x - (x.min() + x.max()) / 2 + width / 2, y - (y.min() + y.max()) / 2 + height / 2
    reach = _SPLAT * cloud.spacing * scale / 2
    picture, depth = np.full((height, width, 3), 255, np.uint8), np.full((height, width), np.inf)
    order = np.argsort(-z)  # far to near, so that what is written last is what is seen
    steps = np.arange(-int(np.ceil(reach)), int(np.ceil(reach)) + 1)
    for dy in steps:
        for dx in steps:
            row, column = np.rint(y + dy).astype(int)[order], np.rint(x + dx).astype(int)[order]
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            row, column, points = row[inside], column[inside], order[inside]
            nearest = np.full((height, width), -1)
            nearest[row, column] = points
            seen = nearest >= 0
            closer = np.where(seen, z[nearest], np.inf) < depth
            picture[closer], depth[closer] = cloud.colours[nearest[closer]], z[nearest[closer]]
    return np.asarray(Image.fromarray(picture).resize((size[1], size[0]), Image.Resampling.BOX))


def _figure(solved: list[tuple[LightField, DepthResult]]) -> Figure:
    height, width = solved[0][0].size
    cell = _CELL * height / width
    extent = 4 * _CELL + 0.3, len(solved) * (cell + 0.28) + 0.85
    figure = Figure(extent, dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    truths = [truth.disparity for lf, _ in solved if (truth := lf.reference_truth()) is not None]
    low, high = scale_limits(np.concatenate([truth.ravel() for truth in truths]))
    errors = [result.disparity - truth for (_, result), truth in zip(solved, truths, strict=True)]
    bars = {}
    for row, ((lf, result), error) in enumerate(zip(solved, errors, strict=True)):
        view = frames.rgb(lf.views[lf.reference_index], lf.scale)
        cloud = render(shown_cloud(result.map, view), (height, width))
        bottom = extent[1] - 0.35 - (row + 1) * cell - row * 0.28
        panels: list[tuple[Any, str, tuple[float, float]]] = [
            (view, "gray", (0, 255)),
            (result.disparity, "viridis", (low, high)),
            (error, "RdBu_r", ERRORS),
            (cloud, "gray", (0, 255)),
        ]
        for column, (values, colours, limits) in enumerate(panels):
            left = 0.28 + column * _CELL
            axes = figure.add_axes(
                (left / extent[0], bottom / extent[1], (_CELL - 0.08) / extent[0], (cell - 0.06) / extent[1])
            )
            axes.set_xticks([])
            axes.set_yticks([])
            axes.spines[:].set_visible(column != 3)
            axes.spines[:].set_color("0.75")
            bars[column] = axes.imshow(
                values, cmap=colours, vmin=limits[0], vmax=limits[1], interpolation="antialiased", aspect="auto"
            )
            if row == 0:
                axes.set_title(_COLUMNS[column], fontsize=10)
            if column == 0:
                axes.set_ylabel(lf.name, fontsize=10)
            if column == 2:
                axes.set_xlabel(_scores(lf, result), fontsize=8, labelpad=2)
    for column, label in ((1, "px per view step, larger is nearer"), (2, "px per view step, red is too near")):
        left = 0.28 + column * _CELL + 0.3
        bar = figure.add_axes((left / extent[0], 0.42 / extent[1], (_CELL - 0.68) / extent[0], 0.1 / extent[1]))
        figure.colorbar(bars[column], cax=bar, orientation="horizontal", extend="both", extendfrac=0.03)
        bar.tick_params(labelsize=8)
        bar.set_xlabel(label, fontsize=8)
    return figure


def _rendered(figure: Figure) -> NDArray[np.uint8]:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _scores(lf: LightField, result: DepthResult) -> str:
    truth = lf.reference_truth()
    assert truth is not None  # the scenes bring it along
    m = evaluate(result.disparity, truth.disparity, mask=truth.mask)
    return f"{m.badpix_07:.2f} % bad, MSE x100 {m.mse_100:.2f}"
