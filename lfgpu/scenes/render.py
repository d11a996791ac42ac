"""Ray casting: the image and the true disparity of one view of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfgpu.scenes.objects import Rays, Shape
from lfgpu.scenes.texture import Texture

SUBPIXELS = 2  # rays along each side of a pixel; enough, because the textures are band-limited
_STRIP = 1 << 16  # rays that are cast at a time, so that their arrays fit into the cache


_LIGHT = np.array([-0.45, -0.62, 0.65])  # towards the light: left, above, in front
_AMBIENT, _DIFFUSE = 0.5, 0.62  # the sum exceeds 1: surfaces that face the light are brighter than their texture


@dataclass(frozen=True, eq=False)
class Thing:
    """A textured surface. `path` is the ellipse along which it moves once in time 1: X, Y, T half axes and phase.

    The texture of a thing that is `lit` has its light in it (see `lamps`), with highlights as bright as its `gloss`;
    another is shaded by its normals.
    """

    shape: Shape
    texture: Texture
    path: tuple[float, float, float, float] | None = None
    gloss: float = 0.0
    lit: bool = False

    def place(self, time: float) -> NDArray[np.float64]:
        """Return the displacement (X, Y, T) from the centre of its ellipse at a time."""
        if self.path is None:
            return np.zeros(3)
        x, y, t, phase = self.path
        angle = 2 * np.pi * time + phase
        return np.array([x * np.cos(angle), y * np.sin(angle), t * np.sin(angle)])

    def at(self, time: float, unit: int) -> Thing:
        """Return the object at a time, with `unit` pixels per scene unit."""
        if self.path is None:
            return self
        by = self.place(time)
        return Thing(self.shape.moved(by), self.texture.moved(by[:2] * unit))  # the texture moves with the surface


class Frame(NamedTuple):
    """The conversion from pixels and disparities of the middle view to scene units (see `objects`)."""

    height: int
    width: int
    far: float
    near: float

    @property
    def unit(self) -> int:
        """Pixels per scene unit."""
        return min(self.height, self.width)

    def slope(self, offset: tuple[float, float]) -> tuple[float, float]:
        """Return (U, V) of the rays of the view at `offset` (du, dv) from the middle view."""
        scale = (self.near - self.far) / self.unit
        return offset[0] * scale, offset[1] * scale

    def rays(self, offset: tuple[float, float], subpixels: int) -> Rays:
        """Cast all rays of the view at `offset`, with `subpixels` x `subpixels` rays per pixel."""
        du, dv = offset
        x = (np.arange(self.width * subpixels) + 0.5) / subpixels - 0.5 - (self.width - 1) / 2
        y = (np.arange(self.height * subpixels) + 0.5) / subpixels - 0.5 - (self.height - 1) / 2
        return Rays((x + self.far * du)[None] / self.unit, (y + self.far * dv)[:, None] / self.unit, self.slope(offset))


def disparity(things: list[Thing], frame: Frame, offset: tuple[float, float]) -> NDArray[np.float64]:
    """Compute the disparity [y, x] at the first hit of the ray through the centre of each pixel."""
    rays = frame.rays(offset, 1)
    nearest = np.concatenate([_cast(things, strip)[0] for strip in _strips(rays, 1)])
    return frame.far + (frame.near - frame.far) * nearest


def motion(
    things: list[Thing], times: tuple[float, float], frame: Frame, offset: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Compute [3, y, x], by how much what a pixel shows at the first time moves right and down (pixels) and in
    disparity until the second; and [y, x], which thing that is.
    """
    before = [thing.at(times[0], frame.unit) for thing in things]
    owner = np.concatenate([_cast(before, strip)[1] for strip in _strips(frame.rays(offset, 1), 1)])
    by = np.array([thing.place(times[1]) - thing.place(times[0]) for thing in things])
    slope = np.array(frame.slope(offset))
    moves = np.column_stack([(by[:, :2] - by[:, 2:] * slope) * frame.unit, by[:, 2] * (frame.near - frame.far)])
    return np.moveaxis(moves[owner], 2, 0), owner


def picture(things: list[Thing], frame: Frame, offset: tuple[float, float]) -> NDArray[np.float32]:
    """Render the image [c, y, x] in [0, 1]: the mean colour over each pixel."""
    strips = []
    for rays in _strips(frame.rays(offset, SUBPIXELS), SUBPIXELS):
        colours = _colours(things, rays, frame.unit)
        channels, height, width = colours.shape
        fine = colours.reshape(channels, height // SUBPIXELS, SUBPIXELS, width // SUBPIXELS, SUBPIXELS)
        strips.append(fine.mean(axis=(2, 4)))
    return np.concatenate(strips, axis=1)


def shading(normals: NDArray[np.float64]) -> NDArray[np.float32]:
    """Compute the factor by which surfaces with those normals [3, k], of any length, shade their texture."""
    facing = _LIGHT @ normals / (np.linalg.norm(normals, axis=0) * np.linalg.norm(_LIGHT))
    return (_AMBIENT + _DIFFUSE * np.maximum(facing, 0.0)).astype(np.float32)


def _strips(rays: Rays, multiple: int) -> list[Rays]:
    """Cut the rays into strips of rows, a multiple of `multiple` rows each."""
    rows = max(1, _STRIP // (rays.x.size * multiple)) * multiple
    return [Rays(rays.x, rays.y[top : top + rows], rays.slope) for top in range(0, rays.y.size, rows)]


def _cast(things: list[Thing], rays: Rays) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return T [h, w] of the first hit of each ray, and the index of the object."""
    nearest = np.full((rays.y.size, rays.x.size), -np.inf)
    owner = np.full(nearest.shape, -1)
    for index, thing in enumerate(things):
        left, right, top, bottom = thing.shape.bounds(rays.slope)
        columns = slice(*np.searchsorted(rays.x[0], (left, right)))
        rows = slice(*np.searchsorted(rays.y[:, 0], (top, bottom)))
        if columns.start == columns.stop or rows.start == rows.stop:
            continue
        t = thing.shape.hit(Rays(rays.x[:, columns], rays.y[rows], rays.slope))
        nearer = t >= nearest[rows, columns]  # False where t is NaN, a miss
        nearest[rows, columns][nearer] = t[nearer]
        owner[rows, columns][nearer] = index
    return nearest, owner


def _colours(things: list[Thing], rays: Rays, unit: int) -> NDArray[np.float32]:
    """Render the colour [c, h, w] at the first hit of each ray."""
    nearest, owner = _cast(things, rays)
    colours = np.empty((3, nearest.size), np.float32)
    for index in np.flatnonzero(np.bincount(owner.ravel())):
        hit = np.flatnonzero(owner == index)
        row, column = np.divmod(hit, rays.x.size)
        t = nearest.ravel()[hit]
        points = np.stack([rays.x[0, column] + t * rays.slope[0], rays.y[row, 0] + t * rays.slope[1], t])
        thing = things[index]
        paint = thing.texture.sample(points[0] * unit, points[1] * unit)
        colours[:, hit] = paint if thing.lit else paint * shading(thing.shape.normals(points))
    return np.minimum(colours, 1.0).reshape(3, *nearest.shape)
