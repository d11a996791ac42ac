"""The microlens grid: where the centre of every microlens image lies on the sensor, found from a picture alone.

A hexagonal grid of bright discs has six peaks in its power spectrum, at angles of 60 degrees. They give pitch, rotation
and rows to a part of a bin. Demodulated with them, the picture has a phase that says how far off the grid is in each
neighbourhood, whatever the scene shows there on average; planes fitted to it give all six numbers of the grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from lfgpu.errors import LightFieldError

LEAST_SIDE = 128
"""Pixels along the shorter side of a picture below which no grid is looked for."""

_PITCHES = (5.0, 60.0)  # px between neighbouring microlenses
_TILE = 512  # px, of the power spectrum
_MOST_TILES = 4  # along each side
_LEAST_PEAK = 60.0  # times the median power at the same frequency; all three pairs of peaks have to reach it
_LEAST_CONTRAST = 0.01  # of the wave of a peak, of the mean of the picture
_LEAST_ALIKE = 0.03  # of the strongest of three peaks, for the weakest one
_CANDIDATES = 24
_LEAST_POWER = 1e-3  # of the strongest grid of peaks, for a lower one that it is a harmonic of
_WIDTH = 4  # bins around a peak that are its own
_STRETCH = 0.06  # by which the grid may differ from an equilateral one
_NEIGHBOURHOOD = 6.0  # pitches, side of the squares of which the phase is taken
_TRIMMED = 3.0  # residuals beyond so many median ones do not count
_LEAST_AGREEING = 0.7  # share of the neighbourhoods that must agree on one grid
_AGREEING = 0.15  # turns


@dataclass(frozen=True, eq=False)
class Microlenses:
    """A regular grid of microlens centres: lens k of row l is at origin + k * along + l * down, (x, y) in pixels.

    Parameters
    ----------
    origin
        [2], centre of lens (0, 0), the pixel at the top left having its centre at (0, 0).
    along
        [2], step to the next lens of the row; nearest to the direction of x.
    down
        [2], step to a lens of the next row, half a pitch further on.
    """

    origin: NDArray[np.float64]
    along: NDArray[np.float64]
    down: NDArray[np.float64]

    @property
    def pitch(self) -> float:
        """Distance of neighbours in a row, pixels."""
        return math.hypot(*self.along)

    @property
    def rotation(self) -> float:
        """Of the rows against the x axis, radians, positive from x to y."""
        return math.atan2(self.along[1], self.along[0])

    @property
    def axes(self) -> NDArray[np.float64]:
        """[2, 2], unit vectors (x, y) along the rows and across them, downwards."""
        x = self.along / self.pitch
        return np.array([x, [-x[1], x[0]]])

    @property
    def row_distance(self) -> float:
        """Distance of neighbouring rows, pixels: sqrt(3) / 2 pitches in an equilateral grid."""
        return float(self.down @ self.axes[1])

    def centres(self, k: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """(x, y) of lenses [..., 2]; `k` and `row` may be fractions."""
        return self.origin + k[..., None] * self.along + row[..., None] * self.down

    def nearest(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """(k, row) of the lens nearest to each pixel at the columns `x` [w] and rows `y` [h]: two arrays [h, w]."""
        inverse = np.linalg.inv(np.stack([self.along, self.down], axis=1)).astype(np.float32)
        shift = (inverse @ self.origin).astype(np.float32)
        k = inverse[0, 0] * x + (inverse[0, 1] * y - shift[0])[:, None]
        row = inverse[1, 0] * x + (inverse[1, 1] * y - shift[1])[:, None]
        # Rounding of cube coordinates, k + row + rest = 0: of the three the one that was off the most is corrected.
        whole_k, whole_row, whole_rest = np.rint(k), np.rint(row), np.rint(-k - row)
        off_k, off_row, off_rest = np.abs(whole_k - k), np.abs(whole_row - row), np.abs(whole_rest + k + row)
        fix_k = (off_k > off_row) & (off_k > off_rest)
        fix_row = ~fix_k & (off_row > off_rest)
        return (
            np.where(fix_k, -whole_row - whole_rest, whole_k).astype(np.int32),
            np.where(fix_row, -whole_k - whole_rest, whole_row).astype(np.int32),
        )

    def transposed(self) -> Microlenses:
        """The grid of the transposed picture, x and y exchanged; its rows may no longer be those nearest to x."""
        return Microlenses(self.origin[::-1], self.along[::-1], self.down[::-1])


@dataclass(frozen=True, eq=False)
class Peaks:
    """Three frequencies (x, y), cycles per pixel, [3, 2], of a hexagonal grid, and how far they stand out."""

    frequencies: NDArray[np.float64]
    strength: float
    """The weakest peak's power over the median power at its distance from zero."""
    power: float
    """The weakest peak's power."""


def find_peaks(picture: NDArray[np.float32]) -> Peaks | None:
    """The peaks of a hexagonal grid in the power spectrum of a picture [y, x], or None if there is no such grid.

    Looks for pitches of 5 to 60 pixels and any rotation.
    """
    side = min(_TILE, *picture.shape)
    if side < LEAST_SIDE:
        return None
    power, ring = _power(picture, side)
    excess = _excess(power, ring)
    excess[power < _least_power(side)] = 0.0
    lowest, highest = (2 / (math.sqrt(3) * pitch) for pitch in reversed(_PITCHES))
    excess[(ring < max(lowest, 8 / side) * side) | (ring > highest * side)] = 0.0
    best: Peaks | None = None
    rest = excess.copy()
    for _ in range(_CANDIDATES):
        peak = tuple(int(place) for place in np.unravel_index(int(rest.argmax()), rest.shape))
        if rest[peak] < _LEAST_PEAK:
            break
        triple = _triple(excess, power, _frequency(excess, peak))
        if triple.strength >= _LEAST_PEAK and (best is None or triple.power > best.power):
            best = triple
        y, x = (_window(p, _WIDTH, n) for p, n in zip(peak, rest.shape, strict=True))
        rest[np.ix_(y, x)] = 0.0
    return None if best is None else _fundamental(excess, power, best)


def find_microlenses(picture: NDArray[np.float32], *, name: str) -> Microlenses:
    """The microlens grid of a picture.

    Parameters
    ----------
    picture
        float32 [y, x], a white image or a capture, a Bayer mosaic or grey; bright where the lenses are.
    name
        What to call the picture in a refusal.

    Returns
    -------
    The grid, with `along` within 45 degrees of x. If the rows of lenses stand upright, `along` is a step of a row as
    they are found in the transposed picture: see `is_upright`.

    Raises
    ------
    LightFieldError
        If there is no hexagonal grid, or not the same one all over the picture.
    """
    peaks = find_peaks(picture)
    if peaks is None:
        raise LightFieldError(
            f"{name} shows no microlenses: a raw capture of a lenslet camera has a hexagonal grid of bright discs "
            f"{_PITCHES[0]:g} to {_PITCHES[1]:g} px apart, and its spectrum six peaks; there are none that stand out."
        )
    grid = _reduced(_fitted(picture, peaks.frequencies, name=name))
    return _near_middle(grid, picture.shape)


def is_upright(grid: Microlenses) -> bool:
    """Whether the rows of lenses are nearer to the direction of y than to that of x."""
    return abs(math.sin(grid.rotation)) > math.sin(math.radians(15))


def _power(picture: NDArray[np.float32], side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean power spectrum of tiles, [side, side // 2 + 1], and how far each bin is from zero, in bins."""
    window = np.hanning(side).astype(np.float32)
    height, width = picture.shape
    total, tiles = np.zeros((side, side // 2 + 1)), 0
    starts = [np.linspace(0, n - side, min(_MOST_TILES, -(-n // side))).astype(int) for n in (height, width)]
    for top in starts[0]:
        for left in starts[1]:
            tile = picture[top : top + side, left : left + side].astype(np.float32)
            mean = float(tile.mean())
            if mean > 0:  # every tile counts alike, dark ones too
                total += np.abs(fft.rfft2((tile / mean - 1) * window[:, None] * window)) ** 2
                tiles += 1
    total /= max(tiles, 1)
    fy, fx = np.fft.fftfreq(side) * side, np.arange(side // 2 + 1)
    return total, np.hypot(fy[:, None], fx)


def _least_power(side: int) -> float:
    """The power of a wave of the least contrast that counts; far less may stand out of a picture without noise."""
    return float((_LEAST_CONTRAST / 2 * np.hanning(side).sum() ** 2) ** 2)


def _excess(power: NDArray[np.float64], ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power over the median of all bins at the same distance from zero: the spectrum of scenes falls off with it."""
    labels = np.rint(ring).astype(int)
    medians = np.asarray(ndimage.median(power, labels, np.arange(labels.max() + 1)))
    return power / np.maximum(medians[labels], np.finfo(np.float32).tiny)


def _window(middle: int, reach: int, length: int) -> NDArray[np.intp]:
    return np.arange(middle - reach, middle + reach + 1) % length


def _frequency(excess: NDArray[np.float64], peak: tuple[int, ...]) -> NDArray[np.float64]:
    """(x, y), cycles per pixel, of a peak between the bins, from the parabola through its logarithm."""
    side = excess.shape[0]
    found = []
    for axis in (1, 0):
        index = list(peak)
        values = []
        for step in (-1, 0, 1):
            index[axis] = (peak[axis] + step) % excess.shape[axis]
            values.append(math.log(max(excess[tuple(index)], 1e-12)))
        curvature = values[0] - 2 * values[1] + values[2]
        offset = 0.0 if curvature >= 0 else 0.5 * (values[0] - values[2]) / curvature
        position = peak[axis] + min(max(offset, -0.5), 0.5)
        found.append((position - side if position > side / 2 else position) / side)
    return np.array(found)


def _triple(excess: NDArray[np.float64], power: NDArray[np.float64], first: NDArray[np.float64]) -> Peaks:
    """A peak and the strongest ones near where an equilateral grid has its partners."""
    side = excess.shape[0]
    frequencies, strengths, powers = [], [], []
    for angle in (0.0, 60.0, 120.0):
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        expected = np.array([c * first[0] - s * first[1], s * first[0] + c * first[1]])
        if expected[0] < 0:  # the half of the spectrum that is kept
            expected = -expected
        reach = max(2, math.ceil(_STRETCH * math.hypot(*first) * side))
        y = _window(round(expected[1] * side), reach, side)
        x = np.clip(np.arange(-reach, reach + 1) + round(expected[0] * side), 0, excess.shape[1] - 1)
        near = excess[np.ix_(y, x)]
        place = np.unravel_index(int(near.argmax()), near.shape)
        peak = int(y[place[0]]), int(x[place[1]])
        frequencies.append(_frequency(excess, peak))
        strengths.append(float(near[place]))
        powers.append(float(power[peak]))
    alike = min(powers) >= _LEAST_ALIKE * max(powers)
    return Peaks(np.array(frequencies), min(strengths) if alike else 0.0, min(powers))


def _fundamental(excess: NDArray[np.float64], power: NDArray[np.float64], found: Peaks) -> Peaks:
    """The grid of peaks that the one found is a harmonic of, if there is such a one.

    Discs that touch have little power at the frequency of their grid, and may have more at sqrt(3) times or twice that.
    """
    for lower in ((found.frequencies[0] + found.frequencies[1]) / 3, found.frequencies[0] / 2):
        triple = _triple(excess, power, lower)
        if triple.strength >= _LEAST_PEAK and triple.power >= _LEAST_POWER * found.power:
            return triple
    return found


def _fitted(picture: NDArray[np.float32], frequencies: NDArray[np.float64], *, name: str) -> Microlenses:
    """The grid whose phases fit those of all neighbourhoods of the picture, by trimmed least squares."""
    first, second = frequencies[0], frequencies[1]
    waves = np.array([first, second])
    flat = _flattened(picture, 1 / math.hypot(*first))
    side = round(_NEIGHBOURHOOD * 2 / (math.sqrt(3) * math.hypot(*first)))
    for _ in range(2):  # with the second round's frequencies no phase turns within a neighbourhood
        x, y, phases, weights = _phases(flat, waves, side)
        design = np.stack([x, y, np.ones_like(x)], axis=1)
        planes = []
        for phase, weight in zip(phases, weights, strict=True):
            planes.append(_plane(design, phase, weight, (len(np.unique(y)), len(np.unique(x)))))
            residual = _wrapped(phase - design @ planes[-1])
            if np.average(np.abs(residual) < _AGREEING, weights=weight) < _LEAST_AGREEING:
                raise LightFieldError(
                    f"{name} shows a hexagonal grid, but not one and the same all over the picture: "
                    "microlenses are regular to a fraction of a pixel."
                )
        corrections = np.array(planes)
        waves = waves + corrections[:, :2]
    # The phase of wave g at the point p is g.(p - origin) in turns, which is whole at the centres.
    along, down = np.linalg.inv(waves).T
    origin = -(corrections[0, 2] * along + corrections[1, 2] * down)
    return Microlenses(origin, along, down)


def _flattened(picture: NDArray[np.float32], period: float) -> NDArray[np.float32]:
    """Contrast against the surroundings, so that bright parts of the scene do not count more than dark ones."""
    values = picture.astype(np.float32)
    size = 2 * round(1.5 * period) + 1
    mean = ndimage.uniform_filter(values, size, mode="nearest")
    spread = ndimage.uniform_filter(np.abs(values - mean), size, mode="nearest")
    floor = max(float(np.median(spread)) * 0.1, 1e-6)
    values -= mean
    values /= spread + floor
    return values


def _phases(
    flat: NDArray[np.float32], waves: NDArray[np.float64], side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Middles (x, y) of square neighbourhoods, and there each wave's phase in turns and amplitude, [2, n]."""
    height, width = flat.shape
    rows, columns = height // side, width // side
    flat = flat[: rows * side, : columns * side]
    window = np.hanning(side + 2)[1:-1].astype(np.float32)
    weights_x, weights_y = np.tile(window, columns), np.tile(window, rows)
    phases, amplitudes = [], []
    for wave in waves:
        turn_x = np.exp(-2j * np.pi * wave[0] * np.arange(columns * side)).astype(np.complex64) * weights_x
        turn_y = np.exp(-2j * np.pi * wave[1] * np.arange(rows * side)).astype(np.complex64) * weights_y
        across = np.einsum("ycx,cx->yc", flat.reshape(rows * side, columns, side), turn_x.reshape(columns, side))
        total = (across * turn_y[:, None]).reshape(rows, side, columns).sum(1)
        phases.append((np.angle(total) / (2 * np.pi)).ravel())
        amplitudes.append(np.abs(total).ravel())
    y, x = np.meshgrid(
        np.arange(rows) * side + (side - 1) / 2, np.arange(columns) * side + (side - 1) / 2, indexing="ij"
    )
    return x.ravel(), y.ravel(), np.array(phases), np.array(amplitudes)


def _plane(
    design: NDArray[np.float64], phase: NDArray[np.float64], weight: NDArray[np.float64], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """(per x, per y, constant), turns: the plane through phases that are known up to whole turns.

    Its slopes come from neighbours first, which differ by less than half a turn; what is left then is no turn any more.
    """
    unit = (np.sqrt(weight) * np.exp(2j * np.pi * phase)).reshape(shape)
    side_x = design.reshape(*shape, 3)[0, min(1, shape[1] - 1), 0] - design[0, 0]
    side_y = design.reshape(*shape, 3)[min(1, shape[0] - 1), 0, 1] - design[0, 1]
    slope_x = np.angle((unit[:, 1:] * unit[:, :-1].conj()).sum()) / (2 * np.pi * max(side_x, 1.0))
    slope_y = np.angle((unit[1:] * unit[:-1].conj()).sum()) / (2 * np.pi * max(side_y, 1.0))
    plane = np.array([slope_x, slope_y, 0.0])
    plane[2] = np.angle((unit.ravel() * np.exp(-2j * np.pi * (design @ plane))).sum()) / (2 * np.pi)
    kept = weight
    for _ in range(4):
        residual = _wrapped(phase - design @ plane)
        limit = _TRIMMED * max(float(np.median(np.abs(residual))), 1e-4)
        kept = weight * (np.abs(residual) <= limit)
        root = np.sqrt(kept)
        plane = plane + np.linalg.lstsq(design * root[:, None], residual * root, rcond=None)[0]
    return plane


def _wrapped(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    return turns - np.rint(turns)


def _reduced(grid: Microlenses) -> Microlenses:
    """The same grid by its shortest steps: along the row that is nearest to the direction of x or y, and down."""
    basis = np.stack([grid.along, grid.down])
    steps = np.array([(i, j) for i in range(-3, 4) for j in range(-3, 4) if (i, j) != (0, 0)]) @ basis
    six = steps[np.argsort(np.hypot(*steps.T))[:6]]
    angles = np.degrees(np.arctan2(six[:, 1], six[:, 0]))
    off_axis = np.abs((angles + 45) % 90 - 45)
    candidates = [i for i in range(6) if -45 < angles[i] <= 135]
    chosen = min(candidates, key=lambda i: off_axis[i])
    # What turns from `along` towards larger y by about 60 degrees.
    turned = (angles - angles[chosen] + 180) % 360 - 180
    return replace(grid, along=six[chosen], down=six[int(np.argmin(np.abs(turned - 60)))])


def _near_middle(grid: Microlenses, shape: tuple[int, ...]) -> Microlenses:
    """The same grid counted from the lens nearest to the middle of the picture."""
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    k, row = np.rint(np.linalg.solve(np.stack([grid.along, grid.down], axis=1), middle - grid.origin))
    return replace(grid, origin=grid.origin + k * grid.along + row * grid.down)
