"""Source of light fields in a folder: one sub-folder for each frame, all there or still coming."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read
from lfgpu.io.folders import natural_order, sub_folders
from lfgpu.io.formats import ANY_IMAGES, kind
from lfgpu.io.naming import names_times
from lfgpu.io.numbered import frames_of, holds_cameras
from lfgpu.pipelines.sources.base import Frames, Options
from lfgpu.pipelines.sources.recording import VIEWS_FILE

GROWING = "growing:"

_LOOK = 0.1  # seconds between two looks at a folder that grows; a frame that has not changed is whole


def recognise(source: str) -> bool:
    return Path(source).is_dir()


def recognise_growing(source: str) -> bool:
    return source.startswith(GROWING)


def frames(source: str, options: Options) -> Frames:
    """Yield the light fields of a folder, or raw pictures for a rectifier, in the natural order of their names.

    Of a folder of images of several times for each camera, the times. A pattern with times is about their folder.
    """
    path, pattern = Path(source), options.reading.get("pattern")
    of_times = names_times(pattern) if pattern is not None else kind(path) in ANY_IMAGES
    if options.rectifier is None and of_times:
        times = frames_of(path, pattern)
        if times > 1 or pattern is not None or holds_cameras(path):
            yield from (read(path, frame=time, **_reading(options)) for time in range(times))
            return
    folders = _ordered(path)
    if not folders:
        raise LightFieldError(
            f"{path} holds no folders; give a folder that holds one light field folder for each frame, or one video "
            f"for each camera; if frames are still to come, give {GROWING}{path}."
        )
    first: LightField | None = None
    for folder in folders:
        lf = _read(folder, options)
        yield lf if first is None else _like(first, lf, folder)
        first = first or lf


def growing_frames(source: str, options: Options) -> Frames:
    """Yield the light fields of a folder as they come, for ever; unreadable ones are left out with a sentence."""
    path = Path(source.removeprefix(GROWING))
    if not path.is_dir():
        raise LightFieldError(f"{path} is no folder; make it before frames come.")
    first: LightField | None = None
    for folder in _whole(path):
        try:
            lf = _read(folder, options)
            frame = lf if first is None else _like(first, lf, folder)
        except LightFieldError as error:
            options.say(f"Left out: {error}")
            continue
        yield frame
        first = first or lf


def _whole(path: Path) -> Iterator[Path]:
    """Yield each new folder once its files have not changed between two looks."""
    done, seen = set[Path](), dict[Path, Any]()
    while True:
        for folder in _ordered(path):
            if folder in done:
                continue
            state = _state(folder)
            if state and seen.get(folder) == state:
                done.add(folder)
                yield folder
            seen[folder] = state
        time.sleep(_LOOK)


def _state(folder: Path) -> tuple[Any, ...]:
    """List names, sizes and times of the files in a folder; empty if there are none, or if they vanish meanwhile."""
    try:
        files = [(str(file), file.stat()) for file in sorted(folder.rglob("*")) if file.is_file()]
    except OSError:
        return ()
    return tuple((name, stat.st_size, stat.st_mtime_ns) for name, stat in files)


def _ordered(path: Path) -> list[Path]:
    return sorted(sub_folders(path), key=lambda folder: natural_order(folder.name))


def _reading(options: Options) -> dict[str, Any]:
    return options.reading if options.grid is None else {**options.reading, "grid": options.grid}


def _read(folder: Path, options: Options) -> LightField:
    from lfgpu.io.views import load_pictures

    rectifier = options.rectifier
    if rectifier is None or (folder / VIEWS_FILE).is_file():  # recorded frames say themselves which cameras are there
        return read(folder, **_reading(options))
    lf, count = load_pictures(folder), len(rectifier.places)
    if len(lf.views) != count:
        raise LightFieldError(
            f"{folder} holds {len(lf.views)} pictures, but {rectifier.name} has {count} cameras; give one of each."
        )
    return lf


def _like(first: LightField, lf: LightField, folder: Path) -> Any:
    """Put the views of a later frame in the order of the first one; also a mask of the cameras with a picture."""
    if np.array_equal(lf.positions, first.positions):
        return lf
    places = {tuple(position): index for index, position in enumerate(first.positions.tolist())}
    indices = [places.get(tuple(position), -1) for position in lf.positions.tolist()]
    if min(indices) < 0 or lf.views.shape[1:] != first.views.shape[1:] or lf.views.dtype != first.views.dtype:
        raise LightFieldError(
            f"{folder} has other camera positions than the first frame, {first.name}, or views of another kind; all "
            "frames of a stream must come from the same cameras."
        )
    views, valid = np.zeros_like(first.views), np.zeros(len(first.views), bool)
    views[indices], valid[indices] = lf.views, True
    return views, valid
