"""A light field of the Stanford gantry's size within a given memory: time, peak memory, and the error of the map.

The scene is three textured planes before each other, painted from back to front: to cast 289 views would take minutes.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks import cases, memory, processes
from benchmarks.cases import Case
from benchmarks.errors import BenchmarkError
from benchmarks.options import CaseName, Preset, listed
from lfgpu import estimate_depth, evaluate, read
from lfgpu.methods import configured
from lfgpu.threads import in_threads

_PLANES = ((-1.2, None), (0.3, (0.15, 0.75, 0.10, 0.45)), (1.6, (0.40, 0.90, 0.55, 0.90)))
"""Disparity, and (top, bottom, left, right) as shares of the reference view; None is all of it."""
_GRAIN = (1.2, 3.0, 8.0)  # pixels


def command(
    case_name: CaseName = "17x17x960x1280",
    preset: Preset = "accurate",
    device: Annotated[str | None, typer.Option(metavar="NAME", help="Default: all GPUs, or the CPU.")] = None,
    max_memory: Annotated[
        str, typer.Option(metavar="SIZE,...", help='One estimate for each; "none" for no limit and no tiles.')
    ] = "8GiB",
) -> None:
    """Estimate a light field of planes within a given memory; print the time and the memory that it took."""
    limits = [None if name == "none" else name for name in listed(max_memory)]
    for found in measure(cases.parse(case_name), preset, device, limits):
        for name, value in found.items():
            typer.echo(f"{name:<12} {value}")


def measure(case: Case, preset: str, device: str | None, limits: Sequence[str | None]) -> Iterator[dict[str, Any]]:
    """Paint the scene into a file, and estimate it from there within each limit; None is none."""
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        path = Path(folder, "views.npy")
        truth = paint(case, path)
        for limit in limits:
            # A process for each, so that no memory is left from the one before.
            arguments = path, truth, preset, device, limit
            found, failure = processes.collect(_measured, *arguments, variables={}, timeout=math.inf)
            if failure:
                raise BenchmarkError(f"{case.name} {preset} within {limit}: {failure}")
            yield {"case": case.name, "preset": preset, "max_memory": limit, **found[0]}


def _measured(
    path: Path, truth: NDArray[np.float32], preset: str, device: str | None, limit: str | None
) -> Iterator[dict[str, Any]]:
    used = memory.gpu_used()
    with memory.GpuPeak() as peak:
        start = perf_counter()
        lf = read(path, lazy=limit is not None)
        result = estimate_depth(lf, config=configured(preset), device=device, max_memory=limit)
        seconds = perf_counter() - start
    yield {
        "device": result.device,
        "status": result.status,
        "seconds": seconds,
        "host_bytes": memory.host_peak(),
        "gpu_bytes": None if peak.bytes is None or used is None else peak.bytes - used,
        "timings": {name: round(value, 4) for name, value in result.timings.items()},
        "error": str(evaluate(result.disparity, truth)),
    }


def paint(case: Case, path: Path, seed: int = 0) -> NDArray[np.float32]:
    """Write the views [v, u, y, x, c] to an .npy file; return the true disparity of the middle one, [y, x]."""
    (rows, columns), (height, width) = case.grid, case.size
    edge = int(np.ceil(max(abs(d) for d, _ in _PLANES) * (max(rows, columns) // 2))) + 2
    rng = np.random.default_rng(seed)
    planes = [(d, _texture(rng, height, width, edge), _mask(height, width, edge, place)) for d, place in _PLANES]
    views = np.lib.format.open_memmap(path, "w+", np.uint8, (rows, columns, height, width, 3))

    def paint_view(place: tuple[int, int]) -> None:
        image = np.zeros((height, width, 3), np.float32)
        for d, texture, mask in planes:
            # What is at x in the middle view is at x - d du here: at x there is what is at x + d du.
            shift = edge + d * (place[0] - rows // 2), edge + d * (place[1] - columns // 2)
            covered = _window(mask, shift, (height, width))
            image += covered * (_window(texture, shift, (height, width)) - image)
        views[place] = np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)

    in_threads(paint_view, np.ndindex(rows, columns))
    views.flush()
    truth = np.empty((height, width), np.float32)
    for d, _, mask in planes:
        truth[mask[edge : edge + height, edge : edge + width, 0] > 0] = d
    return truth


def _texture(rng: np.random.Generator, height: int, width: int, edge: int) -> NDArray[np.float32]:
    noise = rng.random((height + 2 * edge + 1, width + 2 * edge + 1, 3), np.float32)
    total = sum(scale * gaussian_filter(noise, (scale, scale, 0)) for scale in _GRAIN)
    return np.asarray((total - np.min(total)) / np.ptp(total), np.float32)


def _mask(height: int, width: int, edge: int, place: tuple[float, float, float, float] | None) -> NDArray[np.float32]:
    mask = np.zeros((height + 2 * edge + 1, width + 2 * edge + 1, 1), np.float32)
    top, bottom, left, right = place or (-1.0, 2.0, -1.0, 2.0)
    rows = slice(max(0, edge + int(top * height)), max(0, edge + int(bottom * height)))
    mask[rows, max(0, edge + int(left * width)) : max(0, edge + int(right * width))] = 1
    return mask


def _window(image: NDArray[np.float32], shift: tuple[float, float], size: tuple[int, int]) -> NDArray[np.float32]:
    """Cut a window that lies `shift` (y, x) pixels into an image, interpolated."""
    (y, x), (height, width) = (int(np.floor(s)) for s in shift), size
    ay, ax = shift[0] - y, shift[1] - x
    part = image[y : y + height + 1, x : x + width + 1]
    rows = part[:-1] + np.float32(ay) * (part[1:] - part[:-1])
    return np.asarray(rows[:, :-1] + np.float32(ax) * (rows[:, 1:] - rows[:, :-1]))
