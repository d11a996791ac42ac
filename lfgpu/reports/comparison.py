"""The page of a comparison: scores and maps of several methods side by side."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from lfgpu.comparison import COLUMNS, Scene, Table, error_map
from lfgpu.viz.cards import Card, limits_of, map_card, view_card
from lfgpu.viz.pages import rendered, write_page
from lfgpu.viz.panels import rgb

_MOST = 120_000  # pixels of a picture: there are many


def write_comparison(path: Path, scenes: Sequence[Scene], scored: Table) -> None:
    """Write the page of scenes, the maps of all methods and their scores; whole or not at all."""
    number = f"{len(scenes)} scene{'s' * (len(scenes) > 1)}"
    page = rendered(
        "comparison.html",
        title="Comparison of methods, by lfgpu",
        lead=f"{', '.join(scored.methods)} on {number}",
        columns=[f"{name} (%)" if name.startswith("BadPix") else name.replace("x100", "×100") for name in COLUMNS],
        table=scored.scenes,
        border=scenes[0].border,
        scenes={scene.name: list(_cards(scene, scored.methods)) for scene in scenes},
    )
    write_page(path, page)


def _cards(scene: Scene, methods: Sequence[str]) -> Iterator[Card]:
    """Yield the truth and the map of each method, then the view and the error of each method."""
    limits = limits_of("disparity", scene.truth)
    maps = {method: np.asarray(scene.maps[method], np.float32) for method in methods if method in scene.maps}
    yield map_card("Ground truth", scene.truth, "disparity", limits=limits, most=_MOST)
    for method, values in maps.items():
        yield map_card(method, values, "disparity", limits=limits, remark="disparity", most=_MOST)
    yield view_card("View", rgb(scene.view, 1.0), most=_MOST)
    for method, values in maps.items():
        error = error_map(values, scene.truth)
        yield map_card(method, error, "error", remark="error", most=_MOST)
