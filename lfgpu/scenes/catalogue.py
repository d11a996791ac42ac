"""The scenes by name: their objects, positions and textures."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.scenes.objects import Box, Disc, Ellipsoid, Quad, Relief, Shape, Wall
from lfgpu.scenes.render import Frame, Thing
from lfgpu.scenes.texture import Painter, Texture

_LOW, _HIGH = 0.03, 0.97  # shares of the disparity range: visible surfaces stay between them
_STEEPEST = 0.45  # of the relief along any ray: occlusions begin at 1

# Pairs of colours, the dark one first. Objects take them in an order that depends on the seed.
_CANDY = np.array(
    [
        [[0.78, 0.16, 0.18], [0.98, 0.55, 0.38]],
        [[0.10, 0.33, 0.62], [0.45, 0.75, 0.95]],
        [[0.90, 0.60, 0.08], [0.99, 0.86, 0.45]],
        [[0.12, 0.45, 0.28], [0.55, 0.82, 0.42]],
        [[0.42, 0.16, 0.50], [0.85, 0.52, 0.80]],
        [[0.06, 0.42, 0.46], [0.45, 0.88, 0.80]],
        [[0.80, 0.28, 0.50], [0.99, 0.72, 0.76]],
        [[0.32, 0.22, 0.18], [0.85, 0.68, 0.50]],
    ]
)
_SLATE = np.array([[0.30, 0.36, 0.44], [0.56, 0.62, 0.68], [0.82, 0.82, 0.80]])
_BRICK = np.array([[0.18, 0.34, 0.42], [0.36, 0.54, 0.58], [0.70, 0.76, 0.74]])
_WOOD = np.array([[0.48, 0.33, 0.21], [0.74, 0.56, 0.38], [0.26, 0.17, 0.11]])
_PLASTER = np.array([[0.56, 0.53, 0.48], [0.74, 0.71, 0.64], [0.86, 0.83, 0.76]])
_NIGHT = np.array([[0.12, 0.14, 0.24], [0.20, 0.27, 0.40], [0.34, 0.44, 0.56]])
_SUNRISE = np.array(
    [[0.12, 0.20, 0.42], [0.10, 0.50, 0.56], [0.62, 0.76, 0.46], [0.98, 0.72, 0.36], [0.88, 0.36, 0.40]]
)


class Stage:
    """The environment of a scene: the frame of the middle view, the region that all views see, randomness and textures.

    `farthest` are the largest |du| and |dv| of a view from the middle view.
    """

    def __init__(self, frame: Frame, farthest: tuple[float, float], rng: np.random.Generator) -> None:
        self.frame = frame
        self.rng = rng
        self.slope = frame.slope(farthest)
        self.half = np.array([frame.width, frame.height]) / (2 * frame.unit)
        # Other views see beyond the edges of the middle view, at most by this much.
        self.reach = self.half + max(abs(frame.far), abs(frame.near)) * np.array(farthest) / frame.unit
        # Just long enough that no repetition is visible, because its size dominates the time to build a scene.
        period = int(np.clip(1 << (frame.unit - 1).bit_length(), 64, 256))
        self.painter = Painter(rng, period)
        self.wall_painter = self.painter if frame.unit <= period else Painter(rng, 512)
        self._palette = _CANDY[rng.permutation(len(_CANDY))]
        self._painted = 0

    def jitter(self, size: float) -> float:
        """Draw a number uniformly from [-size, size]."""
        return float(self.rng.uniform(-size, size))

    def place(self, x: float, y: float, t: float) -> NDArray[np.float64]:
        """Return a point from shares of half the width and height (-1 to 1) and of the disparity range (0 to 1)."""
        return np.array([x * self.half[0], y * self.half[1], t])

    def paint(self) -> Texture:
        """Paint the next texture: new colours and a new pattern."""
        number, self._painted = self._painted, self._painted + 1
        colours = self._palette[number % len(self._palette)]
        match number % 4:
            case 0:
                return self.painter.dots(colours, 0.07, self.size(40, 12.0))
            case 1:
                return self.painter.stripes(colours, 0.07, self.size(13, 5.0), (1, 2))
            case 2:
                return self.painter.checks(colours, 0.07, self.size(22, 6.0))
            case _:
                return self.painter.clouds(colours, 0.10)

    def size(self, pixels: float, least: float) -> float:
        """Return a pattern's size in pixels: as given for pictures of 512 pixels, but never below `least`."""
        return max(least, pixels * self.frame.unit / 512)

    def wall(self, far: float, near: float, direction: float) -> Wall:
        """Place a plane from T = `far` to `near` over the visible region, rising towards `direction` (radians)."""
        rise = np.array([np.cos(direction), np.sin(direction)])
        grade = rise * (near - far) / 2 / (np.abs(rise) @ self.reach)
        return Wall(np.array([0.0, 0.0, (near + far) / 2]), _plane_edges(grade))

    def floor(self, horizon: float, far: float, near: float) -> Wall:
        """Place a plane from T = `far` at the share `horizon` of the half height to `near` at the lower edge."""
        top = horizon * self.half[1]
        grade = (near - far) / (self.reach[1] - top)
        # At 1 / slope the plane would be parallel to the rays of a view.
        grade = min(grade, 0.5 / max(self.slope[1], 1e-9))
        return Wall(np.array([0.0, top, far]), _plane_edges((0.0, grade)))


def relief(stage: Stage) -> list[Thing]:
    """Build smooth hills without occlusions."""
    angles = stage.rng.uniform(0, 2 * np.pi) + np.array([0.0, 1.2, 2.2])
    phases = np.array([0.0, stage.jitter(np.pi), stage.jitter(np.pi)])
    x = np.linspace(-stage.reach[0], stage.reach[0], 65)[None]
    y = np.linspace(-stage.reach[1], stage.reach[1], 65)[:, None]
    for wavelength in np.geomspace(0.6, 6.0, 24):  # the longer the flatter, the more it needs to be
        k = 2 * np.pi / wavelength * np.array([1.0, 1.35, 1.9])
        waves = np.stack([[1.0, 0.55, 0.35], k * np.cos(angles), k * np.sin(angles), phases], axis=1)
        unscaled = Relief(0.0, waves)
        height = unscaled.height(x, y)
        low, high = height.min(), height.max()
        full = (_HIGH - _LOW - 0.02) / (high - low)  # 0.02 for what lies between the samples
        allowed = _STEEPEST / max(unscaled.steepness(stage.slope), 1e-9)
        if full <= allowed:
            break
    # Where even the longest waves are too steep, the views are so far apart that the hills have to be low.
    scale = min(full, allowed)
    waves[:, 0] *= scale
    return [Thing(Relief(0.5 - scale * (high + low) / 2, waves), stage.wall_painter.clouds(_SUNRISE, 0.09))]


def planes(stage: Stage) -> list[Thing]:
    """Build slanted, overlapping rectangles in front of a slanted wall."""
    things = [Thing(stage.wall(_LOW, 0.34, 0.5 + stage.jitter(0.4)), stage.wall_painter.clouds(_NIGHT, 0.08))]
    spots = [(-0.45, -0.42, 0.42), (0.42, -0.30, 0.52), (-0.30, 0.42, 0.64), (0.48, 0.45, 0.72), (0.04, 0.05, 0.86)]
    for (x, y, t), size in zip(spots, (0.29, 0.26, 0.25, 0.21, 0.15), strict=True):
        centre = stage.place(x + stage.jitter(0.06), y + stage.jitter(0.06), t)
        grade = _tilt(stage, size, 0.09)
        angle = stage.jitter(0.6)
        things.append(Thing(Quad(centre, _plane_edges(grade, size, size * 0.8, angle)), stage.paint()))
    return things


def boxes(stage: Stage) -> list[Thing]:
    """Build boxes and balls on a floor in front of a wall."""
    return _room(stage) + [Thing(shape, paint) for shape, paint, _ in _toys(stage)]


def moving(stage: Stage) -> list[Thing]:
    """Make the objects of `boxes`; each moves along an ellipse once in time 1, and the room is fixed."""
    toys = _toys(stage)
    phases = stage.rng.uniform(0, 2 * np.pi, len(toys))
    spans = stage.rng.uniform(0.5, 1.0, len(toys))
    turns = stage.rng.choice([-1.0, 1.0], len(toys))
    return _room(stage) + [
        Thing(shape, paint, (0.10 * turn * span, 0.05 * span, room * span, phase))
        for (shape, paint, room), phase, span, turn in zip(toys, phases, spans, turns, strict=True)
    ]


def bars(stage: Stage) -> list[Thing]:
    """Build thin rods, 2 to 8 pixels wide, in front of a distant wall."""
    things = [Thing(stage.wall(_LOW, 0.20, 2.2 + stage.jitter(0.5)), stage.wall_painter.clouds(_PLASTER, 0.08))]
    paints = [stage.painter.stripes(pair, 0.07, stage.size(12, 4.0), (0, 1)) for pair in _CANDY[:5]]
    count = int(np.clip(stage.frame.width / 30, 2, 15))
    places = (np.arange(count) + 0.5) / count * 2 - 1 + stage.rng.uniform(-0.5, 0.5, count) / count
    depths = np.linspace(0.42, 0.90, count)[stage.rng.permutation(count)]
    widths = np.geomspace(2.0, 8.0, count)[stage.rng.permutation(count)]
    for x, t, width in zip(places, depths, widths, strict=True):
        radius = width / 2 / stage.frame.unit
        lean = stage.jitter(0.22)
        rise = stage.jitter(0.07) / stage.reach[1]  # over the whole picture, the range is kept
        length = 20.0  # an ellipsoid so long is a rod as wide everywhere as it is in the middle
        edges = np.array([[radius, lean * length, 0.0], [0.0, length, 0.0], [0.0, rise * length, 0.01]])
        things.append(Thing(Ellipsoid(stage.place(x, 0.0, t), edges), paints[len(things) % len(paints)]))
    return things


def textureless(stage: Stage) -> list[Thing]:
    """Build patches, a disc and a box, each of one colour, on and in front of a textured slanted wall."""
    wall = stage.wall(_LOW, 0.5, stage.jitter(0.6))
    plain = [stage.painter.plain(pair.mean(0)) for pair in _CANDY[stage.rng.permutation(len(_CANDY))]]
    bricks = stage.wall_painter.bricks(_SLATE, 0.07, stage.size(58, 18.0), stage.size(28, 10.0))
    things: list[Thing] = [Thing(wall, bricks)]
    grade = wall.edges[2, :2]
    for index, (x, y) in enumerate(((-0.58, -0.55), (0.55, 0.60))):
        x, y, _ = map(float, stage.place(x + stage.jitter(0.1), y + stage.jitter(0.1), 0.0))
        # On the wall: a hair's breadth before it, far below what a true disparity in float32 resolves.
        centre = np.array([x, y, wall.centre[2] + grade @ (x, y) + 1e-9])
        shape = (Quad, Disc)[index]
        things.append(Thing(shape(centre, _plane_edges(grade, 0.17, 0.13, 0.2 - index)), plain[index]))
    disc = stage.place(-0.22 + stage.jitter(0.1), 0.30 + stage.jitter(0.1), 0.68)
    things.append(Thing(Disc(disc, _plane_edges(_tilt(stage, 0.2, 0.06), 0.20, 0.20)), plain[2]))
    cube = _turned(stage, 0.16)
    box = stage.place(0.42 + stage.jitter(0.08), -0.32 + stage.jitter(0.08), _HIGH - np.abs(cube[2]).sum())
    things.append(Thing(Box(box, cube), plain[3]))
    return things


SCENES: dict[str, Callable[[Stage], list[Thing]]] = {
    scene.__name__: scene for scene in (relief, planes, boxes, bars, textureless, moving)
}


def _room(stage: Stage) -> list[Thing]:
    wall = stage.wall(_LOW, 0.20, stage.jitter(0.4))
    floor = stage.floor(0.12, 0.12, 0.85)
    bricks = stage.wall_painter.bricks(_BRICK, 0.06, stage.size(52, 16.0), stage.size(22, 8.0))
    planks = stage.wall_painter.bricks(_WOOD, 0.07, stage.size(180, 60.0), stage.size(26, 9.0))
    return [Thing(wall, bricks), Thing(floor, planks)]


def _toys(stage: Stage) -> list[tuple[Shape, Texture, float]]:
    """Choose the shape and texture of each object, and how far it may move in T in either direction."""
    spots: list[tuple[float, float, float, float, type[Box] | type[Ellipsoid]]] = [
        (-0.62, -0.28, 0.36, 0.15, Box),
        (0.02, -0.30, 0.42, 0.15, Ellipsoid),
        (0.60, -0.20, 0.48, 0.16, Box),
        (-0.38, 0.22, 0.60, 0.14, Ellipsoid),
        (0.30, 0.26, 0.66, 0.13, Ellipsoid),
        (-0.05, 0.52, 0.76, 0.10, Box),
        (0.66, 0.58, 0.88, 0.10, Ellipsoid),
        (-0.68, 0.66, 0.86, 0.09, Ellipsoid),
    ]
    toys: list[tuple[Shape, Texture, float]] = []
    for x, y, t, size, kind in spots:
        centre = stage.place(x + stage.jitter(0.06), y + stage.jitter(0.06), t)
        edges = _turned(stage, size) if kind is Box else np.diag([size, size, 0.9 * size])
        depth = np.abs(edges[2]).sum() if kind is Box else 0.9 * size
        toys.append((kind(centre, edges), stage.paint(), max(0.0, min(0.08, _HIGH - t - depth))))
    return toys


def _turned(stage: Stage, size: float) -> NDArray[np.float64]:
    """Return the edges of a cube of that half side that shows three faces, flattened along T."""
    yaw, pitch, roll = 0.6 + stage.jitter(0.2), -0.5 + stage.jitter(0.15), stage.jitter(0.2)
    turn = np.linalg.multi_dot([_rotation(0, 1, roll), _rotation(1, 2, pitch), _rotation(0, 2, yaw)])
    return np.asarray(np.array([[1.0], [1.0], [0.7]]) * turn * size * 0.75)


def _rotation(first: int, second: int, angle: float) -> NDArray[np.float64]:
    matrix = np.eye(3)
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[first, second], matrix[second, first] = -np.sin(angle), np.sin(angle)
    return matrix


def _tilt(stage: Stage, size: float, span: float) -> NDArray[np.float64]:
    """Draw a random slant (dT/dX, dT/dY) that changes T by `span` either way over `size`."""
    angle = stage.rng.uniform(0, 2 * np.pi)
    return span / size * np.array([np.cos(angle), np.sin(angle)])


def _plane_edges(grade: ArrayLike, width: float = 1.0, height: float = 1.0, angle: float = 0.0) -> NDArray[np.float64]:
    """Return the edges of a flat piece of that half width and height, turned by `angle`, in a plane of that slant."""
    b, c = np.asarray(grade)
    first = width * np.array([np.cos(angle), np.sin(angle)])
    second = height * np.array([-np.sin(angle), np.cos(angle)])
    return np.array([[first[0], second[0], 0.0], [first[1], second[1], 0.0], [first @ (b, c), second @ (b, c), 1.0]])
