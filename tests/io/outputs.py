"""Files that lfgpu writes and reads back: maps, results, the manifest of a batch."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.batch.items import Item
from lfgpu.batch.manifest import DONE, FAILED, Manifest, damaged_lines, read_manifest, standing
from lfgpu.batch.report import write_report
from lfgpu.batch.run import Summary
from lfgpu.data import DepthResult, Geometry, ViewsResult
from lfgpu.io import load, read_map, save
from tests.made import made_result

_SIZE = (12, 14)


@dataclass(frozen=True)
class Output:
    """One kind of file."""

    write: Callable[[Path], Path]
    """Writes into a folder that exists; what to read."""
    read: Callable[[Path], Any]


def a_result() -> DepthResult:
    """Of any method, with everything in it."""
    disparity = np.linspace(-1, 1, _SIZE[0] * _SIZE[1], dtype=np.float32).reshape(_SIZE)
    disparity[2:4, 3] = np.nan
    told = {"disparity_range": (-1.0, 1.0), "trace": (1.0, 0.5), "geometry": Geometry(100.0, 0.01, 2.0)}
    return made_result(disparity, status="done.", name="scene", **told)


def _result(place: Path) -> Path:
    save(a_result(), place / "result.npz")
    return place / "result.npz"


def _views(place: Path) -> Path:
    result = a_result()
    maps = np.stack([result.disparity] * 3)
    positions = np.array([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    save(ViewsResult(maps, np.abs(maps), positions, (1,), result, {"total": 1.0}), place / "views.npz")
    return place / "views.npz"


def _map(suffix: str) -> Output:
    def write(place: Path) -> Path:
        save(a_result().map, place / f"map{suffix}", image=np.full((*_SIZE, 3), 0.5, np.float32))
        return place / f"map{suffix}"

    def read(path: Path) -> Any:
        read_map(path)
        return load(path)

    return Output(write, read)


def _manifest(place: Path) -> Path:
    keys = {"parameters_key": "a", "input_key": "b"}
    done = {"status": DONE, "sizes": {"disparity.pfm": 4}, "times": {"read": 0.1}, "seconds": 1.0, "began": 1.0}
    scores = {"metrics": {"mse_100": 1.0, "badpix_07": 2.0}, "disparity_range": [-1.0, 1.0], "notes": ["a note."]}
    with Manifest(place) as manifest:
        manifest.add([{"item": "one", "input": "/one", **keys, **done, **scores}])
        manifest.add([{"item": "two", "input": "/two", **keys, "status": FAILED, "error": "bad.", "began": 2.0}])
    (place / ".batch.lock").unlink()
    return place


def _read_manifest(place: Path) -> Any:
    entries = read_manifest(place)
    standing(entries, place)
    items = [Item(name, "/one") for name in entries]
    write_report(Summary(items, entries, damaged=damaged_lines(place)), place, "page")
    return entries


OUTPUTS = {
    "result": Output(_result, load),
    "views-result": Output(_views, load),
    "manifest": Output(_manifest, _read_manifest),
    **{f"map{suffix}": _map(suffix) for suffix in (".pfm", ".npz", ".png", ".tif", ".exr")},
}
