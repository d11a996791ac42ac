"""The mosaic of colours: its patterns, which one a picture has, and a demosaicing that stays within a microlens."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.lenslet.lattice import Microlenses
from lfgpu.io.lenslet.vignetting import Float32Array, bands
from lfgpu.io.parallax import shrunk

RED, GREEN, BLUE = 0, 1, 2
PATTERNS = ("bggr", "grbg", "gbrg", "rggb")
"""Colours of the pixels (0, 0), (0, 1), (1, 0), (1, 1), (row, column)."""
GREY = "grey"
"""Name of the pattern of a sensor without a mosaic."""

_ALIKE = 0.5  # ratio of the differences along the two diagonals that decides where green is
_NO_MOSAIC = 0.01  # difference of the four places, of their mean, below which there is no mosaic
_OTHER_LENS = 1e-3  # weight of a neighbour under another microlens: it counts only where there is no other
_HALO = 2


def colours(pattern: str) -> NDArray[np.int64]:
    """Return [2, 2], the colour of each place of a pattern; all the same for `GREY`."""
    if pattern == GREY:
        return np.zeros((2, 2), np.int64)
    return np.array(["rgb".index(letter) for letter in pattern]).reshape(2, 2)


def check_pattern(pattern: str) -> str:
    """Return the pattern in lower case; LightFieldError if there is no such one."""
    if pattern.lower() not in (*PATTERNS, GREY):
        known = ", ".join((*PATTERNS, GREY))
        raise LightFieldError(f"the Bayer pattern must be one of {known}, not {pattern!r}.")
    return pattern.lower()


def transposed(pattern: str) -> str:
    """Return the pattern of the transposed sensor."""
    return pattern if pattern == GREY else pattern[0] + pattern[2] + pattern[1] + pattern[3]


def green_diagonal(mosaic: Float32Array) -> int | None:
    """Find the green pixels: 0 if at (0, 0) and (1, 1), 1 if at (0, 1) and (1, 0); None if there is no mosaic.

    The two greens of a block are much more alike than its red and blue.
    """
    height, width = (side // 2 * 2 for side in mosaic.shape)
    blocks = [mosaic[i:height:2, j:width:2].astype(np.float64) for i in (0, 1) for j in (0, 1)]
    level = np.mean([block.mean() for block in blocks])
    step = max(1, min(height, width) // 256)  # local means over squares of 1/128 of the picture or so
    means = np.array([shrunk(block, step) for block in blocks])
    main, other = (float(np.abs(means[a] - means[b]).mean()) for a, b in ((0, 3), (1, 2)))
    if max(main, other) < _NO_MOSAIC * level or min(main, other) > _ALIKE * max(main, other):
        return None
    return 0 if main < other else 1


def demosaic(mosaic: Float32Array, light: Float32Array, grid: Microlenses, pattern: str) -> Float32Array:
    """Interpolate all three colours at every pixel, from neighbours under the same microlens: float32 [c, y, x].

    A mean over pixels of two microlenses would mix rays through opposite rims of the main lens. Neighbours count by how
    much `light` [y, x] they get, by which the mosaic [y, x] is divided, as their noise is the smaller for it. Red and
    blue follow green, by their differences from it.
    """
    if pattern == GREY:
        return mosaic[None]
    places = colours(pattern)
    height, width = mosaic.shape
    image = np.empty((3, height, width), np.float32)
    padded, weights = (np.pad(a, _HALO, mode="reflect") for a in (mosaic, light))
    for rows in bands(height):
        k, row = grid.nearest(
            np.arange(-_HALO, width + _HALO, dtype=np.float32),
            np.arange(rows.start - _HALO, rows.stop + _HALO, dtype=np.float32),
        )
        band = slice(rows.start, rows.stop + 2 * _HALO)  # bands begin at even rows, as the mosaic does
        image[:, rows] = _band(padded[band], weights[band], k * 65536 + row, places)
    return image


def _band(
    values: Float32Array, light: Float32Array, lens: NDArray[np.int32], places: NDArray[np.int64]
) -> Float32Array:
    """Return the colours [c, y, x] of a band whose halo is cut off; `lens` numbers the microlenses."""
    green = values.copy()
    for i, j in _sites(places, (RED, BLUE)):
        green[_grid(i, j, 1, values.shape)] = _mean(values, light, lens, (i, j), ((-1, 0), (1, 0), (0, -1), (0, 1)), 1)
    result = np.empty((3, values.shape[0] - 2 * _HALO, values.shape[1] - 2 * _HALO), np.float32)
    inner = np.s_[_HALO:-_HALO, _HALO:-_HALO]
    result[GREEN] = green[inner]
    for colour in (RED, BLUE):
        difference = values - green
        ((si, sj),) = _sites(places, (colour,))
        full = difference.copy()
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            near = [(di, dj) for di in (-1, 0, 1) for dj in (-1, 0, 1) if ((i + di) % 2, (j + dj) % 2) == (si, sj)]
            if (i, j) != (si, sj):
                full[_grid(i, j, _HALO, values.shape)] = _mean(difference, light, lens, (i, j), near, _HALO)
        result[colour] = result[GREEN] + full[inner]
    return result


def _sites(places: NDArray[np.int64], wanted: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    return ((i, j) for i in (0, 1) for j in (0, 1) if places[i, j] in wanted)


def _grid(i: int, j: int, halo: int, shape: tuple[int, ...], shift: tuple[int, int] = (0, 0)) -> tuple[slice, slice]:
    """Return every second pixel, those of the mosaic's place (i, j), at least `halo` from the rim; moved by `shift`."""
    rows, columns = (
        slice(halo + (place - halo) % 2 + step, length - halo + step, 2)
        for place, step, length in zip((i, j), shift, shape, strict=True)
    )
    return rows, columns


def _mean(
    values: Float32Array,
    light: Float32Array,
    lens: NDArray[np.int32],
    place: tuple[int, int],
    near: Sequence[tuple[int, int]],
    halo: int,
) -> Float32Array:
    """Average the pixels `near` every pixel of a place of the mosaic, with weights."""
    own = lens[_grid(*place, halo, values.shape)]
    total, weight = np.zeros(own.shape, np.float32), np.zeros(own.shape, np.float32)
    for shift in near:
        there = _grid(*place, halo, values.shape, shift)
        w = light[there] * np.where(lens[there] == own, np.float32(1), np.float32(_OTHER_LENS)) + np.float32(1e-9)
        total += w * values[there]
        weight += w
    return total / weight
