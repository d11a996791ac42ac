"""`lfgpu render`: new views, refocused and all-in-focus images, and videos of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfgpu.cli import values
from lfgpu.cli.options import Computing, Preset, Quiet, ReadingIncomplete, Source
from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    from lfgpu.cli.options import Estimation
    from lfgpu.contract import Float32Array
    from lfgpu.data.lightfield import LightField
    from lfgpu.data.result import DepthResult, DisparityMap
    from lfgpu.data.views_result import ViewsResult

_SWEEPS = ("circle", "across", "down", "focus")
_MOST_TILES = 200  # views of a quilt
_REACH = 0.9  # share of the way from the middle of the cameras to the outermost ones


def render(
    source: Source,
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="FILE", help="Image: .png, .tif. Sweep: .gif, .mp4, or a folder of PNG files."
        ),
    ],
    *,
    view: Annotated[
        str | None,
        typer.Option(
            metavar="ROW,COL",
            help="Render a view at this position, between the recorded views or beyond; counted from 0.",
        ),
    ] = None,
    focus: Annotated[
        float | None, typer.Option("--refocus", metavar="D", help="Refocus on this disparity, pixels per view step.")
    ] = None,
    in_focus: Annotated[
        bool, typer.Option("--all-in-focus", help="Render the reference view from all views, which lowers the noise.")
    ] = False,
    sweep: Annotated[
        str | None, typer.Option(metavar="PATH", help=f"Render a video along a path: {', '.join(_SWEEPS)}.")
    ] = None,
    quilt: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMNSxROWS",
            help="Render so many views from left to right as one image for holographic displays (Looking Glass).",
        ),
    ] = None,
    rgbd: Annotated[
        bool, typer.Option("--rgbd", help="Write the reference view and, to its right, its map: white is near.")
    ] = False,
    maps: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT", help="Maps that `lfgpu depth --all-views` wrote.", show_default="estimated first"
        ),
    ] = None,
    reference_view: Annotated[
        str | None,
        typer.Option(
            metavar="ROW,COL",
            help="View that is refocused or rendered all in focus, counted from 0.",
            show_default="the centre",
        ),
    ] = None,
    frames: Annotated[int, typer.Option(min=2, max=10000, help="Number of frames of a sweep.")] = 30,
    fps: Annotated[float, typer.Option(help="Frames per second of a sweep.")] = 15.0,
    preset: Preset = "accurate",
    computing: Computing,
    reading: ReadingIncomplete,
    quiet: Quiet = False,
) -> None:
    """Render a new view, a refocused image, an all-in-focus image, a video, a quilt or colour and depth.

    Give exactly one of --view, --refocus, --all-in-focus, --sweep, --quilt and --rgbd.
    """
    from lfgpu.io import check_writable, read
    from lfgpu.io.frames import check_frames_path, check_image_path, write_frames, write_image
    from lfgpu.methods import method_of

    asked = [view is not None, focus is not None, in_focus, sweep is not None, quilt is not None, rgbd]
    if sum(asked) != 1:
        raise LightFieldError("give one of --view, --refocus, --all-in-focus, --sweep, --quilt and --rgbd.")
    if sweep is not None and sweep not in _SWEEPS:
        raise LightFieldError(f"--sweep must be one of {', '.join(_SWEEPS)}, not {sweep!r}.")
    (check_image_path if sweep is None else check_frames_path)(out)
    check_writable(out, folder=not out.suffix)
    place = None if view is None else values.parse_place("--view", view)
    tiles = None if quilt is None else values.parse_size("--quilt", quilt, "COLUMNSxROWS such as 8x6")
    if tiles is not None and not (min(tiles) >= 1 and 2 <= tiles[0] * tiles[1] <= _MOST_TILES):
        raise LightFieldError(f"--quilt must be of 2 to {_MOST_TILES} views, such as 8x6, not {quilt}.")
    reference = values.parse_reference_view(reference_view)
    options = reading.options()
    estimation = computing.estimation(method_of(preset).for_rendering)

    lf = read(source, **options)
    if reference is not None:
        lf = lf.with_reference(lf.index_of(*reference))
    dtype = "uint16" if lf.views.dtype == "uint16" else "uint8"
    if sweep is not None:
        write_frames(_film(lf, sweep, frames, maps, estimation, quiet=quiet), out, fps=fps, dtype=dtype)
    elif tiles is not None:
        out = _write_quilt(lf, tiles, maps, estimation, out, dtype=dtype, quiet=quiet)
    elif rgbd:
        write_image(_colour_and_depth(lf, maps, estimation, quiet=quiet), out, dtype=dtype)
    else:
        write_image(_picture(lf, place, focus, maps, estimation, quiet=quiet), out, dtype=dtype)
    if not quiet:
        typer.echo(f"Wrote {out}.")


def _picture(
    lf: LightField,
    place: tuple[float, float] | None,
    focus: float | None,
    maps: Path | None,
    estimation: Estimation,
    *,
    quiet: bool,
) -> Float32Array:
    from lfgpu.viz.refocusing import all_in_focus, refocus
    from lfgpu.viz.rendering import render_view

    if focus is not None:
        return refocus(lf, focus)
    backend, device = estimation.backend, estimation.device
    if place is None:
        return all_in_focus(lf, _map(lf, maps, estimation, quiet=quiet), backend=backend, device=device)
    row, column = place
    found = render_view(lf, _maps(lf, maps, estimation, quiet=quiet), row, column, backend=backend, device=device)
    if not quiet:
        hidden = 100 * (1 - found.known.mean())
        typer.echo(
            f"{hidden:.2f} % of the pixels are seen by no recorded view; they are filled from their surroundings."
        )
    return found.image


def _film(
    lf: LightField, sweep: str, count: int, maps: Path | None, estimation: Estimation, *, quiet: bool
) -> Iterator[Float32Array]:
    """Yield the frames of a sweep along a closed path."""
    import numpy as np

    from lfgpu.viz.refocusing import refocus
    from lfgpu.viz.rendering import Renderer

    turns = [2 * math.pi * n / count for n in range(count)]
    if sweep == "focus":
        disparity = _map(lf, maps, estimation, quiet=quiet).disparity
        far, near = np.nanquantile(disparity, (0.01, 0.99))
        yield from (refocus(lf, float((far + near) / 2 - (near - far) / 2 * math.cos(turn))) for turn in turns)
        return
    render = Renderer(
        lf, _maps(lf, maps, estimation, quiet=quiet), backend=estimation.backend, device=estimation.device
    )
    low, high = lf.positions.min(axis=0), lf.positions.max(axis=0)
    middle, (u, v) = (low + high) / 2, _REACH * (high - low) / 2
    for turn in turns:
        across = math.cos(turn) if sweep == "circle" else math.sin(turn)
        column = middle[0] + (0 if sweep == "down" else u * across)
        row = middle[1] + (0 if sweep == "across" else v * math.sin(turn))
        yield render(float(row), float(column)).image


def _write_quilt(
    lf: LightField,
    tiles: tuple[int, int],
    maps: Path | None,
    estimation: Estimation,
    out: Path,
    *,
    dtype: str,
    quiet: bool,
) -> Path:
    """Write views on a line from the leftmost camera to the rightmost as one image, the first at the bottom left.

    The file is named after the layout, as displays expect it: NAME_qsCOLUMNSxROWSaASPECT.png, unless NAME says it.
    """
    import numpy as np

    from lfgpu.io import check_writable
    from lfgpu.io.frames import write_image
    from lfgpu.viz.panels import quilt, quilt_name
    from lfgpu.viz.rendering import Renderer

    columns, rows = tiles
    height, width = lf.size
    if "_qs" not in out.stem:
        out = out.with_name(f"{out.stem}{quilt_name(columns, rows, width / height)}{out.suffix}")
        check_writable(out, folder=False)
    left, right = lf.positions[:, 0].min(), lf.positions[:, 0].max()
    if not right > left:
        raise LightFieldError(f"{lf.name} has no cameras beside each other; a quilt needs views from left to right.")
    middle = float(lf.positions[lf.reference_index][1])
    render = Renderer(
        lf, _maps(lf, maps, estimation, quiet=quiet), backend=estimation.backend, device=estimation.device
    )
    views = (render(middle, float(u)).image for u in np.linspace(left, right, columns * rows))
    write_image(quilt(views, columns, rows), out, dtype=dtype)
    return out


def _colour_and_depth(lf: LightField, maps: Path | None, estimation: Estimation, *, quiet: bool) -> Float32Array:
    """Return the reference view and, beside it, its disparity from 0 (far) to 1 (near); what is not known is filled."""
    import numpy as np

    from lfgpu.data.filling import fill_unknown

    disparity = fill_unknown(_map(lf, maps, estimation, quiet=quiet).disparity)
    far, near = np.quantile(disparity, (0.001, 0.999))
    grey = np.clip((disparity - far) / max(near - far, 1e-6), 0, 1)[..., None]
    colour = lf.image(lf.reference_index)
    return np.concatenate([colour, np.broadcast_to(grey, colour.shape)], axis=1).astype(np.float32)


def _maps(lf: LightField, path: Path | None, estimation: Estimation, *, quiet: bool) -> ViewsResult:
    """Read the maps of all views from `path`, or estimate them."""
    from lfgpu.data.views_result import ViewsResult
    from lfgpu.io import VIEWS_FILE, load

    if path is None:
        return estimation.run_all(lf, quiet=quiet)
    file = path / VIEWS_FILE if path.is_dir() else path
    if path.is_dir() and not file.is_file():
        raise LightFieldError(
            f"{path} holds no {VIEWS_FILE}: new views need maps of all views; run lfgpu depth --all-views, or leave "
            "--maps out."
        )
    found = load(file)
    if not isinstance(found, ViewsResult):
        raise LightFieldError(
            f"{path} does not hold maps of all views; give what lfgpu depth --all-views wrote, or leave --maps out."
        )
    return found


def _map(lf: LightField, path: Path | None, estimation: Estimation, *, quiet: bool) -> DepthResult | DisparityMap:
    """Read the map of the reference view from `path`, or estimate it."""
    from lfgpu.io import VIEWS_FILE, load, one_map

    if path is None:
        return estimation.run(lf, quiet=quiet, check_cameras=False)
    found = load(path / VIEWS_FILE if (path / VIEWS_FILE).exists() else path)
    return one_map(found, lf.positions[lf.reference_index])
