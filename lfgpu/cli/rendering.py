"""The pictures and films that `lfgpu render` writes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from lfgpu.cli.options import Estimation
from lfgpu.contract import Float32Array
from lfgpu.data.filling import fill_unknown
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.data.views_result import ViewsResult
from lfgpu.errors import LightFieldError
from lfgpu.io import VIEWS_FILE, check_writable, load, one_map
from lfgpu.io.frames import write_image
from lfgpu.viz.panels import quilt, quilt_name
from lfgpu.viz.refocusing import all_in_focus, refocus
from lfgpu.viz.rendering import Renderer, render_view

_REACH = 0.9  # share of the way from the middle of the cameras to the outermost ones


@dataclass(frozen=True)
class Rendering:
    """Pictures of a light field by its maps, which are read from a path, or estimated."""

    lf: LightField
    path: Path | None
    estimation: Estimation
    quiet: bool

    def picture(self, place: tuple[float, float] | None, focus: float | None) -> Float32Array:
        """Render a view at (row, column), or the reference view focused on a disparity, or all in focus."""
        if focus is not None:
            return refocus(self.lf, focus)
        backend, device = self.estimation.backend, self.estimation.device
        if place is None:
            return all_in_focus(self.lf, self._map(), backend=backend, device=device)
        found = render_view(self.lf, self._maps(), *place, backend=backend, device=device)
        if not self.quiet:
            hidden = 100 * (1 - found.known.mean())
            typer.echo(
                f"{hidden:.2f} % of the pixels are seen by no recorded view; they are filled from their surroundings."
            )
        return found.image

    def film(self, sweep: str, count: int) -> Iterator[Float32Array]:
        """Yield the frames of a sweep along a closed path."""
        turns = [2 * math.pi * n / count for n in range(count)]
        if sweep == "focus":
            far, near = np.nanquantile(self._map().disparity, (0.01, 0.99))
            middle, reach = (far + near) / 2, (near - far) / 2
            yield from (refocus(self.lf, float(middle - reach * math.cos(turn))) for turn in turns)
            return
        render = self._renderer()
        low, high = self.lf.positions.min(axis=0), self.lf.positions.max(axis=0)
        centre, (u, v) = (low + high) / 2, _REACH * (high - low) / 2
        for turn in turns:
            across = math.cos(turn) if sweep == "circle" else math.sin(turn)
            column = centre[0] + (0 if sweep == "down" else u * across)
            row = centre[1] + (0 if sweep == "across" else v * math.sin(turn))
            yield render(float(row), float(column)).image

    def write_quilt(self, tiles: tuple[int, int], out: Path, dtype: str) -> Path:
        """Write views on a line from the leftmost camera to the rightmost as one image, the first at the bottom left.

        The file is named after the layout, as displays expect it: NAME_qsCOLUMNSxROWSaASPECT.png, unless NAME says it.
        """
        lf, (columns, rows) = self.lf, tiles
        height, width = lf.size
        if "_qs" not in out.stem:
            out = out.with_name(f"{out.stem}{quilt_name(columns, rows, width / height)}{out.suffix}")
            check_writable(out, folder=False)
        left, right = lf.positions[:, 0].min(), lf.positions[:, 0].max()
        if not right > left:
            raise LightFieldError(
                f"{lf.name} has no cameras beside each other; a quilt needs views from left to right."
            )
        middle, render = float(lf.positions[lf.reference_index][1]), self._renderer()
        views = (render(middle, float(u)).image for u in np.linspace(left, right, columns * rows))
        write_image(quilt(views, columns, rows), out, dtype=dtype)
        return out

    def colour_and_depth(self) -> Float32Array:
        """Return the reference view and, beside it, its disparity from 0 (far) to 1 (near); gaps are filled."""
        disparity = fill_unknown(self._map().disparity)
        far, near = np.quantile(disparity, (0.001, 0.999))
        grey = np.clip((disparity - far) / max(near - far, 1e-6), 0, 1)[..., None]
        colour = self.lf.image(self.lf.reference_index)
        return np.concatenate([colour, np.broadcast_to(grey, colour.shape)], axis=1).astype(np.float32)

    def _renderer(self) -> Renderer:
        return Renderer(self.lf, self._maps(), backend=self.estimation.backend, device=self.estimation.device)

    def _maps(self) -> ViewsResult:
        """Read the maps of all views, or estimate them."""
        path = self.path
        if path is None:
            return self.estimation.run_all(self.lf, quiet=self.quiet)
        file = path / VIEWS_FILE if path.is_dir() else path
        if path.is_dir() and not file.is_file():
            raise LightFieldError(
                f"{path} holds no {VIEWS_FILE}: new views need maps of all views; run lfgpu depth --all-views, or "
                "leave --maps out."
            )
        found = load(file)
        if not isinstance(found, ViewsResult):
            raise LightFieldError(
                f"{path} does not hold maps of all views; give what lfgpu depth --all-views wrote, or leave --maps out."
            )
        return found

    def _map(self) -> DepthResult | DisparityMap:
        """Read the map of the reference view, or estimate it."""
        if self.path is None:
            return self.estimation.run(self.lf, quiet=self.quiet, check_cameras=False)
        found = load(self.path / VIEWS_FILE if (self.path / VIEWS_FILE).exists() else self.path)
        return one_map(found, self.lf.positions[self.lf.reference_index])
