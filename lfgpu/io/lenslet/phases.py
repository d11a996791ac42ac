"""A lattice whose phases fit those of all neighbourhoods of a picture, whatever the scene shows there on average.

Demodulated with two waves of the lattice, a picture has phases that say how far off the lattice is in each
neighbourhood. Planes fitted to them give a regular lattice; where the lenses lie denser on one side than on the other,
two quotients with one denominator do.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from lfgpu.errors import LightFieldError
from lfgpu.io.lenslet.lattice import Microlenses

NEIGHBOURHOOD = 6.0
"""Side of the squares of which the phase is taken, in pitches."""

_TRIMMED = 3.0  # residuals beyond so many median ones do not count
_LEAST_AGREEING = 0.7  # share of the neighbourhoods that must agree on one grid
_AGREEING = 0.15  # turns
_SLANTED = 0.5  # of the median residual of a regular lattice: below it a slanted one is believed
_FIRST = 0.3  # of the picture around its middle, where a slanted lattice is taken for regular
_GROWING = 1.25


def fitted(picture: NDArray[np.float32], frequencies: NDArray[np.float64], pitch: float, *, name: str) -> Microlenses:
    """Fit the lattice of a picture [y, x] by trimmed least squares, from two waves [2, 2] of it and a rough pitch.

    Frequencies (x, y), cycles per pixel, are right to a few per cent. LightFieldError if neighbourhoods do not agree.
    """
    flat = _flattened(picture, 1 / math.hypot(*frequencies[0]))
    side = round(NEIGHBOURHOOD * pitch)
    fit = _Fit(flat, frequencies, side)
    found = fit.regular()
    if found.agreeing < _LEAST_AGREEING or found.residual > _AGREEING / 10:
        slanted = fit.slanted()
        if slanted is not None and slanted.residual < _SLANTED * found.residual:
            found = slanted
    if found.agreeing < _LEAST_AGREEING:
        raise LightFieldError(
            f"{name} shows a lattice of bright spots, but not one and the same all over the picture: "
            "microlenses are regular to a fraction of a pixel."
        )
    return found.lenses


class _Found:
    """A lattice, and how well neighbourhoods agree on it."""

    def __init__(self, lenses: Microlenses, residuals: NDArray[np.float64], weights: NDArray[np.float64]) -> None:
        self.lenses = lenses
        self.residual = float(np.median(np.abs(residuals)))
        """Turns."""
        self.agreeing = min(
            float(np.average(np.abs(of_wave) < _AGREEING, weights=weight))
            for of_wave, weight in zip(residuals, weights, strict=True)
        )
        """Share of the neighbourhoods, for the worse one of the two waves."""


class _Fit:
    """The phases of a picture against two waves, and lattices that fit them."""

    def __init__(self, flat: NDArray[np.float32], waves: NDArray[np.float64], side: int) -> None:
        self._flat, self._waves, self._side = flat, waves, side
        self._x, self._y, self._phases, self._weights = _phases(flat, waves, side)
        self._shape = (len(np.unique(self._y)), len(np.unique(self._x)))

    def regular(self, rounds: int = 2) -> _Found:
        """Return the regular lattice that fits best; from the second round on no phase turns within a neighbourhood."""
        design = np.stack([self._x, self._y, np.ones_like(self._x)], axis=1)
        measured = zip(self._phases, self._weights, strict=True)
        planes = np.array([_plane(design, phase, weight, self._shape) for phase, weight in measured])
        waves = self._waves + planes[:, :2]
        # The phase of wave g at the point p is g.(p - origin) in turns, which is whole at the centres.
        along, down = np.linalg.inv(waves).T
        lenses = Microlenses(-(planes[0, 2] * along + planes[1, 2] * down), along, down)
        found = _Found(lenses, _wrapped(self._phases - planes @ design.T), self._weights)
        if rounds == 1 or found.agreeing < _LEAST_AGREEING:
            return found
        return _Fit(self._flat, waves, self._side).regular(rounds - 1)

    def slanted(self) -> _Found | None:
        """Return the lattice that becomes denser towards one side which fits best; None if there is none.

        Phases are known up to whole turns: what fits the middle of the picture says how many there are a bit farther
        out, and so on to the corners.
        """
        height, width = self._flat.shape
        middle, half = np.array([(width - 1) / 2, (height - 1) / 2]), max(height, width) / 2
        x, y = (self._x - middle[0]) / half, (self._y - middle[1]) / half
        # What the waves themselves have at each neighbourhood; the phases come on top of it.
        base = self._waves @ np.stack([self._x, self._y])
        near = np.maximum(np.abs(x), np.abs(y))
        chosen = near <= max(_FIRST, float(np.partition(near, min(8, len(near) - 1))[min(8, len(near) - 1)]))
        start = self._start(x, y, base, chosen)
        if start is None:
            return None
        parameters, reach = start, float(near[chosen].max())
        while True:
            parameters = self._refined(parameters, x[chosen], y[chosen], base[:, chosen], chosen)
            if chosen.all():
                break
            reach *= _GROWING
            chosen = near <= reach
        residuals = _wrapped(self._phases + base - _quotients(parameters, x, y))
        return _Found(_lattice(parameters, middle, half), residuals, self._weights)

    def _start(
        self, x: NDArray[np.float64], y: NDArray[np.float64], base: NDArray[np.float64], chosen: NDArray[np.bool_]
    ) -> NDArray[np.float64] | None:
        """Fit planes through the phases around the middle: the parameters of quotients with the denominator 1."""
        shape = (len(np.unique(y[chosen])), len(np.unique(x[chosen])))
        if min(shape) < 2:
            return None
        design = np.stack([x[chosen], y[chosen], np.ones(int(chosen.sum()))], axis=1)
        rows = []
        for phase, weight, of_wave in zip(self._phases, self._weights, base, strict=True):
            plane = _plane(design, phase[chosen], weight[chosen], shape)
            rows.append(plane + np.linalg.lstsq(design, of_wave[chosen], rcond=None)[0])
        return np.array([*rows[0], *rows[1], 0.0, 0.0])

    def _refined(
        self,
        parameters: NDArray[np.float64],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        base: NDArray[np.float64],
        chosen: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        measured = self._phases[:, chosen] + base
        # Which whole turns belong to the phases is decided by what is known so far.
        expected = _quotients(parameters, x, y)
        measured = expected + _wrapped(measured - expected)
        root = np.sqrt(self._weights[:, chosen])
        root = root / max(float(root.max()), 1e-30)

        def residuals(p: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray((root * (_quotients(p, x, y) - measured)).ravel())

        found = optimize.least_squares(residuals, parameters, loss="soft_l1", f_scale=0.02, x_scale="jac")
        return np.asarray(found.x)


def _quotients(p: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return [2, n], (k, row) at points."""
    below = 1 + p[6] * x + p[7] * y
    return np.array([p[0] * x + p[1] * y + p[2], p[3] * x + p[4] * y + p[5]]) / below


def _lattice(p: NDArray[np.float64], middle: NDArray[np.float64], half: float) -> Microlenses:
    """Return the lattice whose (k, row) at a pixel are the quotients of that pixel's place against the middle."""
    to_unit = np.array([[1 / half, 0, -middle[0] / half], [0, 1 / half, -middle[1] / half], [0, 0, 1]])
    back = np.linalg.inv(np.array([p[:3], p[3:6], [p[6], p[7], 1.0]]) @ to_unit)
    back /= back[2, 2]
    origin, slant = back[:2, 2], back[2, :2]
    along, down = (back[:2, i] - slant[i] * origin for i in (0, 1))
    return Microlenses(origin, along, down, slant=slant)


def _flattened(picture: NDArray[np.float32], period: float) -> NDArray[np.float32]:
    """Compute the contrast against the surroundings, so that bright parts of the scene count no more than dark ones."""
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
    """Measure each wave's phase in turns and amplitude, [2, n], in square neighbourhoods; returns middles, too."""
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
    """Return (per x, per y, constant), turns: the plane through phases that are known up to whole turns.

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
