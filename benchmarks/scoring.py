"""Light fields whose truth is known, and errors of their maps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.errors import BenchmarkError
from lfgpu import GroundTruth, LightField, estimate_depth, scenes
from lfgpu.config import Config
from lfgpu.metrics import Metrics

METRICS = ("mse_100", "badpix_07", "badpix_03", "badpix_01", "q25")
MARGIN = 0.1
"""Pixels per view step on either side of the true range, where a map is estimated within that."""

_WARM_UP, _WARM_UP_RANGE = (48, 48), (-1.5, 1.5)  # pixels; disparities of the package's scenes


def light_fields(folders: Sequence[Path]) -> dict[str, Path]:
    """Find light fields with truth by name: each folder is one, or holds some; BenchmarkError where there is none."""
    found: dict[str, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise BenchmarkError(f"{folder} is no folder; give one that is a light field or holds some.")
        some = [folder] if _is_scene(folder) else [path for path in sorted(folder.iterdir()) if _is_scene(path)]
        if not some:
            raise BenchmarkError(f"{folder} holds no light field with a map of the truth (.pfm) beside its views.")
        for path in some:
            if found.setdefault(path.name, path) != path:
                raise BenchmarkError(f"{found[path.name]} and {path} have the same name; give one of them.")
    return found


def truth_of(lf: LightField) -> GroundTruth:
    """Return the truth of the reference view; BenchmarkError if there is none."""
    truth = lf.reference_truth()
    if truth is None:
        raise BenchmarkError(f"{lf.name} has no truth of its reference view to score by.")
    return truth


def true_range(lf: LightField, margin: float = MARGIN) -> tuple[float, float]:
    """Return the true range of disparities, wider by `margin` on either side."""
    disparity = truth_of(lf).disparity
    return float(np.nanmin(disparity)) - margin, float(np.nanmax(disparity)) + margin


def errors(metrics: Metrics) -> dict[str, float]:
    """Return the errors that records hold."""
    return {name: getattr(metrics, name) for name in METRICS}


@cache
def load_kernels(config: Config) -> None:
    """Load the kernels of a method, so that this is not timed."""
    lf = scenes.make("boxes", grid=(9, 9), size=_WARM_UP)
    estimate_depth(lf, config=config, disparity_range=_WARM_UP_RANGE)


def _is_scene(path: Path) -> bool:
    return path.is_dir() and any(path.glob("*.pfm"))
