"""How far maps in 2 x 2 tiles are from those in one piece, after each stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from benchmarks import machine
from benchmarks.errors import BenchmarkError
from lfgpu import LightField, estimate_depth, scenes
from lfgpu._backends import load
from lfgpu.data.result import DepthResult
from lfgpu.methods import method_of
from lfgpu.methods import preset as named
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


def run(presets: Sequence[str], chosen: Sequence[Scene] = SCENES) -> list[dict[str, Any]]:
    """A row for each scene, preset and stage: largest difference, shares above thresholds."""
    rows: list[dict[str, Any]] = []
    for scene in chosen:
        lf = scenes.make(scene.name, grid=(5, 5), size=scene.size, noise=scene.noise)
        for preset in presets:
            whole = estimate_depth(lf, config=named(preset), disparity_range=RANGE, device="cpu")
            cut = _in_four(lf, preset)
            for stage, values in whole.disparity_stages.items():
                apart = np.abs(values - cut.stages[stage])
                apart = apart[np.isfinite(apart)]
                shares = {
                    f"above {limit:g}": round(float(100 * (apart > limit).mean()), 6) for limit in (1e-6, 1e-3, 1e-2)
                }
                what = {"scene": scene.name, "size": scene.size, "preset": preset, "stage": stage}
                rows.append({**what, "largest": round(float(apart.max()), 6), **shares})
    return rows


def _in_four(lf: LightField, preset: str) -> DepthResult:
    """The estimate with the most memory that needs 2 x 2 tiles."""
    method = method_of(preset)
    measured = method.measure(lf, load("warp"), "cpu", disparity_range=RANGE)
    edge = method.halo(lf.layout, measured)
    (_, height), (_, width) = (tiles._cuts(side, e)[1] for side, e in zip(lf.size, edge, strict=True))
    memory = method.footprint(lf.layout, measured, on_gpu=False).bytes(height, width)
    memory += lf.views.nbytes + 4 * 8 * lf.size[0] * lf.size[1]  # what the process holds beside a tile
    result = estimate_depth(lf, config=named(preset), disparity_range=RANGE, device="cpu", max_memory=memory)
    if "4 tiles" not in result.status:
        raise BenchmarkError(f"{lf.name} with {preset} was not cut into 4 tiles: {result.status}")
    return result


def about() -> dict[str, object]:
    """When, where and with what."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": machine.commit(),
        "machine": machine.describe(),
        "versions": machine.versions(),
    }
