"""Differences of maps in 2 x 2 tiles from those in one piece, after each stage."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.errors import BenchmarkError
from benchmarks.options import Out, Presets, collected, listed, say
from benchmarks.tables import Columns, Table
from lfgpu import LightField, estimate_depth, scenes
from lfgpu._backends import open_device
from lfgpu.data import DepthResult
from lfgpu.methods import method_of, preset as named
from lfgpu.pipelines import tiles

RANGE = (-1.6, 1.7)


@dataclass(frozen=True)
class Scene:
    """A scene of the package with noise, `size` = (height, width)."""

    name: str
    size: tuple[int, int]
    noise: float = 0.0


SCENES = (
    Scene("boxes", (520, 540)),
    Scene("textureless", (520, 540), 0.01),
    Scene("textureless", (720, 760), 0.01),  # with patches larger than the halo
)


def command(presets: Presets = "fast,accurate", out: Out = None) -> None:
    """Compare maps in 2 x 2 tiles with those in one piece, after each stage."""
    table(collected(run(listed(presets)), out, benchmark="tile_differences")).show()


def run(presets: Sequence[str], chosen: Sequence[Scene] = SCENES) -> Iterator[dict[str, Any]]:
    """Yield for each scene, preset and stage the largest difference and shares above thresholds, in per cent."""
    for scene in chosen:
        lf = scenes.make(scene.name, grid=(5, 5), size=scene.size, noise=scene.noise)
        for preset in presets:
            say(f"{scene.name} {scene.size} {preset}")
            whole = estimate_depth(lf, config=named(preset), disparity_range=RANGE, device="cpu")
            cut = _in_four(lf, preset)
            for stage, values in whole.disparity_stages.items():
                apart = np.abs(values - cut.stages[stage])
                apart = apart[np.isfinite(apart)]
                shares = {
                    f"above {limit:g}": round(float(100 * (apart > limit).mean()), 6) for limit in (1e-6, 1e-3, 1e-2)
                }
                what = {"scene": scene.name, "size": scene.size, "preset": preset, "stage": stage}
                yield {**what, "largest": round(float(apart.max()), 6), **shares}


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Make the table."""
    columns: Columns = {
        "scene": "`{scene}`",
        "size": "{size[0]} × {size[1]}",
        "preset": "`{preset}`",
        "stage": "{stage}",
        "largest, px": "{largest:.2g}",
        "share above 0.001 px": lambda r: f"{r['above 0.001']:.2f} %",
        "share above 0.01 px": lambda r: f"{r['above 0.01']:.2f} %",
    }
    return Table.of("", 4, rows, columns)


def _in_four(lf: LightField, preset: str) -> DepthResult:
    """Estimate with the most memory that needs 2 x 2 tiles."""
    method = method_of(preset)
    measured = method.measure(lf, open_device(device="cpu"), disparity_range=RANGE)
    edge = method.halo(lf.layout, measured)
    (_, height), (_, width) = (tiles._cuts(side, e)[1] for side, e in zip(lf.size, edge, strict=True))
    memory = method.footprint(lf.layout, measured, on_gpu=False).bytes(height, width)
    memory += lf.views.nbytes + 4 * 8 * lf.size[0] * lf.size[1]  # what the process holds beside a tile
    result = estimate_depth(lf, config=named(preset), disparity_range=RANGE, device="cpu", max_memory=memory)
    if "4 tiles" not in result.status:
        raise BenchmarkError(f"{lf.name} with {preset} was not cut into 4 tiles: {result.status}")
    return result
