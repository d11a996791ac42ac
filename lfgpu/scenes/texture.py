"""Procedural textures: periodic tiles of band-limited patterns, sampled bilinearly."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

TEXELS_PER_PIXEL = 2  # fine enough for bilinear sampling of the shortest wavelength
SHORTEST, LONGEST = 3.0, 60.0  # wavelengths in pixels: shorter ones alias, longer ones are featureless

Tile = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Texture:
    """A periodic colour texture on the plane."""

    tile: NDArray[np.float32]
    """Float32 [c, n, n] in [0, 1], `TEXELS_PER_PIXEL` a pixel, n a power of two; or one colour."""
    origin: tuple[float, float] = (0.0, 0.0)  # position (x, y) of the first texel of the tile, pixels

    def moved(self, by: NDArray[np.float64]) -> Self:
        """Return the texture moved by (x, y) pixels."""
        return replace(self, origin=(self.origin[0] + float(by[0]), self.origin[1] + float(by[1])))

    def sample(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float32]:
        """Sample colours [c, k] at the points x [k], y [k] in pixels."""
        side = self.tile.shape[1]
        if side == 1:
            return np.broadcast_to(self.tile[:, :, 0], (len(self.tile), len(x)))
        left, right, across = _texels(x - self.origin[0], side)
        top, bottom, down = _texels(y - self.origin[1], side)
        top, bottom = top * side, bottom * side
        colours = np.empty((len(self.tile), len(x)), np.float32)
        for channel, colour in zip(self.tile.reshape(len(self.tile), -1), colours, strict=True):
            upper = channel[top + left]
            upper += across * (channel[top + right] - upper)
            lower = channel[bottom + left]
            lower += across * (channel[bottom + right] - lower)
            colour[:] = upper + down * (lower - upper)
        return colours


def _texels(pixels: NDArray[np.float64], side: int) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Return the two texels beside each coordinate, and its fractional position between them."""
    texels = pixels * TEXELS_PER_PIXEL
    first = np.floor(texels)
    fraction = (texels - first).astype(np.float32)
    index = first.astype(np.intp) & (side - 1)
    return index, (index + 1) & (side - 1), fraction


class Painter:
    """Makes textures from one shared tile of noise, which is slow to compute; `period` is a power of two, pixels."""

    def __init__(self, rng: np.random.Generator, period: int) -> None:
        self._rng = rng
        self._period = period
        side = period * TEXELS_PER_PIXEL
        frequency = np.hypot(
            np.fft.fftfreq(side, 1 / TEXELS_PER_PIXEL)[:, None], np.fft.rfftfreq(side, 1 / TEXELS_PER_PIXEL)
        )
        self._frequency = frequency  # cycles per pixel
        band = (frequency >= 1 / LONGEST) & (frequency <= 1 / SHORTEST)
        # Amplitude 1/f in two dimensions: every octave has the same contrast.
        falloff = np.where(band, 1 / np.maximum(frequency, 1 / LONGEST), 0.0)
        grey, *hues = (self._noise(falloff) for _ in range(4))
        self._grain = np.stack([0.92 * grey + 0.4 * hue for hue in hues])  # channels correlate, but only in part
        self._swell = self._noise(np.where((frequency > 0) & (frequency < 1 / LONGEST), 1.0, 0.0))
        y, x = np.mgrid[:side, :side] * (2 * np.pi / side)
        self._x, self._y = x, y

    def plain(self, colour: ArrayLike) -> Texture:
        """Paint a constant colour."""
        return Texture(np.asarray(colour, np.float32).reshape(-1, 1, 1))

    def clouds(self, colours: ArrayLike, grain: float) -> Texture:
        """Paint soft patches with the colours [k, 3], k >= 2."""
        return self._blend(colours, 0.5 + 0.5 * np.tanh(self._swell), grain)

    def bricks(self, colours: ArrayLike, grain: float, width: float, height: float) -> Texture:
        """Paint bricks of that size in pixels, each of its own shade between two colours, in joints of a third."""
        columns, rows = self._times(width), 2 * self._times(2 * height)  # even, so that the last row meets the first
        row, down = _cells(self._y, rows)
        column, across = _cells(self._x + np.pi / columns * (row % 2), columns)
        shades = self._rng.random((rows, columns))[row, column % columns]
        joint = np.minimum(across * self._period / columns, down * self._period / rows) < 1.5
        return self._blend(colours, np.where(joint, 1.0, 0.5 * shades), grain)

    def stripes(self, colours: ArrayLike, grain: float, width: float, turn: tuple[int, int]) -> Texture:
        """Paint wavy stripes, about `width` pixels wide; `turn` (x, y) is their direction across in small integers."""
        times = self._times(2 * width * float(np.hypot(*turn)))
        wave = np.sin(times * (turn[0] * self._x + turn[1] * self._y) + 0.8 * self._swell)
        return self._blend(colours, 0.5 + 0.5 * np.tanh(3 * wave), grain)

    def wood(self, colours: ArrayLike, grain: float, width: float) -> Texture:
        """Paint the grain of a plank along x: lines about `width` pixels apart, wider and narrower ones together."""
        bend = 0.6 * np.roll(self._swell, self._period, 1)
        lines = sum(
            np.sin(self._times(width * k) * self._y + bend * b) for k, b in ((1.0, 2.0), (0.37, 3.0), (2.3, 1.0))
        )
        return self._blend(colours, 0.5 + 0.5 * np.tanh(0.8 * lines), grain)

    def checks(self, colours: ArrayLike, grain: float, width: float) -> Texture:
        """Paint a chessboard with fields of about `width` pixels."""
        times = self._times(2 * width)
        return self._blend(colours, 0.5 + 0.5 * np.tanh(6 * np.sin(times * self._x) * np.sin(times * self._y)), grain)

    def dots(self, colours: ArrayLike, grain: float, distance: float) -> Texture:
        """Round dots of the second colour on the first, `distance` pixels apart, every other row shifted."""
        times = self._times(distance)
        bumps = np.cos(times * (self._x + self._y)) + np.cos(times * (self._x - self._y))
        return self._blend(colours, 0.5 + 0.5 * np.tanh(4 * (bumps - 0.7)), grain)

    def _times(self, wavelength: float) -> int:
        """Number of times that a wave of about that many pixels fits into the tile."""
        return max(1, round(self._period / wavelength))

    def _noise(self, amplitude: Tile) -> Tile:
        """Draw noise of that spectrum, mean 0, standard deviation 1."""
        side = len(amplitude)
        spectrum = amplitude * np.exp(2j * np.pi * self._rng.random(amplitude.shape))
        noise = scipy.fft.irfft2(spectrum, (side, side))
        noise -= noise.mean()
        return np.asarray(noise / noise.std())

    def _blend(self, colours: ArrayLike, share: Tile, grain: float) -> Texture:
        """Blend colours from the first at share 0 to the last at 1, plus grain, without wavelengths that alias."""
        ramp = np.asarray(colours, np.float64)
        stops = np.linspace(0.0, 1.0, len(ramp))
        colour = np.stack([np.interp(share, stops, channel) for channel in ramp.T]) + grain * self._grain
        # A Gaussian rolls off without ringing; it halves the contrast at the shortest wavelength.
        spectrum = scipy.fft.rfft2(colour) * np.exp(-np.log(2) * (self._frequency * SHORTEST) ** 2)
        tile = np.clip(scipy.fft.irfft2(spectrum, share.shape), 0.0, 1.0).astype(np.float32)
        x, y = self._rng.uniform(0, self._period, 2)
        return Texture(tile, (float(x), float(y)))


def _cells(phase: Tile, count: int) -> tuple[NDArray[np.intp], Tile]:
    """Return which of `count` cells of 2 pi each phase lies in, and how far from the cell's nearer edge, in cells."""
    place = phase * count / (2 * np.pi)
    cell = np.floor(place)
    return cell.astype(np.intp), 0.5 - np.abs(place - cell - 0.5)
