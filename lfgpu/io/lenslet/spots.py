"""A lattice of few, large spots: from the picture's likeness to itself, and then from the middle of each spot."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from lfgpu.io.lenslet.lattice import Microlenses

_LEAST_PITCH = 8.0  # pixels
_MOST_PITCH = 0.3  # of the shorter side
_LEAST_LIKENESS = 0.35  # of the picture moved by a step of the lattice to itself
_ANGLES = (50.0, 100.0)  # degrees between two steps
_STRETCH = 0.1  # by which two steps may differ in length
_ROUNDS = 25
_GAIN = 2.0  # a spot that is off the middle of its window by 1 px moves the mean there by about 1 / _GAIN
_LEAST_SPOTS = 9
_MOST_PIXELS = 1 << 22  # of a picture; larger ones with few lenses are no sensors
_TRIMMED = 3.0  # residuals beyond so many median ones do not count
_DARKER = 0.8  # half-way between two spots, of their middles
_FOUND = 0.05  # px that spots may move at the end, by the median


def find_spots(picture: NDArray[np.float32], *, name: str) -> Microlenses | None:
    """Find the lattice of a picture [y, x] of few spots, at least 3 x 3; None if there is none.

    Their middles are those of evenly lit spots: in the picture of a scene, what it shows moves them.
    """
    steps = _steps(picture) if picture.size <= _MOST_PIXELS else None
    if steps is None:
        return None
    lenses = _placed(picture, Microlenses(np.zeros(2), steps[0], steps[1]).reduced(name=name))
    for _ in range(_ROUNDS):
        found, moved = _moved(picture, lenses)
        if found is None:
            return None
        lenses = found
    settled = moved < _FOUND * max(1.0, lenses.pitch / 20)
    return lenses if settled and _are_bright(picture, lenses) else None


def _are_bright(picture: NDArray[np.float32], lenses: Microlenses) -> bool:
    """Tell whether it is darker than in the middle of the spots half-way to the next one, along each of two steps."""
    smooth = ndimage.gaussian_filter(picture.astype(np.float64), lenses.pitch / 20)
    k, row = (a.astype(np.float64) for a in lenses.inside(picture.shape, lenses.pitch / 2))

    def level(along: float, down: float) -> float:
        x, y = lenses.centres(k + along, row + down).T
        return float(ndimage.map_coordinates(smooth, [y, x], order=1, mode="nearest").mean())

    return max(level(0.5, 0.0), level(0.0, 0.5)) < _DARKER * level(0.0, 0.0)


def _steps(picture: NDArray[np.float32]) -> NDArray[np.float64] | None:
    """Find [2, 2], two steps (x, y) of the lattice by which the picture is most like itself; None if it is not."""
    likeness = _likeness(picture)
    height, width = picture.shape
    limit = _MOST_PITCH * min(height, width)
    y, x = np.meshgrid(*(np.arange(n) - n // 2 for n in likeness.shape), indexing="ij")
    distance = np.hypot(x, y)
    peaks = (likeness == ndimage.maximum_filter(likeness, 5)) & (likeness > _LEAST_LIKENESS)
    peaks &= (distance >= _LEAST_PITCH) & (distance <= limit) & ((y > 0) | ((y == 0) & (x > 0)))
    found = np.argwhere(peaks)
    order = np.argsort(distance[peaks])
    steps = [np.array([x[tuple(place)], y[tuple(place)]], np.float64) for place in found[order]]
    for i, first in enumerate(steps[:6]):
        for second in steps[i + 1 : 12]:
            lengths = math.hypot(*first), math.hypot(*second)
            angle = math.degrees(math.acos(min(1.0, abs(float(first @ second)) / (lengths[0] * lengths[1]))))
            if angle >= _ANGLES[0] and lengths[1] <= (1 + _STRETCH) * lengths[0]:
                return np.array([first, second])
    return None


def _likeness(picture: NDArray[np.float32]) -> NDArray[np.float64]:
    """Compute the correlation of the picture with itself moved by each (y, x), 0 in the middle."""
    height, width = picture.shape
    values = ndimage.gaussian_filter(picture.astype(np.float64), 1.0)
    values -= values.mean()
    shape = [fft.next_fast_len(3 * n // 2, real=True) for n in (height, width)]
    spectra = [fft.rfft2(a, shape) for a in (values, np.ones_like(values), values**2)]
    same, count, energy = (
        fft.irfft2(a * b.conj(), shape)
        for a, b in ((spectra[0], spectra[0]), (spectra[1], spectra[1]), (spectra[2], spectra[1]))
    )
    # Both parts that overlap have their own energy; by symmetry the other one's is that of the opposite way.
    opposite = np.roll(energy[::-1, ::-1], (1, 1), (0, 1))
    result = same / np.sqrt(np.maximum(energy, 1e-12) * np.maximum(opposite, 1e-12))
    result[count < 0.25 * height * width] = 0.0
    return np.asarray(fft.fftshift(result))


def _placed(picture: NDArray[np.float32], lenses: Microlenses) -> Microlenses:
    """Return the lattice moved to where its spots are bright, by the phases of the picture against two of its waves."""
    waves = np.linalg.inv(np.stack([lenses.along, lenses.down], axis=1))
    height, width = picture.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    values = (picture - float(np.average(picture, weights=window))) * window
    turns = []
    for wave in waves:
        turn_y, turn_x = (np.exp(-2j * np.pi * wave[1 - axis] * np.arange(n)) for axis, n in enumerate((height, width)))
        turns.append(np.angle(turn_y @ values @ turn_x) / (2 * np.pi))
    origin = -(turns[0] * lenses.along + turns[1] * lenses.down)
    return Microlenses(origin, lenses.along, lenses.down, lenses.square)


def _moved(picture: NDArray[np.float32], lenses: Microlenses) -> tuple[Microlenses | None, float]:
    """Return the regular lattice through the middles of the spots, and by how many pixels they were off (median)."""
    lenses = lenses.near(np.array([(n - 1) / 2 for n in reversed(picture.shape)]))
    reach = lenses.pitch / 2
    k, row = lenses.inside(picture.shape, reach + 1)
    if len(k) < _LEAST_SPOTS:
        return None, math.inf
    centres = lenses.centres(k.astype(np.float64), row.astype(np.float64))
    off = _off_middle(picture, centres, reach)
    design, there = np.stack([np.ones(len(k)), k, row], axis=1), centres + _GAIN * off
    # Spots at the rim have darkness on one side and neighbours on the other: they count if they agree with the rest.
    limits = np.array(picture.shape[::-1]) - 1 - 3 * reach
    inner = ((centres >= 3 * reach) & (centres <= limits)).all(axis=1)
    kept = inner if inner.sum() >= _LEAST_SPOTS else np.ones_like(inner)
    for _ in range(2):
        fit = np.linalg.lstsq(design[kept], there[kept], rcond=None)[0]
        residual = np.hypot(*(there - design @ fit).T)
        kept = residual <= _TRIMMED * float(np.median(residual[kept]))
    origin, along, down = fit
    return Microlenses(origin, along, down, lenses.square), float(np.median(np.hypot(*off[kept].T)))


def _off_middle(picture: NDArray[np.float32], centres: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Measure how far the mean of each spot is off a point (x, y), both under a round window around that point."""
    first = np.ceil(centres - reach).astype(np.int64)
    columns, rows = (first[:, [axis]] + np.arange(int(2 * reach) + 1) for axis in (0, 1))
    x, y = (columns - centres[:, [0]])[:, None], (rows - centres[:, [1]])[:, :, None]
    distance = np.minimum(np.hypot(x, y) / reach, 1.0)
    weight = np.cos(np.pi / 2 * distance) ** 2 * picture[rows[:, :, None], columns[:, None]]
    total = np.maximum(weight.sum((1, 2)), 1e-12)
    return np.stack([(weight * x).sum((1, 2)), (weight * y).sum((1, 2))], axis=1) / total[:, None]
