"""Results: a disparity map with confidence and provenance."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu import hooks
from lfgpu.config import Config
from lfgpu.contract import Float32Array
from lfgpu.data import summary
from lfgpu.data.geometry import Geometry
from lfgpu.data.light_field_checks import array_of_numbers
from lfgpu.errors import LightFieldError


@dataclass(frozen=True, eq=False)
class DepthResult(summary.InNotebooks):
    """A disparity map of the reference view.

    Parameters
    ----------
    disparity
        float32 [y, x], pixels per view step; larger is nearer. The point at (x, y) of the reference view is at
        (x - d*du, y - d*dv) in the view that is du view steps to the right of and dv below it. NaN where the reference
        view is masked; `lfgpu.fill_unknown` fills such holes.
    confidence
        float32 [y, x], 0 to 1; larger is more certain. Its meaning depends on the method.

        Matching: the share of such pixels that are within 0.07 pixels per view step of the truth. It was calibrated on
        rendered scenes (`python -m benchmarks confidence`): of pixels of scenes that were not among them for which it
        says 0.9, 0.85 to 0.95 are. It is low at edges of depth between alike colours, where views differ by more than
        their noise (hidden, glossy or misregistered surfaces), and where several disparities are as good as the best
        one and nothing like it is near by. Where the disparity is NaN it is 0.

        Synthesis (the preset "paper"): how surely the views that see a pixel fix its disparity, less where the map is
        not smooth among like pixels. It tells better pixels from worse ones but is not a probability. With
        `refinement.acceptance` "whole", as in "paper-exact", it is the mean coherence of the local estimates near a
        pixel, which says little about the refined map.
    stages
        The map after each stage, by the name of the stage. Matching: `sweep`, `resweep` (the last of the
        further sweeps, if there are any), `align` and `boundaries`. Synthesis: `local` (NaN where undefined),
        `propagate` and `refine`, and before them what the row and the column of views say alone: `local_row` and
        `local_column`, disparities, with their coherences 0 to 1, `coherence_row` and `coherence_column`.
    position
        (u, v) of the reference view, as in `LightField.positions`.
    disparity_range
        (low, high), the bounds of the disparity, pixels per view step.
    config
        All parameters.
    status
        Why the solvers stopped, as sentences.
    converged
        Whether the iterations met their tolerance. Matching: whether the last step of the alignment is shorter than
        half the distance between compared disparities. Synthesis: whether the refinement ended near its minimum,
        within 0.003 px in 95 % of the pixels ("paper-exact": 0.001 px).
    trace
        One number per iteration. Matching: the root mean square step of the alignment, pixels per view step. Synthesis:
        the energy of the refinement, beginning with the energy before the first iteration.
    timings
        Seconds by name: `compile`, until kernels were compiled and loaded; `measure`, for range, noise and memory; each
        stage, or `run` for all that a GPU was given at once; and `total`, the sum. The first two are only there where
        they were a part of the run.
    backend, device
        The backend and the device that computed it.
    versions
        Versions of lfgpu, of the package of the backend, and of other packages.
    geometry
        The camera geometry; None if unknown.
    name
        The name of the light field.
    uncertainty
        float32 [y, x], the expected error of the disparity as a standard deviation, pixels per view step; NaN where the
        disparity is. None if the method does not tell (synthesis).
    notes
        Doubts about the map, one sentence each: the views show nothing, or the given range excludes them; surfaces may
        lie beyond the range; the map is confident nowhere.
    remarks
        Faults of the cameras, one sentence each, from `lfgpu.judged`, which lowers the confidence accordingly; empty if
        there is none, or if nobody looked. `lfgpu.estimate_depth` looks.
    """

    disparity: Float32Array
    confidence: Float32Array
    stages: dict[str, Float32Array]
    position: tuple[float, float]
    disparity_range: tuple[float, float]
    config: Config
    status: str
    converged: bool
    trace: tuple[float, ...]
    timings: dict[str, float]
    backend: str
    device: str
    versions: dict[str, str] = field(default_factory=dict)
    geometry: Geometry | None = None
    name: str = "light field"
    uncertainty: Float32Array | None = None
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def depth(self) -> NDArray[np.float32] | None:
        """Metric depth in metres, float32 [y, x], infinity beyond the horizon; None without a geometry."""
        return None if self.geometry is None else self.geometry.depth(self.disparity).astype(np.float32)

    @property
    def seconds(self) -> float | None:
        """The time of the estimate in seconds, without that for compiling kernels; None if it was not measured."""
        total = self.timings.get("total")
        return None if total is None else max(total - self.timings.get("compile", 0.0), 0.0)

    @property
    def disparity_stages(self) -> dict[str, Float32Array]:
        """The disparity maps among `stages`: all but the coherences."""
        return {name: map_ for name, map_ in self.stages.items() if not name.startswith("coherence")}

    def __repr__(self) -> str:
        notes = "".join(f"\n note: {note}" for note in (*self.notes, *self.remarks))
        took = "" if self.seconds is None else f", {self.seconds:.3g} s"
        return (
            f"<DepthResult {_map_lines(self.map)}\n "
            f"{self.config.method} with {self.backend} on {self.device}{took}; stages {', '.join(self.stages)}{notes}>"
        )

    @property
    def map(self) -> DisparityMap:
        """The map, with its metadata."""
        return DisparityMap(
            self.disparity,
            self.confidence,
            position=self.position,
            geometry=self.geometry,
            name=self.name,
            versions=self.versions,
            uncertainty=self.uncertainty,
        )

    def save(self, path: str | os.PathLike[str], *, image: ArrayLike | None = None) -> None:
        """Write the result (.npz), its map (.pfm, .png, .tif, .exr) or its point cloud (.ply); see `lfgpu.save`."""
        hooks.save(self, path, image=image)


@dataclass(frozen=True, eq=False)
class DisparityMap(summary.InNotebooks):
    """A disparity map of one view, with its metadata: the contents of a map file.

    Parameters
    ----------
    disparity
        float32 [y, x], as in `DepthResult`; NaN where unknown.
    confidence
        float32 [y, x], 0 to 1; None if unknown.
    position
        (u, v) of the view, as in `LightField.positions`; None if unknown.
    geometry
        The camera geometry; None if unknown.
    name
        The name of the light field.
    versions
        Versions of the packages that computed it.
    uncertainty
        float32 [y, x], as in `DepthResult`; None if unknown.

    Raises
    ------
    LightFieldError
        If a map is no array of numbers [y, x], or they differ in shape.
    """

    disparity: Float32Array
    confidence: Float32Array | None = None
    position: tuple[float, float] | None = None
    geometry: Geometry | None = None
    name: str = "light field"
    versions: dict[str, str] = field(default_factory=dict)
    uncertainty: Float32Array | None = None

    def __post_init__(self) -> None:
        for name in ("disparity", "confidence", "uncertainty"):
            if (given := getattr(self, name)) is None and name != "disparity":
                continue
            values = array_of_numbers(name, given, np.float32)
            object.__setattr__(self, name, values)
            if values.ndim != 2 or values.shape != self.disparity.shape:
                shape = "[y, x]" if name == "disparity" else f"{self.disparity.shape}, as the disparity is"
                raise LightFieldError(f"{name} must be {shape}, found shape {values.shape}.")

    def __repr__(self) -> str:
        return f"<DisparityMap {_map_lines(self)}>"

    @property
    def depth(self) -> NDArray[np.float32] | None:
        """Metric depth in metres, float32 [y, x], infinity beyond the horizon; None without a geometry."""
        return None if self.geometry is None else self.geometry.depth(self.disparity).astype(np.float32)

    @property
    def known_maps(self) -> dict[str, Float32Array]:
        """Disparity, confidence, uncertainty and depth by name, float32 [y, x], as far as they are known."""
        maps = {name: getattr(self, name) for name in ("disparity", "confidence", "uncertainty", "depth")}
        return {name: values for name, values in maps.items() if values is not None}

    def save(self, path: str | os.PathLike[str], *, image: ArrayLike | None = None) -> None:
        """Write the map (.npz, .pfm, .png, .tif, .exr) or its point cloud (.ply); see `lfgpu.save`."""
        hooks.save(self, path, image=image)


def _map_lines(values: DisparityMap) -> str:
    """Describe a map in two lines."""
    where = "" if values.position is None else f", view at {summary.view_at(values.position)}"
    lines = [
        f"{values.name!r}: {summary.pixels(values.disparity.shape)}{where}",
        f" disparity {summary.span(values.disparity, summary.UNIT)}",
    ]
    if values.depth is not None:
        lines[1] += f"; depth {summary.span(values.depth, 'm')}"
    if values.confidence is not None:
        lines[1] += f"; confidence {np.nanmean(values.confidence):.2f} on average"
    return "\n".join(lines)


def check_result(result: object, *others: type) -> None:
    """Raise LightFieldError unless `result` is what `estimate_depth` returned, or of one of the `others`."""
    if not isinstance(result, (DepthResult, *others)):
        a_map = ", or a map: lfgpu.DisparityMap(disparity);" if others else ","
        raise LightFieldError(f"result must be what an estimate returned{a_map} found {type(result).__name__}.")
