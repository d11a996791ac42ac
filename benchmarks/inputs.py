"""Host arrays that the operations read, by name: the same for every backend, like those that the method makes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import CHANNELS, Case
from lfgpu.contract import REDUCTION, half_window
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.sweep import labels
from lfgpu.methods.synthesis.config import SynthesisConfig

LARGEST_DISPARITY = 1.5  # pixels per view step, either way
CONFIG = SynthesisConfig()
MATCHING = MatchingConfig()
BYTE = 1 / 255
"""The intensity of one step of a uint8 view."""

_EXACT = 64  # steps of a disparity in one: their products with offsets have no rounding in float32
_NO_TIE = 0.00137  # pixels per view step: no difference of labels, levels and tolerances
_TILE = 24  # pixels


def offsets(case: Case) -> NDArray[np.float32]:
    """[n, 2], (du, dv) of all views; the reference is the one in the middle."""
    rows, columns = case.grid
    v, u = np.mgrid[:rows, :columns].reshape(2, -1)
    return np.stack([u - columns // 2, v - rows // 2], axis=1).astype(np.float32)


def line_offsets(case: Case) -> NDArray[np.float32]:
    """[u], du of the views in the reference's row, itself included."""
    columns = case.grid[1]
    return np.arange(columns, dtype=np.float32) - columns // 2


@cache
def image(case: Case) -> NDArray[np.float32]:
    """[y, x, c]: coarse and fine waves with a little noise, in [0, 1]."""
    rng = _rng(case, 1)
    pattern = np.stack([_waves(case, rng, (4, 8, 16, 40, 90)) for _ in range(CHANNELS)], axis=-1)
    return np.clip(0.5 + 0.35 * pattern + rng.normal(0, 0.01, pattern.shape), 0, 1).astype(np.float32)


@cache
def disparity(case: Case) -> NDArray[np.float32]:
    """[y, x]: a smooth map that spans the disparities, as a refined one does nearly everywhere."""
    waves = _waves(case, _rng(case, 2), (0.7, 1.1, 1.9))
    return (LARGEST_DISPARITY * waves / np.abs(waves).max()).astype(np.float32)


def recorded(case: Case) -> NDArray[np.float32]:
    """[n, y, x, c]: the image where the disparity sends it, nearest pixel."""
    places = offsets(case)
    shown = np.empty((len(places), *case.size, CHANNELS), np.float32)
    for view, (du, dv) in zip(shown, places, strict=True):
        rows, columns = _sources(case, du, dv)
        view[:] = image(case)[_inside(rows, case.size[0]), _inside(columns, case.size[1])]
    return shown


def valid(case: Case) -> NDArray[np.float32]:
    """[n, y, x]: 1 where a view shows what lies in the frame of the reference view, else 0."""
    places, (height, width) = offsets(case), case.size
    known = np.empty((len(places), height, width), np.float32)
    for mask, (du, dv) in zip(known, places, strict=True):
        rows, columns = _sources(case, du, dv)
        mask[:] = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    return known


def views(case: Case) -> NDArray[np.uint8]:
    """[n, y, x, c]: the same views, as a file holds them."""
    return np.rint(recorded(case) / BYTE).astype(np.uint8)


def residual(case: Case) -> NDArray[np.float32]:
    """[n, y, x, c]: differences of either sign."""
    differences = recorded(case)
    differences -= 0.5
    return differences


def epis(case: Case) -> NDArray[np.uint8]:
    """[u, y, x, c]: the reference's row of views, as a file holds them."""
    line = line_offsets(case)
    lines = np.empty((len(line), *case.size, CHANNELS), np.uint8)
    for view, du in zip(lines, line, strict=True):
        rows, columns = _sources(case, du, 0.0)
        view[:] = np.rint(image(case)[rows, _inside(columns, case.size[1])] / BYTE)
    return lines


def weights(case: Case, window: int = CONFIG.prior.window) -> NDArray[np.float32]:
    """[k, y, x]: positive, 0 where the neighbour lies outside the image."""
    (height, width), half = case.size, half_window(window)
    random = _rng(case, 3).random((len(half), height, width), np.float32)
    for weight, (dy, dx) in zip(random, half, strict=True):
        weight[height - dy :] = 0
        weight[:, : max(0, -dx)] = 0
        weight[:, min(width, width - dx) :] = 0
    return random


def near_weights(case: Case) -> NDArray[np.float32]:
    """[w, y, x]: the same for the window that costs are averaged over."""
    return weights(case, MATCHING.semi_global.window)


def surface_weights(case: Case) -> NDArray[np.float32]:
    """[p, y, x]: the same for the window that maps are averaged over."""
    return weights(case, MATCHING.prior.window)


def sweep_labels(case: Case) -> tuple[float, float, int]:
    """First, distance and number of the disparities that a plane sweep compares."""
    bounds = -LARGEST_DISPARITY, LARGEST_DISPARITY
    return labels(bounds, offsets(case).astype(np.float64), MATCHING.sweep)


def levels(case: Case) -> NDArray[np.float32]:
    """[y, x]: the disparity in steps of 1/64, so that float32 has no say in which pixel is nearest."""
    return (np.rint(_EXACT * disparity(case)) / _EXACT).astype(np.float32)


def layers(case: Case) -> NDArray[np.float32]:
    """[y, x]: such a map with depth edges, tiles that are nearer and farther in turns."""
    y, x = np.indices(case.size, sparse=True)
    nearer = (y // _TILE + x // _TILE) % 2
    return (np.rint(_EXACT * (0.5 * disparity(case) + 1.5 * (nearer - 0.5))) / _EXACT).astype(np.float32)


def nearest(case: Case) -> NDArray[np.float32]:
    """[n, y, x]: the disparity of what each view shows, a little nearer: no comparison with `levels` is a tie."""
    places, shown = offsets(case), levels(case)
    found = np.empty((len(places), *case.size), np.float32)
    for view, (du, dv) in zip(found, places, strict=True):
        rows, columns = _sources(case, du, dv)
        view[:] = shown[_inside(rows, case.size[0]), _inside(columns, case.size[1])]
    return found + np.float32(_NO_TIE)


def volume(case: Case) -> NDArray[np.float32]:
    """[l, y, x]: costs as a sweep finds them, least near the disparity, with noise."""
    first, step, count = sweep_labels(case)
    far = (first + step * np.arange(count)[:, None, None] - disparity(case)) / 0.5
    noise = _rng(case, 7).random((count, *case.size), np.float32)
    return (0.05 * np.minimum(far**2, 1) + 0.003 * noise).astype(np.float32)


def path_costs(case: Case) -> NDArray[np.float32]:
    """[l, y, x]: sums over eight paths, at some pixels of no more than the costs."""
    return (8 * volume(case) + 0.01 * np.rint(other_values(case))).astype(np.float32)


def reduced_volume(case: Case) -> NDArray[np.float32]:
    """[l, r, s]: costs of reduced views, which are nearly the means of those of their pixels."""
    (height, width), costs = (side // REDUCTION for side in case.size), volume(case)
    blocks = costs[:, : REDUCTION * height, : REDUCTION * width].reshape(-1, height, REDUCTION, width, REDUCTION)
    return blocks.mean((2, 4), dtype=np.float32)


def shares(case: Case) -> NDArray[np.float32]:
    """[r, s]: what the costs of reduced views count."""
    return _rng(case, 9).uniform(0.9, 1.0, [side // REDUCTION for side in case.size]).astype(np.float32)


def other_values(case: Case) -> NDArray[np.float32]:
    """[y, x]: a second map."""
    return _rng(case, 4).random(case.size, np.float32)


def x_gradient(case: Case) -> NDArray[np.float32]:
    """[y, x]: of some energy at the disparity, of either sign."""
    return _rng(case, 5).random(case.size, np.float32) - np.float32(0.5)


def trial(case: Case) -> NDArray[np.float32]:
    """[y, x]: a map near the disparity, within the same bounds."""
    step = np.float32(0.1) * (other_values(case) - np.float32(0.5))
    return np.clip(disparity(case) + step, -LARGEST_DISPARITY, LARGEST_DISPARITY).astype(np.float32)


def trial_gradient(case: Case) -> NDArray[np.float32]:
    """[y, x]: of the same energy at the trial, the energy having a positive curvature that differs between pixels."""
    curvature = np.float32(0.5) + _rng(case, 6).random(case.size, np.float32)
    return x_gradient(case) + curvature * (trial(case) - disparity(case))


INPUTS: dict[str, Callable[[Case], NDArray[Any]]] = {
    "image": image,
    "disparity": disparity,
    "offsets": offsets,
    "recorded": recorded,
    "valid": valid,
    "views": views,
    "residual": residual,
    "epis": epis,
    "line_offsets": line_offsets,
    "weights": weights,
    "near_weights": near_weights,
    "surface_weights": surface_weights,
    "levels": levels,
    "layers": layers,
    "nearest": nearest,
    "volume": volume,
    "path_costs": path_costs,
    "reduced_volume": reduced_volume,
    "shares": shares,
    "other_values": other_values,
    "x": disparity,
    "x_gradient": x_gradient,
    "trial": trial,
    "trial_gradient": trial_gradient,
}


def _rng(case: Case, stream: int) -> np.random.Generator:
    return np.random.default_rng([stream, *case.grid, *case.size])


def _waves(case: Case, rng: np.random.Generator, frequencies: tuple[float, ...]) -> NDArray[np.float64]:
    """[y, x] in about [-1, 1]: plane waves of so many periods across the image, but none below 4 pixels."""
    y, x = np.mgrid[: case.size[0], : case.size[1]] / max(case.size)
    total = np.zeros(case.size)
    for frequency in frequencies:
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        periods = 2 * np.pi * min(frequency, max(case.size) / 4)
        total += np.sin(periods * (x * np.cos(angle) + y * np.sin(angle)) + phase)
    return total / len(frequencies)


def _sources(case: Case, du: float, dv: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns [y, x] of the image that the view at (du, dv) shows; they may lie outside."""
    y, x = np.indices(case.size, sparse=True)
    shift = disparity(case)
    return np.rint(y + shift * dv).astype(np.intp), np.rint(x + shift * du).astype(np.intp)


def _inside(indices: NDArray[np.intp], size: int) -> NDArray[np.intp]:
    return np.clip(indices, 0, size - 1)
