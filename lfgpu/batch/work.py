"""Work on one item: read, estimate, score, write. It runs in any process and does not use Dask."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfgpu._backends import DEFAULT, BackendName, load, pick_device
from lfgpu.batch.items import ERROR_FILE, ITEM_FILES, PREVIEW_FILE, VIEW_FILE, Item
from lfgpu.batch.manifest import DONE, FAILED
from lfgpu.config import Config
from lfgpu.data.mapping import forget
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.io.map_formats import REPORT_FILE
from lfgpu.methods import method_of
from lfgpu.methods.measured import Measured
from lfgpu.printable import message

if TYPE_CHECKING:
    from lfgpu.data import DepthResult, LightField
    from lfgpu.pipelines.resident import Resident

_PREVIEW = 512 * 512  # pixels at most of the pictures for the page
_MEMORY = "out of memory; use fewer views (--views cross), smaller ones, or fewer workers."


@dataclass(frozen=True)
class Settings:
    """The settings of the estimate of all items."""

    config: Config
    disparity_range: tuple[float, float] | None = None
    place: tuple[float, float] | None = None  # (row, column) of the reference view; None for the default of the reader
    pattern: str = "full"
    reading: Mapping[str, Any] = field(default_factory=dict)  # keywords of `lfgpu.read`
    backend: BackendName = DEFAULT
    deterministic: bool = False
    report: bool = False  # write a report of each item; results do not depend on it
    command: str = ""  # the command line, for the reports

    @property
    def options(self) -> dict[str, Any]:
        """All settings that results depend on, without the parameters of the method, as JSON values."""
        return {
            "disparity_range": None if self.disparity_range is None else list(self.disparity_range),
            "reference_view": None if self.place is None else list(self.place),
            "views": self.pattern,
            "reading": dict(self.reading),
            "backend": self.backend,
        }


@dataclass(frozen=True)
class Job:
    """Item with all that a worker needs for it."""

    item: Item
    settings: Settings
    out: str
    first: tuple[Item, ...] = ()  # first frames of its sequence; range and noise are measured on the first readable one
    keys: Mapping[str, str] = field(default_factory=dict)  # hashes of parameters and files, for the manifest

    @property
    def entry(self) -> dict[str, Any]:
        """The beginning of its manifest entry, as long as it has not succeeded."""
        return {"item": self.item.name, "input": self.item.source, "status": FAILED, **self.keys}


class OutOfMemory(Exception):  # noqa: N818 - a state, after which a retry may succeed
    """An item did not fit into memory together with everything else that runs."""


def work(job: Job, device: str | None = None) -> dict[str, Any]:
    """Do an item on a device; returns its manifest entry, with its errors. OutOfMemory is raised, to try again."""
    began, start, entry = time.time(), time.perf_counter(), job.entry
    try:
        entry |= {**_done(job, device), "status": DONE}
    except MemoryError as error:
        raise OutOfMemory(_MEMORY) from error
    except LfgpuError as error:
        entry["error"] = str(error)
    except Exception as error:  # the other items must continue, whatever it is
        if "Failed to allocate" in str(error):  # the message of Warp
            raise OutOfMemory(_MEMORY) from error
        entry["error"] = message(f"{type(error).__name__}: {error}")
    return {**entry, "began": began, "seconds": round(time.perf_counter() - start, 4)}


def _done(job: Job, device: str | None) -> dict[str, Any]:
    from lfgpu.io import RESULT_FILE, atomic_folder
    from lfgpu.pipelines.verdict import judged

    clock = _Clock()
    lf = _read(job.item, job.settings)
    clock.lap("read")
    result = _estimate(lf, job, pick_device(load(job.settings.backend), device))
    clock.lap("estimate")
    if not job.item.sequence:  # it would be said of each frame
        settings = job.settings
        result = judged(
            lf, result, disparity_range=settings.disparity_range, backend=settings.backend, device=result.device
        )
    clock.lap("judge")
    scores = _scores(lf, result)
    out = Path(job.out, job.item.name)
    out.parent.mkdir(parents=True, exist_ok=True)  # other workers may create it at the same time
    with atomic_folder(out, ours=ITEM_FILES, mark=RESULT_FILE) as folder:
        scale = _write(folder, lf, result)
        if job.settings.report:
            _write_report(folder, lf, result, job)
        sizes = {file.name: file.stat().st_size for file in sorted(folder.iterdir())}
    clock.lap("write")
    low, high = result.disparity_range
    return {
        "sizes": sizes,
        "scale": scale,
        "metrics": scores,
        "disparity_range": [low, high],
        "views": len(lf.views),
        "size": list(lf.size),
        "device": result.device,
        "converged": result.converged,
        "notes": [*lf.notes, *result.notes],
        "remarks": list(result.remarks),
        "times": clock.laps,
    }


def _read(item: Item, settings: Settings) -> LightField:
    from lfgpu.io import read
    from lfgpu.pipelines.verdict import needed_views

    options = {**settings.reading, **({} if item.frame is None else {"frame": item.frame})}
    if settings.place is None and not settings.report:
        options["needed"] = needed_views(settings.config, settings.pattern)
    lf = read(item.source, **options)
    if settings.place is not None:
        lf = lf.with_reference(lf.index_of(*settings.place))
    return lf if settings.pattern == "full" else lf.subset(settings.pattern)


def _estimate(lf: LightField, job: Job, device: str) -> DepthResult:
    settings, start = job.settings, time.perf_counter()
    measured = _measured(job.first, settings, device) if job.first else None
    result = _resident().estimate(
        lf,
        measured or method_of(settings.config).given(lf.layout, settings.disparity_range),
        config=settings.config,
        disparity_range=settings.disparity_range,
        backend=settings.backend,
        device=device,
        deterministic=settings.deterministic,
    )
    return replace(result, timings={"total": time.perf_counter() - start})


@cache
def _resident() -> Resident:
    """Return the pipeline that this process keeps."""
    from lfgpu.pipelines.resident import Resident

    return Resident(most=1)


def _measured(first: tuple[Item, ...], settings: Settings, device: str) -> Measured | None:
    """Measure range and noise of a sequence on its first readable frame; None if no frame is readable."""
    from lfgpu.pipelines.pipeline import measured_on

    key = (first, device, repr(settings))
    if key not in _MEASURED:
        _MEASURED[key] = None
        for item in first:
            with suppress(LfgpuError):  # the frame reports its error when it is its turn
                lf = _read(item, settings)
                _MEASURED[key], _ = measured_on(
                    lf,
                    config=settings.config,
                    disparity_range=settings.disparity_range,
                    backend=settings.backend,
                    device=device,
                )
                forget(lf.views)
                break
    return _MEASURED[key]


_MEASURED: dict[Any, Measured | None] = {}


def _scores(lf: LightField, result: DepthResult) -> dict[str, float | None] | None:
    """Compute the metrics by name, None if not finite; or None if the truth of the reference view is unknown."""
    from lfgpu.metrics import evaluate

    truth = lf.reference_truth()
    if truth is None:
        return None
    try:
        scores = asdict(evaluate(result.disparity, truth.disparity, mask=truth.mask))
        return {name: value if math.isfinite(value) else None for name, value in scores.items()}
    except LightFieldError:  # too small to be scored
        return None


def _write(folder: Path, lf: LightField, result: DepthResult) -> dict[str, float]:
    """Write a result and its pictures into an existing folder; returns the scale of the picture of the map."""
    from lfgpu.io import DEPTH_FILE, DISPARITY_FILE, RESULT_FILE, save, write_pfm
    from lfgpu.viz.cards import SAVING, limits_of, map_image, view_image
    from lfgpu.viz.panels import rgb
    from lfgpu.viz.scales import ERRORS

    write_pfm(folder / DISPARITY_FILE, result.disparity)
    save(result, folder / RESULT_FILE)
    if (depth := result.depth) is not None:
        write_pfm(folder / DEPTH_FILE, depth)
    low, high = limits = limits_of("disparity", result.disparity)
    view = view_image(rgb(lf.views[lf.reference_index], lf.scale), most=_PREVIEW)
    view.save(folder / VIEW_FILE, **SAVING["JPEG"])
    map_image(result.disparity, "disparity", limits, most=_PREVIEW).save(folder / PREVIEW_FILE, **SAVING["PNG"])
    if (truth := lf.reference_truth()) is not None:
        error = map_image(result.disparity - truth.scored, "error", ERRORS, most=_PREVIEW)
        error.save(folder / ERROR_FILE, **SAVING["PNG"])
    known = result.disparity[np.isfinite(result.disparity)]
    return {
        "low": low,
        "high": high,
        "below": int((known < low).sum()),
        "above": int((known > high).sum()),
        "undefined": result.disparity.size - known.size,
    }


def _write_report(folder: Path, lf: LightField, result: DepthResult, job: Job) -> None:
    """Write the report of an item. It leaves out what the map predicts, which takes longer than the map."""
    from lfgpu.reports.report import Origin, write_report

    origin = Origin.now(job.item.source, job.settings.command, result.device)
    write_report(folder / REPORT_FILE, lf, result, origin=origin)


class _Clock:
    """Stopwatch of consecutive steps, seconds."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = round(now - self._last, 4)
        self._last = now
