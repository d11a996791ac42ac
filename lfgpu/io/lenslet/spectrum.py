"""The peaks of a lattice in the power spectrum of a picture: three pairs of a hexagonal one, two of a square one."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

LEAST_SIDE = 128
"""Pixels along the shorter side of a picture below which no lattice is looked for."""
PITCHES = (5.0, 60.0)
"""Pixels between neighbouring microlenses that are looked for in the spectrum."""

_TILE = 512  # px, of the power spectrum
_MOST_TILES = 4  # along each side
_LEAST_PEAK = 60.0  # times the median power at the same frequency; all pairs of peaks have to reach it
_LEAST_CONTRAST = 0.01  # of the wave of a peak, of the mean of the picture
_LEAST_ALIKE = 0.03  # of the strongest of the peaks, for the weakest one
_CANDIDATES = 24
_LEAST_POWER = 1e-3  # of the strongest set of peaks, for a lower one that it is a harmonic of
_WIDTH = 4  # bins around a peak that are its own
_STRETCH = 0.06  # by which the lattice may differ from an equilateral one
_HEXAGONAL, _SQUARE = (0.0, 60.0, 120.0), (0.0, 90.0)  # degrees between peaks


@dataclass(frozen=True, eq=False)
class Peaks:
    """The frequencies (x, y), cycles per pixel, of a lattice, and how far they stand out."""

    frequencies: NDArray[np.float64]  # [3, 2] of a hexagonal lattice, [2, 2] of a square one
    strength: float  # the weakest peak's power over the median power at its distance from zero
    power: float  # the weakest peak's power

    @property
    def square(self) -> bool:
        """True if they are those of a square lattice."""
        return len(self.frequencies) == len(_SQUARE)

    @property
    def pitch(self) -> float:
        """Distance of neighbouring lenses in pixels."""
        rows = 1 / float(np.hypot(*self.frequencies.T).mean())
        return rows if self.square else rows * 2 / math.sqrt(3)


def find_peaks(picture: NDArray[np.float32]) -> Peaks | None:
    """Find the peaks of a lattice in the power spectrum of a picture [y, x], or None if there is no such lattice.

    Looks for pitches of 5 to 60 pixels and any rotation. A hexagonal lattice goes before a square one: two pairs of
    peaks at right angles are sooner there by chance than three at 60 degrees.
    """
    side = min(_TILE, *picture.shape)
    if side < LEAST_SIDE:
        return None
    power, ring = _power(picture, side)
    excess = _excess(power, ring)
    # The power of a wave of the least contrast that counts; far less may stand out without noise.
    excess[power < (_LEAST_CONTRAST / 2 * np.hanning(side).sum() ** 2) ** 2] = 0.0
    lowest, highest = 1 / PITCHES[1], 2 / (math.sqrt(3) * PITCHES[0])
    excess[(ring < max(lowest, 8 / side) * side) | (ring > highest * side)] = 0.0
    best: dict[tuple[float, ...], Peaks] = {}
    rest = excess.copy()
    for _ in range(_CANDIDATES):
        peak = tuple(int(place) for place in np.unravel_index(int(rest.argmax()), rest.shape))
        if rest[peak] < _LEAST_PEAK:
            break
        for angles in (_HEXAGONAL, _SQUARE):
            found = _partners(excess, power, _frequency(excess, peak), angles)
            if found.strength >= _LEAST_PEAK and (angles not in best or found.power > best[angles].power):
                best[angles] = found
        y, x = (_window(p, _WIDTH, n) for p, n in zip(peak, rest.shape, strict=True))
        rest[np.ix_(y, x)] = 0.0
    for angles in (_HEXAGONAL, _SQUARE):
        if angles in best:
            return _fundamental(excess, power, best[angles], angles)
    return None


def _power(picture: NDArray[np.float32], side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute mean power spectrum of tiles, [side, side // 2 + 1], and how far each bin is from zero, in bins."""
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


def _excess(power: NDArray[np.float64], ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Divide the power by the median at the same distance from zero: the spectrum of scenes falls off with it."""
    labels = np.rint(ring).astype(int)
    medians = np.asarray(ndimage.median(power, labels, np.arange(labels.max() + 1)))
    return power / np.maximum(medians[labels], np.finfo(np.float32).tiny)


def _window(middle: int, reach: int, length: int) -> NDArray[np.intp]:
    return np.arange(middle - reach, middle + reach + 1) % length


def _frequency(excess: NDArray[np.float64], peak: tuple[int, ...]) -> NDArray[np.float64]:
    """Return (x, y), cycles per pixel, of a peak between the bins, from the parabola through its logarithm."""
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


def _partners(
    excess: NDArray[np.float64], power: NDArray[np.float64], first: NDArray[np.float64], angles: tuple[float, ...]
) -> Peaks:
    """Return a peak and the strongest ones near where a lattice has its partners, turned by `angles`."""
    side = excess.shape[0]
    frequencies, strengths, powers = [], [], []
    for angle in angles:
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


def _fundamental(
    excess: NDArray[np.float64], power: NDArray[np.float64], found: Peaks, angles: tuple[float, ...]
) -> Peaks:
    """Find the set of peaks that the one found is a harmonic of, if there is such a one.

    Discs that touch have little power at the frequency of their lattice, and may have more at the next ones.
    """
    first, second = found.frequencies[0], found.frequencies[1]
    others = (first / 2, (first + second) / 2) if found.square else ((first + second) / 3, first / 2)
    for lower in others:
        peaks = _partners(excess, power, lower if lower[0] >= 0 else -lower, angles)
        if peaks.strength >= _LEAST_PEAK and peaks.power >= _LEAST_POWER * found.power:
            return peaks
    return found
