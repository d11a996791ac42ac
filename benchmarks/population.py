"""How far presets are from the truth on a population of light fields, with the range found and with the true one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import cases, clock, machine
from benchmarks.errors import BenchmarkError
from benchmarks.pipelines import METRICS
from benchmarks.results import Record, Run
from lfgpu import DepthResult, LightField, estimate_depth, evaluate, read, scenes
from lfgpu.data.lightfield import GroundTruth
from lfgpu.errors import LfgpuError
from lfgpu.methods import preset as named_preset
from lfgpu.metrics import BORDER, sparsification
from lfgpu.threads import get_threads
from lfgpu.viz.panels import rgb

KIND = "accuracy"
BASELINE = Path(__file__).with_name("results") / "accuracy-0.1.json"
"""Version 0.1, that later versions are held against."""
PRESETS = ("fast", "accurate")
RANGES = ("found", "true")
"""The range of disparities: found by the estimate, or the true one and 0.1 px on either side."""
_MARGIN = 0.1  # pixels per view step
_WARM_UP = (48, 48)  # pixels
_WARM_UP_RANGE = (-1.5, 1.5)  # that of the package's scenes

Say = Callable[[str], None]


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


def light_fields(folders: Sequence[Path]) -> dict[str, Path]:
    """The light fields in folders, by name: each is one, or holds some; BenchmarkError where there is none."""
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


def made(name: str) -> Callable[[], LightField]:
    """A scene of the package by name and case, "boxes-7x7x375x375"; BenchmarkError if there is none such."""
    scene, _, case = name.partition("-")
    if scene not in scenes.NAMES:
        raise BenchmarkError(f"unknown scene {name!r}; write NAME-CASE with one of {', '.join(scenes.NAMES)}.")
    size = cases.parse(case)
    return lambda: scenes.make(scene, grid=size.grid, size=size.size)


def run(
    folders: Sequence[Path],
    presets: Sequence[str],
    ranges: Sequence[str],
    say: Say,
    draw: Callable[[Picture], None],
    others: Mapping[str, Callable[[], LightField]] | None = None,
) -> Run:
    """Estimate each light field with each preset and range.

    `say` is told what is being estimated, `draw` is given what came out. What fails is a record that says why.
    `others` are light fields besides, by name.
    """
    load, date = machine.load_average(), datetime.now(UTC).isoformat(timespec="seconds")
    records: list[Record] = []
    sources: dict[str, Callable[[], LightField]] = {
        **{name: partial(read, path) for name, path in light_fields(folders).items()},
        **(others or {}),
    }
    for scene, source in sources.items():
        try:
            lf = source()
            truth = _truth(lf)
        except LfgpuError as error:
            records.append(Record(KIND, "", "", scene, "all presets", failed=str(error)))
            continue
        for preset in presets:
            _load_kernels(preset)
            for given in ranges:
                say(f"{scene}: {preset}, range {given}")
                record, picture = _measured(scene, lf, truth, preset, given)
                records.append(record)
                if picture is not None:
                    draw(picture)
    return Run(date, machine.describe(), machine.versions(), machine.commit(), get_threads(), load, records, [])


def _is_scene(path: Path) -> bool:
    return path.is_dir() and any(path.glob("*.pfm"))


def _truth(lf: LightField) -> GroundTruth:
    truth = lf.reference_truth()
    if truth is None:
        raise BenchmarkError(f"{lf.name} has no truth of its reference view to score by")
    return truth


@cache
def _load_kernels(preset: str) -> None:
    """What a process does once, before anything is timed."""
    estimate_depth(
        scenes.make("boxes", grid=(9, 9), size=_WARM_UP), config=named_preset(preset), disparity_range=_WARM_UP_RANGE
    )


def _measured(scene: str, lf: LightField, truth: GroundTruth, preset: str, given: str) -> tuple[Record, Picture | None]:
    name = f"{preset}, range {given}"
    low, high = float(np.nanmin(truth.disparity)), float(np.nanmax(truth.disparity))
    try:
        result = estimate_depth(
            lf,
            config=named_preset(preset),
            disparity_range=None if given == "found" else (low - _MARGIN, high + _MARGIN),
        )
    except LfgpuError as error:
        return Record(KIND, "", "", scene, name, failed=str(error)), None
    metrics = evaluate(result.disparity, truth.disparity, mask=truth.mask)
    curve = sparsification(result.disparity, result.confidence, truth.disparity, mask=truth.mask)
    first, last = result.disparity_range
    record = Record(
        KIND,
        result.backend,
        result.device,
        scene,
        name,
        clock.spread([result.timings["total"]]),
        errors={**{m: getattr(metrics, m) for m in METRICS}, "ause": curve.ause, "span": (last - first) / (high - low)},
        compared=f"truth of the data set, {metrics.count} pixels",
        details={"preset": preset, "range": given, "searched": [first, last], "true": [low, high]},
    )
    return record, Picture(
        scene, name, rgb(lf.views[lf.reference_index], lf.scale), _scored_error(result, truth), metrics.badpix_07
    )


def _scored_error(result: DepthResult, truth: GroundTruth) -> NDArray[np.float32]:
    error = np.full(result.disparity.shape, np.nan, np.float32)
    inside = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    error[inside] = (result.disparity - truth.disparity)[inside]
    if truth.mask is not None:
        error[~truth.mask] = np.nan
    return error
