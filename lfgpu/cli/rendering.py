"""The pictures and films that `lfgpu render` writes."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from lfgpu.cli.options import Estimation
from lfgpu.contract import Float32Array
from lfgpu.data import DepthResult, DisparityMap, LightField, ViewsResult
from lfgpu.errors import LightFieldError
from lfgpu.io import VIEWS_FILE, load, one_map
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
        render = Renderer(self.lf, self._maps(), backend=self.estimation.backend, device=self.estimation.device)
        low, high = self.lf.positions.min(axis=0), self.lf.positions.max(axis=0)
        centre, (u, v) = (low + high) / 2, _REACH * (high - low) / 2
        for turn in turns:
            across = math.cos(turn) if sweep == "circle" else math.sin(turn)
            column = centre[0] + (0 if sweep == "down" else u * across)
            row = centre[1] + (0 if sweep == "across" else v * math.sin(turn))
            yield render(float(row), float(column)).image

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
