"""Light of several lamps with soft shadows, computed once and kept in the textures of a scene that does not move.

A lamp stands in the plane of the cameras, so that its rays are those of a view at its place: lines in disparity space
that have one slope. A thing hides from a lamp what it hides from that view.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfgpu.scenes.objects import Floats, Rays
from lfgpu.scenes.render import Thing
from lfgpu.scenes.texture import TEXELS_PER_PIXEL, Texture

_GAMMA = 2.2  # of the colours of textures and views
_BEYOND = 4  # pixels that are lit around a surface, for views that see past its outline
_SAMPLES = 200  # along the longer side of a surface, at most: light changes slowly
_APART = 2e-3  # in T: a surface that is nearer than that by less is the same surface
_SHINE = 40.0  # exponent of highlights (Blinn and Phong)


@dataclass(frozen=True, eq=False)
class Lamps:
    """Lamps of one room, and its ambient light; powers are in linear light."""

    slopes: Floats  # [k, 2], the slope (U, V) of the rays of each lamp
    power: Floats  # [k], brightness of a white surface that faces the lamp
    ambient: float  # brightness of a white surface that no lamp lights

    def on(self, points: Floats, normals: Floats, things: list[Thing]) -> tuple[Floats, Floats]:
        """Compute the light that falls on points [3, k], past all things that have bounds, and their highlights."""
        light, highlight = np.full(points.shape[1], self.ambient), np.zeros(points.shape[1])
        out = normals / np.linalg.norm(normals, axis=0)
        for slope, power in zip(self.slopes, self.power, strict=True):
            towards = np.array([*slope, 1.0]) / np.hypot(np.hypot(*slope), 1.0)
            facing = towards @ out
            seen = facing > 0
            x, y = points[:2] - points[2] * slope[:, None]
            for thing in things:
                left, right, top, bottom = thing.shape.bounds(tuple(slope))
                if np.isfinite(left):  # walls hide nothing
                    at = np.flatnonzero((x > left) & (x < right) & (y > top) & (y < bottom) & seen)
                    seen[at] = ~(thing.shape.hit(Rays(x[at], y[at], tuple(slope))) > points[2, at] + _APART)
            half = towards + np.array([0.0, 0.0, 1.0])
            light += power * seen * np.maximum(facing, 0.0)
            highlight += power * seen * np.maximum(half @ out / np.linalg.norm(half), 0.0) ** _SHINE
        return light, highlight


def lit(things: list[Thing], lamps: Lamps, unit: int, reach: NDArray[np.float64]) -> list[Thing]:
    """Return the things of a scene with the light of lamps in their textures, of `unit` pixels per scene unit.

    `reach` is half the size (x, y) of the region that all views see, scene units.
    """
    sheets = [_Sheet(thing, unit, reach) for thing in things]
    points, normals = (np.concatenate(parts, 1) for parts in zip(*((s.points, s.normals) for s in sheets), strict=True))
    ends = np.cumsum([sheet.points.shape[1] for sheet in sheets])[:-1]
    fallen = (np.split(values, ends) for values in lamps.on(points, normals, things))
    return [sheet.lit(*values) for sheet, *values in zip(sheets, *fallen, strict=True)]


class _Sheet:
    """The surface of a thing as the middle view sees it past all others, in samples on a grid."""

    def __init__(self, thing: Thing, unit: int, reach: NDArray[np.float64]) -> None:
        left, right, top, bottom = thing.shape.bounds((0.0, 0.0))
        low = np.floor(np.maximum((left, top), -reach) * unit) - _BEYOND
        size = np.ceil(np.minimum((right, bottom), reach) * unit) + _BEYOND - low
        self.thing, self.low, self.size = thing, low, size
        self.step = max(1.0, float(size.max()) / _SAMPLES)
        x, y = (start + self.step * np.arange(count // self.step + 2) for start, count in zip(low, size, strict=True))
        t = thing.shape.hit(Rays(x[None] / unit, y[:, None] / unit, (0.0, 0.0)))
        self.hit = np.isfinite(t)
        row, column = np.nonzero(self.hit)
        self.points = np.stack([x[column] / unit, y[row] / unit, t[self.hit]])
        self.normals = np.broadcast_to(thing.shape.normals(self.points), self.points.shape)

    def lit(self, light: Floats, highlight: Floats) -> Thing:
        side = 1 << int(np.ceil(np.log2(self.size.max() * TEXELS_PER_PIXEL)))
        rows, columns = np.mgrid[:side, :side] / TEXELS_PER_PIXEL
        paint = self.thing.texture.sample(columns.ravel() + self.low[0], rows.ravel() + self.low[1])
        shade, shine = (self._spread(values, rows, columns) for values in (light ** (1 / _GAMMA), highlight))
        tile = np.minimum(paint.reshape(-1, side, side) * shade + self.thing.gloss * shine, 1.0)
        texture = Texture(tile.astype(np.float32), (float(self.low[0]), float(self.low[1])))
        return replace(self.thing, texture=texture, lit=True)

    def _spread(self, values: Floats, rows: Floats, columns: Floats) -> Floats:
        """Interpolate values of the samples at places in pixels; samples off the surface take their neighbours'."""
        if not len(values):
            return np.ones(rows.shape)
        grid = np.zeros(self.hit.shape)
        grid[self.hit] = values
        nearest = ndimage.distance_transform_edt(~self.hit, return_distances=False, return_indices=True)
        places = [rows / self.step, columns / self.step]
        return ndimage.map_coordinates(grid[tuple(nearest)], places, order=1, mode="nearest")
