"""Scenes and arrays of cameras drawn at random; scenes are tables of primitives with their looks and their light.

Each scene is a furnished room, or a part of one: a background, perhaps a floor and walls that reach the ends of the
range, and things in front of it: solids, pictures, leaves, nets, bars, rows of things with narrow gaps. `casting`
in the Warp kernels says what the numbers mean.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array
from lfgpu.training import casting
from lfgpu.training.textures import SMOOTH

ROOM = 4
"""Primitives of a scene that are its background, floor and walls."""

SPANS = 1.5, 40.0
"""Pixels in the farthest view over which the disparities of a scene are spread."""

_ANGLES = 6.2832
_TEXTURED = 0.15, 0.8  # contrast of things in matt scenes, at least
_WELL_LIT = 0.7  # their exposure, at least
_MOST_VIEWS = 40  # beside the reference, that are kept of a larger array


class Draw:
    """Random arrays of one shape, [scenes, primitives]."""

    def __init__(self, rng: np.random.Generator, shape: tuple[int, ...]) -> None:
        self.rng, self.shape = rng, shape

    def uniform(self, low: float = 0.0, high: float = 1.0) -> Float64Array:
        """Draw evenly between two numbers."""
        return self.rng.uniform(low, high, self.shape)

    def scale(self, low: float, high: float) -> Float64Array:
        """Draw evenly between the logarithms of two numbers."""
        return np.exp(self.uniform(np.log(low), np.log(high)))

    def often(self, share: float) -> NDArray[np.bool_]:
        """Draw True for a share of the elements."""
        return self.rng.random(self.shape) < share

    def whole(self, count: int) -> NDArray[np.int64]:
        """Draw whole numbers from 0 to `count` - 1."""
        return self.rng.integers(0, count, self.shape)

    def one_of(self, shares: dict[int, float]) -> NDArray[np.int64]:
        """Draw keys in proportion to their values."""
        total = np.cumsum(list(shares.values()))
        places = np.searchsorted(total / total[-1], self.rng.random(self.shape))
        return np.array(list(shares))[np.minimum(places, len(shares) - 1)]


Table = NDArray[Any]
"""Rows of a struct."""

Tables = tuple[Table, Table, Table]
"""Shapes and looks of the primitives [scenes, primitives], and the light [scenes]."""


def draw_scenes(
    count: int,
    side: float,
    rng: np.random.Generator,
    *,
    primitives: int = 30,
    textures: int = 64,
    spans: tuple[float, float] = SPANS,
    limits: tuple[float, float] | None = None,
    matt: float = 0.0,
) -> Tables:
    """Draw scenes for pictures of about `side` pixels, whose textures are the first `textures` of a set.

    Their disparities are spread over the `spans`, pixels in the farthest view, in any range, or lie about within
    `limits`. In a share `matt` of the scenes, all things are matt, textured and in good light.
    """
    each, one = Draw(rng, (count, primitives)), Draw(rng, (count, 1))
    slots = np.arange(primitives)[None]
    span = one.scale(*spans)
    low = np.where(one.often(0.7), -span * one.uniform(0.2, 0.8), one.uniform(-20, 20) - span / 2)
    if limits is not None:
        whole = min(limits[1] - limits[0], spans[1])
        span = whole * np.where(one.often(0.5), one.uniform(0.85, 1.0), one.uniform(0.3, 1.0))
        low = limits[0] + (limits[1] - limits[0] - span) * one.uniform()
    shapes = _table(casting.Shape, each.shape)
    looks = _table(casting.Look, each.shape)

    # Places: things stand anywhere, at few or many disparities, near ones more or less often.
    things = ROOM + 1 + np.floor((primitives - ROOM) * one.uniform() ** one.scale(0.4, 2.0))
    depth = each.uniform() ** one.scale(0.4, 2.5)
    layers = np.floor(one.scale(2, 9))
    depth = np.where(one.often(0.25), np.floor(depth * layers) / layers, depth)
    place = np.stack(
        [each.uniform(-0.15, 1.15) * side, each.uniform(-0.15, 1.15) * side, low + span * (0.06 + 0.92 * depth)], -1
    )
    angle = np.where(each.often(0.4), np.rint(each.uniform(0, 4)) * np.pi / 2, each.uniform(0, _ANGLES))
    large = one.scale(0.6, 1.5) * each.scale(0.02, 0.4) * side
    aspect = each.scale(0.35, 3.0)
    size = np.stack([large * aspect, large / aspect, np.minimum(span * each.uniform(0.02, 0.4), 0.5 * large)], -1)
    level = each.scale(0.002, 0.15) * np.maximum(span / SPANS[1], 1)
    through = np.minimum(span / side * each.scale(0.3, 2.0), 0.9)  # through the whole range, as floors
    steep = np.where(each.often(0.4), through, level * each.often(0.6))
    towards = each.uniform(0, _ANGLES)
    slope = np.stack([steep * np.cos(towards), steep * np.sin(towards)], -1)

    kind = each.one_of({casting.SHEET: 0.5, casting.QUADRIC: 0.25, casting.BOX: 0.25})
    kind = np.where(one.often(0.15), each.one_of({casting.SHEET: 0.15, casting.QUADRIC: 0.35, casting.BOX: 0.5}), kind)
    masks = {casting.RECTANGLE: 0.3, casting.ELLIPSE: 0.08, casting.BLOB: 0.2, casting.BARS: 0.1, casting.NET: 0.08,
             casting.LEAVES: 0.12, casting.HOLES: 0.04, casting.TORN: 0.08}  # fmt: skip
    mask = each.one_of(masks)
    mask = np.where(one.often(0.08), each.one_of({casting.LEAVES: 0.8, casting.RECTANGLE: 0.2}), mask)
    wide = (kind == casting.SHEET) & (mask >= casting.BARS)
    size[..., 0] = np.where(wide, each.uniform(0.08, 0.7) * side, size[..., 0])
    size[..., 1] = np.where(wide, each.uniform(0.08, 0.7) * side, size[..., 1])
    cage = one.often(0.08) & (slots == ROOM)  # bars or a net before everything
    mask = np.where(cage, each.one_of({casting.BARS: 0.5, casting.NET: 0.5}), mask)
    kind = np.where(cage, casting.SHEET, kind)
    size[..., :2] = np.where(cage[..., None], 2.0 * side, size[..., :2])
    place[..., 2] = np.where(cage, low + span * 0.97, place[..., 2])
    roundness = np.where(each.often(0.45), 0.0, 1.0)
    thin = each.often(0.25) & ~cage  # sticks: as sheets, as cylinders, as boxes
    size[..., 0] = np.where(thin, each.scale(0.35, 6.0), size[..., 0])
    size[..., 1] = np.where(thin, each.uniform(0.1, 0.8) * side, size[..., 1])
    size[..., 2] = np.where(thin & (kind != casting.SHEET), np.minimum(size[..., 0], 0.3 * span), size[..., 2])
    mask = np.where(thin & (mask >= casting.ELLIPSE), casting.RECTANGLE, mask)
    roundness = np.where(thin, 0.0, roundness)
    shelf = one.often(0.12) & (slots > ROOM)  # things side by side with narrow gaps
    board = np.floor((slots - ROOM) / 8)
    wide_as = side / 8 * one.uniform(0.5, 1.1)
    kind = np.where(shelf, casting.BOX, kind)
    place[..., 0] = np.where(shelf, ((slots - ROOM) % 8) * wide_as + one.uniform(0, 20), place[..., 0])
    place[..., 1] = np.where(shelf, (board + 0.5) * side / 3 * one.uniform(0.8, 1.3), place[..., 1])
    place[..., 2] = np.where(shelf, low + span * (one.uniform(0.2, 0.8) + each.uniform(-0.12, 0.12)), place[..., 2])
    size[..., 0] = np.where(shelf, wide_as / 2 * each.uniform(0.75, 1.02), size[..., 0])
    size[..., 1] = np.where(shelf, side / 6 * each.uniform(0.6, 1.0), size[..., 1])
    size[..., 2] = np.where(shelf, span * each.uniform(0.02, 0.15), size[..., 2])
    angle = np.where(shelf, 0.03 * each.uniform(-1, 1) * each.often(0.3), angle)
    tilt = np.where(kind == casting.BOX, 1.0, 0.25)[..., None] * np.stack(
        [each.uniform(-1, 1), each.uniform(-1, 1)], -1
    )
    tilt = tilt * (each.uniform() * 0.4)[..., None] / np.maximum(size[..., 2:], 0.3)
    tilt = np.where((thin | (kind == casting.SHEET))[..., None], 0.0, tilt)

    # The room: a far sheet, and floor, walls, ceiling whose slope may reach through the whole range.
    walls = (slots < ROOM) & ((slots == 0) | each.often(0.3))
    walls = walls & ((slots <= 1) | one.often(0.6))
    kind, mask = np.where(slots < ROOM, casting.SHEET, kind), np.where(slots < ROOM, casting.WHOLE, mask)
    square = np.where(each.often(0.7), np.rint(each.uniform(0, 4)) * np.pi / 2, each.uniform(0, _ANGLES))
    back = np.where(one.often(0.5), 0.0, 0.3) * span / side * each.uniform(-1, 1)
    floor = (slots > 0) & (slots < ROOM)
    slope[..., 0] = np.where(floor, through * np.cos(square), np.where(slots == 0, back, slope[..., 0]))
    slope[..., 1] = np.where(floor, through * np.sin(square), np.where(slots == 0, back[:, ::-1], slope[..., 1]))
    place[..., :2] = np.where(
        (slots < ROOM)[..., None], np.stack([each.uniform(), each.uniform()], -1) * side, place[..., :2]
    )
    place[..., 2] = np.where(floor, low + span * each.uniform(-0.1, 0.4), place[..., 2])
    place[..., 2] = np.where(slots == 0, low + span * each.uniform(0.0, 0.06), place[..., 2])
    present = np.where(slots < ROOM, walls, slots < things) | cage
    only_room = one.often(0.04) & (slots >= ROOM)
    present = present & ~only_room

    shapes["kind"], shapes["mask"], shapes["seed"] = kind, mask, each.whole(1 << 20)
    shapes["centre"], shapes["size"], shapes["slope"], shapes["tilt"] = place, size, slope, tilt
    shapes["axis"] = np.stack([np.cos(angle), np.sin(angle)], -1)
    shapes["roundness"] = roundness
    period = each.scale(3.0, 40.0)
    shapes["period"] = np.stack([period, period * each.scale(0.6, 1.7)], -1)
    shapes["period"][..., 0] = np.where(mask == casting.TORN, each.scale(0.25, 2.0), shapes["period"][..., 0])
    fill = np.where(
        (mask == casting.LEAVES) | (mask == casting.HOLES), each.uniform(0.25, 0.7), each.uniform(0.12, 0.7)
    )
    fill = np.where(mask == casting.BLOB, each.uniform(0.1, 0.8), fill)
    fill = np.where(mask == casting.TORN, each.uniform(0.35, 0.6), fill)
    shapes["fill"] = np.stack([fill, np.where(mask == casting.NET, each.uniform(0.1, 0.5), each.uniform(0.4, 1.0))], -1)
    waves = (kind == casting.SHEET) & each.often(0.25)
    rate = each.scale(0.02, 0.4)
    shapes["relief"] = np.where(waves, np.minimum(each.uniform(0, 0.15) / rate, 0.15 * span), 0.0)
    for k, faster in enumerate((1.0, 2.1, 4.0)):
        way, own = each.uniform(0, _ANGLES), rate * faster * each.uniform(0.7, 1.3)
        shapes["waves"][..., k, :] = np.stack([own * np.cos(way), own * np.sin(way), each.uniform(0, _ANGLES)], -1)
    _bound(shapes)
    shapes["centre"][..., 2] = np.where(present, shapes["centre"][..., 2], -1e6)
    shapes["reach"] = np.where(present[..., None], shapes["reach"], -1.0)

    order = np.argsort(-(shapes["centre"][..., 2] + shapes["reach"][..., 2]), axis=1, kind="stable")
    shapes = np.take_along_axis(shapes, order, 1)
    _dress(looks, shapes, side, textures, each, one)
    lights = _light(count, rng, span[:, 0], low[:, 0])
    if matt > 0:
        _make_matt(looks, lights, one.often(matt)[:, 0], rng)
    return shapes, looks, lights


def _table(struct: Any, shape: tuple[int, ...]) -> Table:
    """Make rows of a struct, all zero."""
    return np.zeros(shape, struct.numpy_dtype())


def _bound(shapes: Table) -> None:
    """Set the bounds of each primitive."""
    size, slope = shapes["size"], np.abs(shapes["slope"])
    whole = (shapes["kind"] == casting.SHEET) & (shapes["mask"] == casting.WHOLE)
    round_ = np.hypot(size[..., 0], size[..., 1]) * np.where(shapes["mask"] == casting.BLOB, 2.0, 1.0)
    own = np.where(shapes["kind"] == casting.SHEET, 2.0 * shapes["relief"], size[..., 2])
    depth = own + slope.sum(-1) * round_
    sheared = (np.abs(shapes["tilt"]) * size[..., :2]).sum(-1) * depth
    # A side that leans along the line of sight changes the disparities that belong to it, and these its place again.
    round_, depth = round_ + 1.5 * sheared, depth + 1.5 * slope.sum(-1) * sheared
    infinite = np.full_like(round_, 1e7)
    shapes["reach"] = np.stack(
        [*(np.where(whole, infinite, round_ + 1),) * 2, np.where(whole, infinite, depth + 0.1)], -1
    )


def _dress(looks: Table, shapes: Table, side: float, textures: int, each: Draw, one: Draw) -> None:
    """Draw how primitives look."""
    rng, shape = each.rng, each.shape
    angle = each.uniform(0, _ANGLES)
    scale = each.scale(0.15, 3.0)
    looks["texture"] = np.where(each.often(0.15), each.whole(SMOOTH), SMOOTH + each.whole(textures - SMOOTH))
    looks["frame"] = np.stack(
        [np.cos(angle) * scale, np.sin(angle) * scale, each.uniform(0, 256), each.uniform(0, 256)], -1
    )
    contrast = each.scale(0.02, 1.3)
    contrast = np.where(each.often(0.15), 0.1 * contrast, contrast)
    contrast = np.where(one.often(0.2), 0.2 * contrast, contrast)  # scenes of plain things
    room = (shapes["kind"] == casting.SHEET) & (shapes["mask"] == casting.WHOLE)
    contrast = np.where(room & each.often(0.35), each.scale(0.002, 0.05), contrast)  # plain walls and tables
    looks["contrast"] = contrast
    grey = each.uniform(0.08, 0.95)[..., None]
    colour = grey + (rng.random((*shape, 3)) - 0.5) * (0.6 * each.uniform())[..., None]
    tint = rng.uniform(0.15, 0.85, (shape[0], 1, 1)) + (colour - 0.5) * 0.3
    looks["colour"] = np.clip(np.where(one.often(0.3)[..., None], tint, colour), 0.02, 1.0)
    looks["second"] = np.clip(rng.random((*shape, 3)) * 0.6 + rng.random((*shape, 1)) * 0.4, 0, 1)
    looks["pattern"] = np.where(each.often(0.35), 1 + each.whole(5), casting.PLAIN)
    cell = each.scale(3.0, 50.0)
    looks["cell"] = np.stack([cell, cell * each.scale(0.4, 1.5)], -1)
    looks["strength"] = each.uniform() ** 1.5
    lamp, bright = one.uniform(0, _ANGLES) + each.uniform(-0.3, 0.3), each.uniform(0, 0.6)
    looks["shading"] = np.stack([bright * np.cos(lamp), bright * np.sin(lamp)], -1)
    size = shapes["size"][..., :2].min(-1).clip(2, side)
    looks["gloss"] = np.where(each.often(0.12), each.uniform(0.05, 0.7), 0.0)
    looks["spot"] = np.stack([each.uniform(-1, 1) * size, each.uniform(-1, 1) * size, each.scale(2.0, 40.0)], -1)
    looks["drift"] = np.stack([each.uniform(-12, 12), each.uniform(-12, 12)], -1)
    metal = one.often(0.25) & each.often(0.25)
    looks["mirror"] = np.where(metal, each.uniform(0.2, 0.7), np.where(each.often(0.06), each.uniform(0.03, 0.25), 0.0))
    looks["mirrored"] = shapes["centre"][..., 2] + each.uniform(-25, 10)
    looks["glow"] = np.where(each.often(0.015), each.uniform(1, 5), 0.0)


def _light(count: int, rng: np.random.Generator, span: Float64Array, low: Float64Array) -> Table:
    """Draw light and cameras."""
    draw = Draw(rng, (count,))
    lights = _table(casting.Light, (count,))
    long = draw.scale(20, 300)
    way = draw.uniform(0, _ANGLES)
    lights["direction"] = np.stack([long * np.cos(way), long * np.sin(way), span * draw.uniform(0.3, 2.0)], -1)
    lights["radius"] = draw.scale(0.01, 0.4)
    lights["shadow"] = np.where(draw.often(0.5), draw.uniform(0.2, 0.9), 0.0)
    lights["haze"] = np.where(draw.often(0.4), draw.uniform(0.1, 0.8), 0.0)
    lights["haze_scale"] = draw.scale(0.05, 0.6)
    lights["exposure"] = np.where(draw.often(0.75), draw.scale(0.5, 2.2), draw.scale(0.08, 0.8))
    lights["pixel"] = draw.uniform(1.0, 1.5)
    lights["gamma"] = np.where(draw.often(0.75), draw.uniform(1.8, 2.4), draw.uniform(1.0, 1.8))
    lights["vignetting"] = np.where(draw.often(0.25), draw.uniform(0, 0.5), 0.0)
    lights["aperture"] = np.where(draw.often(0.2), draw.uniform(0.0, 0.12), 0.0)
    lights["focus"] = low + span * draw.uniform()
    noise = draw.uniform()  # as rendered pictures have it, as good cameras, as cheap ones
    lights["read"] = np.where(noise < 0.35, 0.0, np.where(noise < 0.8, 0.012, 0.04) * draw.uniform())
    lights["shot"] = np.where((noise < 0.35) | draw.often(0.3), 0.0, 0.035 * draw.uniform())
    lights["levels"] = 2.0 ** draw.one_of({8: 0.8, 10: 0.1, 12: 0.1}) - 1
    return lights


def _make_matt(looks: Table, lights: Table, which: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """Make all things of some scenes matt and textured, and light these well."""
    for shines in ("gloss", "mirror", "glow"):
        looks[shines][which] = 0.0
    shape = looks["contrast"][which].shape
    looks["contrast"][which] = np.maximum(looks["contrast"][which], Draw(rng, shape).scale(*_TEXTURED))
    lights["exposure"][which] = np.maximum(lights["exposure"][which], _WELL_LIT)


def draw_array(rng: np.random.Generator) -> Float64Array:
    """Draw the offsets (du, dv) of the views beside the reference, [n, 2]; the farthest has max(|du|, |dv|) = 1."""
    kind = rng.choice(["grid", "star", "cross", "row", "scattered", "corner"], p=[0.3, 0.25, 0.15, 0.1, 0.12, 0.08])
    side = int(rng.choice([1, 2, 3, 4, 8], p=[0.12, 0.18, 0.2, 0.4, 0.1]))
    steps = np.arange(-side, side + 1)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2).astype(float)
    du, dv = grid.T
    if kind == "star":
        grid = grid[(du == 0) | (dv == 0) | (np.abs(du) == np.abs(dv))]
    elif kind == "cross":
        grid = grid[(du == 0) | (dv == 0)]
    elif kind == "row":
        grid = grid[dv == 0]
        grid = grid + rng.uniform(-1, 1) * side * np.array([1.0, 0.0]) * (rng.random() < 0.3)
        grid = grid[:, ::-1] if rng.random() < 0.5 else grid
    elif kind == "scattered":
        count = int(rng.integers(6, 25))
        grid = rng.uniform(-1, 1, (count, 2)) * side
    elif kind == "corner":
        grid = grid + rng.integers(-side, side + 1, 2)
    grid = grid[np.abs(grid).max(1) > 1e-3]
    if len(grid) > _MOST_VIEWS:
        # Every other view, as the squares of one colour on a chessboard, or as many as may be kept.
        board = grid[np.rint(grid).sum(1) % 2 == 0]
        grid = board if len(board) <= _MOST_VIEWS else grid[rng.permutation(len(grid))[:_MOST_VIEWS]]
    return grid / np.abs(grid).max()
