"""Results and maps as files that pages offer for download."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from lfgpu.data import DepthResult, DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import MAP_FORMATS, save
from lfgpu.viewer.contents import FINAL, Contents
from lfgpu.viz.colours import LOOKS
from lfgpu.viz.panels import encoded
from lfgpu.viz.pictures import draw_map


def saved(contents: Contents, name: str, stage: str, suffix: str) -> bytes:
    """Save a map as the bytes of one of the formats of `lfgpu.save`; .npz of a final stage holds the whole result."""
    entry = contents.all_entries().get(name)
    if entry is None:
        raise LightFieldError(f"there is no result {name!r} to save.")
    if not any(suffix in known.suffixes for known in MAP_FORMATS):
        raise LightFieldError(f"a file {suffix!r} cannot be written: there is no such format of maps.")
    values: DepthResult | DisparityMap
    if entry.result is not None and stage == FINAL:
        values = entry.result
    else:
        position, geometry = entry.map.position or contents.position, entry.map.geometry or contents.geometry
        values = replace(entry.map, disparity=entry.stage(stage), position=position, geometry=geometry)
        if stage != FINAL:  # those of the final map
            values = replace(values, confidence=None, uncertainty=None)
    lf = contents.lf
    image = None if lf is None else lf.image(lf.reference_index)
    return written(lambda path: save(values, path, image=image), suffix)


def written(write: Callable[[Path], object], suffix: str) -> bytes:
    """Return the bytes of a file that `write` writes."""
    with tempfile.TemporaryDirectory(prefix="lfgpu-") as folder:
        path = Path(folder) / f"result{suffix}"
        write(path)
        return path.read_bytes()


def figure(contents: Contents, name: str, kind: str, stage: str, *, colours: str, limits: tuple[float, float]) -> bytes:
    """Draw a map with its scale as a PNG, each pixel a whole square; LightFieldError if there is no such map."""
    values = contents.map(name, kind, stage)
    if values is None:
        raise LightFieldError(f"{name!r} has no {kind} to save.")
    title = f"{name}{'' if stage == FINAL else f', {stage}'}: {kind}"
    return encoded(draw_map(values, title=title, label=LOOKS[kind].title, colours=colours, limits=limits))
