"""What the pictures of the viewer cost its server: CPU and wall time of each kind, on a large light field."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.cases import Case
from lfgpu import LightField
from lfgpu.data.result import DisparityMap
from lfgpu.viewer.answers import DATA, Query
from lfgpu.viewer.contents import Contents, Entry
from lfgpu.viewer.pictures import prepare

_RESULT = {"result": "map", "stage": "final"}
_TILE, _QUICK = 512, 360  # pixels along the longer side of a tile, and of what is computed first, as on the page


@dataclass(frozen=True)
class Picture:
    """A kind of picture: what a page asks for, and the words of its request number n."""

    name: str
    what: str
    words: Callable[[int], dict[str, Any]]
    is_first: bool = True
    """Whether somebody waits for it; else it makes sharper what is seen already."""


@dataclass(frozen=True)
class Cost:
    """Seconds of the first request after a light field was opened, and the medians of later ones for other pictures."""

    picture: str
    is_first: bool
    bytes: int
    first_cpu: float
    first_wall: float
    later_cpu: float
    later_wall: float


def pictures(lf: LightField) -> list[Picture]:
    """What a page asks for while people explore a light field."""
    (height, width), reference = lf.size, lf.reference_index
    overview, quick = (max(0, math.ceil(math.log2(max(lf.size) / side))) for side in (_TILE, _QUICK))
    reach = float(np.hypot(*lf.offsets.T).max())
    place, disparity = {"column": 0, "row": 0}, {**_RESULT, "kind": "disparity"}

    def focus(level: int, share: float) -> Callable[[int], dict[str, Any]]:
        return lambda n: {"disparity": 0.1 * n - 0.45, "aperture": share * reach, "level": level}

    def at_pixel(n: int) -> dict[str, Any]:
        return {**_RESULT, "x": width // 2, "y": n}

    def other(n: int) -> int:
        return (reference + 7 * n + 1) % len(lf.views)

    return [
        Picture("thumbnails", "thumbnails", lambda _: {}),
        Picture("view", "view", lambda n: {"index": other(n), "level": overview, **place}),
        Picture("tile of a view", "view", lambda n: {"index": other(n), "level": 0, **place}),
        Picture("map", "map", lambda _: {**disparity, "level": overview, **place}),
        Picture("tile of a map", "map", lambda _: {**disparity, "level": 0, **place}),
        Picture(
            "distribution",
            "histogram",
            lambda n: {**disparity, "low": -n - 1, "high": 1, "bins": 120},
        ),
        Picture("EPI of a row", "epi", lambda n: {"along": "row", "at": height // 2 + n}),
        Picture("EPI of a column", "epi", lambda n: {"along": "column", "at": width // 2 + n}),
        Picture("values at a pixel", "at", lambda n: {**at_pixel(n), "index": -1}),
        Picture("values at a pixel of a view", "at", lambda n: {**at_pixel(n), "index": other(n)}),
        Picture("refocused", "refocused", focus(quick, 1)),
        Picture("refocused, half the aperture", "refocused", focus(quick, 0.5)),
        Picture("refocused, half as large", "refocused", focus(1, 1), is_first=False),
        Picture("refocused, whole", "refocused", focus(0, 1), is_first=False),
        Picture("all in focus", "sharp", lambda _: {**_RESULT, "level": quick}),
        Picture("all in focus, half as large", "sharp", lambda _: {**_RESULT, "level": 1}, is_first=False),
        Picture("all in focus, whole", "sharp", lambda _: {**_RESULT, "level": 0}, is_first=False),
    ]


def made(case: Case) -> Contents:
    """A light field of a random texture that moves by a pixel from view to view, and a map of a ramp."""
    (rows, columns), (height, width) = case.grid, case.size
    texture = np.random.default_rng(0).integers(0, 256, (height + rows, width + columns, 3), np.uint8)
    views = np.empty((rows, columns, height, width, 3), np.uint8)
    for v, u in np.ndindex(rows, columns):
        views[v, u] = texture[v : v + height, u : u + width]
    ramp = np.broadcast_to(np.linspace(-1, 1, width, dtype=np.float32), (height, width)).copy()
    return Contents(LightField.from_grid(views)).with_entry("map", Entry.of(DisparityMap(ramp, np.abs(ramp))))


def run(case: Case, times: int, say: Callable[[str], None]) -> Iterator[Cost]:
    """Ask for each kind of picture, in this process: first just after the light field was opened, then again."""
    cpu, wall = process_time(), perf_counter()
    prepare()
    spent = process_time() - cpu, perf_counter() - wall
    yield Cost("loading modules and kernels", False, 0, *spent, 0.0, 0.0)
    contents = made(case)
    assert contents.lf is not None
    for picture in pictures(contents.lf):
        say(picture.name)
        fresh = replace(contents, lf=replace(contents.lf))  # nothing is kept of it
        size, *first = _asked(fresh, picture, 0)
        later = [_asked(fresh, picture, n) for n in range(1, times + 1)]
        medians = (median(one[place] for one in later) for place in (1, 2))
        yield Cost(picture.name, picture.is_first, size, *first, *medians)


def _asked(contents: Contents, picture: Picture, number: int) -> tuple[int, float, float]:
    """(bytes, CPU seconds, wall seconds) of a request."""
    query = Query({name: str(value) for name, value in picture.words(number).items()})
    cpu, wall = process_time(), perf_counter()
    found = DATA[picture.what](contents, query)
    return getattr(found, "nbytes", 0), process_time() - cpu, perf_counter() - wall


def show(costs: list[Cost]) -> None:
    """Print a table."""
    table = Table("picture", "MB", "first: CPU", "wall", "later: CPU", "wall, ms", box=None, pad_edge=False)
    for cost in costs:
        times = (cost.first_cpu, cost.first_wall, cost.later_cpu, cost.later_wall)
        table.add_row(cost.picture, f"{cost.bytes / 1e6:.2f}", *(f"{1000 * seconds:.1f}" for seconds in times))
    Console().print(table)
