"""The scene `still_life`: things on a table before a wall, with soft shadows."""

import numpy as np
from numpy.typing import NDArray

from lfgpu.scenes.catalogue import Stage
from lfgpu.scenes.lamps import Lamps, lit
from lfgpu.scenes.objects import Box, Disc, Ellipsoid, Frustum
from lfgpu.scenes.render import Thing

_DEEP = 0.42  # of a scene unit: how much shorter lengths on the table look that lead away from the cameras
_GOLDEN = np.pi * (3 - np.sqrt(5))  # radians between neighbours on a spiral that fills a disc evenly


def still_life(stage: Stage) -> list[Thing]:
    """Build a plant, a vase, books, a cup and fruit on a table, and a canvas on the wall behind."""
    table, jitter = _Table(stage), stage.jitter
    wall = stage.wall_painter.clouds(_colours("b9b6a8 c9c6b8 d3d0c2"), 0.035)
    planks = stage.wall_painter.wood(_colours("6e4a2f 8d6341 a3784f b98d60"), 0.045, stage.size(30, 12.0))
    things = [
        Thing(stage.wall(0.03, 0.08, jitter(0.4)), wall),
        Thing(table.top, planks),
        *_canvas(stage, 0.04 + jitter(0.1), -0.56),
        *_plant(table, -0.56 + jitter(0.05), 0.34),
        *_vase(table, 0.60 + jitter(0.05), 0.32),
        *_books(table, 0.02 + jitter(0.05), 0.44),
        *_fruit(table, 0.46 + jitter(0.04), 0.68),
        *_cup(table, -0.26 + jitter(0.05), 0.70),
        *_dice(table, -0.72 + jitter(0.05), 0.72),
    ]
    window, room = np.array([-1.0, -1.3]) + _disc(14, 0.35), np.array([0.0, -0.6]) + _disc(12, 3.0)
    slopes = np.concatenate([window, room])
    lamps = Lamps(slopes, np.repeat((0.85 / 14, 0.60 / 12), (14, 12)), ambient=0.10)
    return lit(things, lamps, stage.frame.unit, stage.reach)


def _colours(hexadecimal: str) -> NDArray[np.float64]:
    return np.array([list(bytes.fromhex(colour)) for colour in hexadecimal.split()]) / 255


def _disc(count: int, radius: float) -> NDArray[np.float64]:
    """Return points [count, 2] spread evenly over a disc."""
    turn, away = np.arange(count) * _GOLDEN, radius * np.sqrt((np.arange(count) + 0.5) / count)
    return np.stack([away * np.cos(turn), away * np.sin(turn)], 1)


class _Table:
    """A table top and places on it: T grows down the picture."""

    def __init__(self, stage: Stage) -> None:
        self.stage, self.painter = stage, stage.painter
        self.top = stage.floor(-0.10, 0.12, 0.94)
        self.grade = float(self.top.edges[2, 1])

    def point(self, x: float, t: float, up: float = 0.0) -> NDArray[np.float64]:
        """Return the point above a place on the table: x as in `Stage.place`, up in scene units."""
        place = self.stage.place(x, 0.0, t)
        place[1] = self.top.centre[1] + (t - self.top.centre[2]) / self.grade - up
        return place

    def edges(self, wide: float, high: float, deep: float, turn: float = 0.0) -> NDArray[np.float64]:
        """Return the edges of an upright body of those half sizes, turned on the table."""
        across, away = (np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)]))
        first, third = ((x, _DEEP * z, _DEEP * z * self.grade) for x, z in (wide * across, deep * away))
        return np.array([first, (0.0, high, 0.0), third]).T

    def round(self, place: tuple[float, float, float], radius: float, high: float, taper: float = 0.0) -> Frustum:
        """Return a round body on a place (x, t, up) of the table."""
        x, t, up = place
        return Frustum(self.point(x, t, up + high), self.edges(radius, high, radius), taper)

    def lid(self, place: tuple[float, float, float], radius: float) -> Disc:
        """Return a disc that lies a hair's breadth above a place of the table."""
        x, t, up = place
        edges = self.edges(radius, 0.0, radius)[:, [0, 2, 1]] + [[0, 0, 0], [0, 0, 0], [0, 0, 1]]
        return Disc(self.point(x, t, up + 1e-3), edges)


def _canvas(stage: Stage, x: float, y: float) -> list[Thing]:
    shape = Box(stage.place(x, y, 0.14), np.diag([0.145, 0.115, 0.02]))
    return [Thing(shape, stage.painter.clouds(_colours("1f3550 2f7c8c e9c46a e58b4a c8503c"), 0.05))]


def _plant(table: _Table, x: float, t: float) -> list[Thing]:
    paint, rng = table.painter, table.stage.rng
    clay = paint.clouds(_colours("9c4a2e c4704a"), 0.05)
    greens = [
        paint.stripes(_colours(pair), 0.05, table.stage.size(14, 5.0), (1, 1))
        for pair in ("1b4d1f 4f8f35", "2a6322 86b84a")
    ]
    things = [
        Thing(table.round((x, t, 0.0), 0.085, 0.070, -0.2), clay, gloss=0.1),
        Thing(table.round((x, t, 0.140), 0.112, 0.014), clay, gloss=0.1),
        Thing(table.lid((x, t, 0.168), 0.100), paint.clouds(_colours("2b1d14 4a3626"), 0.07)),
    ]
    foot, bark = table.point(x, t, 0.168), paint.clouds(_colours("3d4a1e 66702f"), 0.05)
    for stem in range(13):
        lean, length, nearer = rng.uniform(-0.8, 0.8), rng.uniform(0.19, 0.36), rng.uniform(-0.10, 0.10)
        half = 0.5 * np.array([length * np.sin(0.4 * lean), -length * np.cos(0.4 * lean), nearer])
        twig = Ellipsoid(foot + half, np.stack([half, (0.006, 0.0, 0.0), (0.0, 0.0, 0.004)], 1))
        things.append(Thing(twig, bark))
        for share in np.linspace(0.3, 1.0, 5):
            bend = lean * share**1.3
            at = foot + share * np.array([length * np.sin(bend), -length * np.cos(bend), nearer])
            angle, size = bend + rng.choice([-1, 1]) * rng.uniform(0.5, 1.3), rng.uniform(0.032, 0.055)
            along = size * np.array([np.sin(angle), -np.cos(angle), rng.uniform(-0.5, 0.5)])
            across = 0.42 * size * np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.9, 0.9)])
            leaf = Disc(at + along, np.stack([along, across, (0.0, 0.0, 1.0)], 1))
            things.append(Thing(leaf, greens[stem % 2], gloss=0.15))
    return things


def _vase(table: _Table, x: float, t: float) -> list[Thing]:
    glaze = table.painter.stripes(_colours("1d3a72 eef0ea"), 0.04, table.stage.size(24, 8.0), (1, 2))
    body = Ellipsoid(table.point(x, t, 0.125), table.edges(0.105, 0.130, 0.105))
    neck = table.round((x, t, 0.225), 0.036, 0.055), table.round((x, t, 0.330), 0.052, 0.007)
    return [Thing(shape, glaze, gloss=0.6) for shape in (body, *neck)]


def _books(table: _Table, x: float, t: float) -> list[Thing]:
    things, up = [], 0.0
    for wide, high, deep, colours in (
        (0.19, 0.026, 0.17, "7d1d20 a83c33"),
        (0.165, 0.020, 0.15, "1c4a5c 3f7886"),
        (0.15, 0.023, 0.14, "b59a5b d9c48a"),
    ):
        shape = Box(table.point(x, t, up + high), table.edges(wide, high, deep, table.stage.jitter(0.15)))
        things.append(Thing(shape, table.painter.clouds(_colours(colours), 0.05), gloss=0.15))
        up += 2 * high
    dots = table.painter.dots(_colours("1f3f7a f2f2ec"), 0.04, table.stage.size(30, 10.0))
    return [*things, Thing(Ellipsoid(table.point(x, t, up + 0.06), table.edges(0.06, 0.06, 0.06)), dots, gloss=0.5)]


def _fruit(table: _Table, x: float, t: float) -> list[Thing]:
    paint = table.painter
    plate = paint.stripes(_colours("f4f2ea dfe6ea"), 0.03, table.stage.size(30, 8.0), (1, 0))
    things = [Thing(table.round((x, t, 0.0), 0.20, 0.010), plate, gloss=0.3)]
    for dx, dt, wide, high, colours in (
        (-0.12, -0.03, 0.080, 0.076, "e07a12 f7a83a"),
        (0.13, -0.06, 0.072, 0.066, "93171a d8552f"),
        (0.08, 0.08, 0.082, 0.060, "dcbc22 f5e27a"),
    ):
        shape = Ellipsoid(table.point(x + dx, t + dt, 0.02 + high), table.edges(wide, high, 1.1 * high))
        things.append(Thing(shape, paint.clouds(_colours(colours), 0.05), gloss=0.35))
    return things


def _cup(table: _Table, x: float, t: float) -> list[Thing]:
    china = table.painter.dots(_colours("f4efe2 b8322c"), 0.03, table.stage.size(34, 11.0))
    coffee = table.painter.clouds(_colours("2a180d 43291a"), 0.03)
    return [
        Thing(table.round((x, t, 0.0), 0.075, 0.070, -0.12), china, gloss=0.5),
        Thing(table.lid((x, t, 0.140), 0.058), coffee, gloss=0.2),
    ]


def _dice(table: _Table, x: float, t: float) -> list[Thing]:
    checks = table.painter.checks(_colours("235a8c 8ec1e6"), 0.04, table.stage.size(18, 6.0))
    cube = Box(table.point(x, t, 0.055), table.edges(0.055, 0.055, 0.055, 0.6 + table.stage.jitter(0.3)))
    return [Thing(cube, checks, gloss=0.2)]
