"""A light field of the Stanford gantry's size within a given memory: time, peak memory, and the error of the map.

The scene is three textured planes before each other, painted from back to front: to cast 289 views would take minutes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks import memory
from benchmarks.cases import Case
from lfgpu import DepthResult, LightField, estimate_depth, evaluate, read

_PLANES = ((-1.2, None), (0.3, (0.15, 0.75, 0.10, 0.45)), (1.6, (0.40, 0.90, 0.55, 0.90)))
"""Disparity, and (top, bottom, left, right) as shares of the reference view; None is all of it."""
_GRAIN = (1.2, 3.0, 8.0)  # pixels


def measure(case: Case, preset: str, device: str | None, max_memory: str | None) -> dict[str, Any]:
    """Paint the scene into a file, estimate it from there, and say what that took."""
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        path = Path(folder, "views.npy")
        truth = paint(case, path)
        lf = read(path, lazy=max_memory is not None)
        memory.reset_host_peak()
        before, start = memory.gpu_used(), perf_counter()
        with memory.GpuPeak() as peak:
            result = _estimate(lf, preset, device, max_memory)
        seconds = perf_counter() - start
        gpu = None if peak.bytes is None or before is None else peak.bytes - before
        return {
            "case": case.name,
            "preset": preset,
            "device": result.device,
            "max_memory": max_memory,
            "status": result.status,
            "seconds": seconds,
            "host_bytes": memory.host_peak(),
            "gpu_bytes": gpu,
            "error": str(evaluate(result.disparity, truth)),
        }


def paint(case: Case, path: Path, seed: int = 0) -> NDArray[np.float32]:
    """Write the views [v, u, y, x, c] to an .npy file; the true disparity of the middle one, [y, x]."""
    (rows, columns), (height, width) = case.grid, case.size
    edge = int(np.ceil(max(abs(d) for d, _ in _PLANES) * (max(rows, columns) // 2))) + 2
    rng = np.random.default_rng(seed)
    planes = [(d, _texture(rng, height, width, edge), _mask(height, width, edge, place)) for d, place in _PLANES]
    views = np.lib.format.open_memmap(path, "w+", np.uint8, (rows, columns, height, width, 3))
    for v in range(rows):
        for u in range(columns):
            image = np.zeros((height, width, 3), np.float32)
            for d, texture, mask in planes:
                # What is at x in the middle view is at x - d du here: at x there is what is at x + d du.
                shift = edge + d * (v - rows // 2), edge + d * (u - columns // 2)
                covered = _window(mask, shift, (height, width))
                image += covered * (_window(texture, shift, (height, width)) - image)
            views[v, u] = np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)
    views.flush()
    truth = np.empty((height, width), np.float32)
    for d, _, mask in planes:
        truth[mask[edge : edge + height, edge : edge + width, 0] > 0] = d
    return truth


def _estimate(lf: LightField, preset: str, device: str | None, max_memory: str | None) -> DepthResult:
    return estimate_depth(lf, config=preset, device=device, max_memory=max_memory)


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
    """What lies `shift` (y, x) pixels into an image, interpolated."""
    (y, x), (height, width) = (int(np.floor(s)) for s in shift), size
    ay, ax = shift[0] - y, shift[1] - x
    part = image[y : y + height + 1, x : x + width + 1]
    rows = part[:-1] + np.float32(ay) * (part[1:] - part[:-1])
    return np.asarray(rows[:, :-1] + np.float32(ax) * (rows[:, 1:] - rows[:, :-1]))
