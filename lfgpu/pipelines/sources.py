"""Sources of frames for `lfgpu live`: folders, synthetic scenes and grabbers; and the loop that feeds a stream."""

from __future__ import annotations

import importlib
import itertools
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.data import interop
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.folders import natural_order
from lfgpu.pipelines.rectifier import Rectifier
from lfgpu.pipelines.stream import DepthStream, StreamResult

Frames = Iterator[Any]
"""A `LightField` first; then light fields of its kind, arrays like its views, or pairs (array, valid)."""

_RENDERED = 24  # frames of a synthetic scene that are rendered; then they repeat


def open_source(
    source: str, *, scene_options: dict[str, Any] | None = None, rectifier: Rectifier | None = None
) -> tuple[LightField, Frames]:
    """The first frame of a source, and all frames, the first included.

    Parameters
    ----------
    source
        One of three. A folder of light fields, in natural order of their names. The name of a synthetic scene:
        "moving" repeats for ever, the others stand still. Or a grabber as `module:function`; the module may be in the
        current folder. The function has no arguments. It yields a `LightField` first, then light fields, arrays of
        views [n, y, x, c] of any library, or pairs (views, valid), where valid is bool [n], False for cameras without
        a picture.
    scene_options
        `grid`, `size`, `disparity_range`, `noise` and `seed` of `scenes.make`.
    rectifier
        What raw pictures are rectified with later: then a folder holds folders of pictures, and a grabber need not
        begin with a LightField. Default None: frames are light fields.

    Raises
    ------
    LightFieldError
        If there is no such source, or it is empty.
    """
    frames = _frames(source, scene_options or {}, raw=rectifier is not None)
    try:
        first = next(frames)
    except StopIteration:
        raise LightFieldError(f"{source} yielded no frame; give a source with at least one.") from None
    if rectifier is not None:
        views = first[0] if isinstance(first, tuple) else first
        white = views.white if isinstance(views, LightField) else None
        pictures = views.views if isinstance(views, LightField) else interop.on_host("views", views)
        return rectifier.pictures(pictures, white=white), itertools.chain([first], frames)
    if not isinstance(first, LightField):
        raise LightFieldError(
            f"{source} must yield a LightField first, because it gives the camera positions; found "
            f"{type(first).__name__}."
        )
    return first, itertools.chain([first], frames)


def feed(
    stream: DepthStream,
    frames: Frames,
    *,
    fps: float | None = None,
    most: int | None = None,
    on_done: Callable[[StreamResult], None] | None = None,
) -> None:
    """Push frames into a stream until they end, and wait for the last map.

    Parameters
    ----------
    frames
        As from `open_source`. A wrong frame becomes a failed result of the stream.
    fps
        Largest number of frames per second; None (default) takes frames as they come.
    most
        Largest number of frames; None (default) takes all.
    on_done
        Called with each result in order, also failed and dropped ones, in the thread that feeds.
    """
    pending: deque[StreamResult] = deque()

    def look(*, wait: bool) -> None:
        while pending and (wait or pending[0].done):
            result = pending.popleft()
            result.wait()
            if on_done is not None:
                on_done(result)

    start = time.perf_counter()
    for index, frame in enumerate(frames if most is None else itertools.islice(frames, most)):
        if fps is not None:
            time.sleep(max(0.0, start + index / fps - time.perf_counter()))
        views, valid = frame if isinstance(frame, tuple) and len(frame) == 2 else (frame, None)
        pending.append(stream.push(views.views if isinstance(views, LightField) else views, valid=valid, tag=index))
        look(wait=False)
    look(wait=True)


def _frames(source: str, scene_options: dict[str, Any], *, raw: bool) -> Frames:
    from lfgpu.scenes import NAMES

    path = Path(source)
    if path.is_dir():
        return _of_folder(path, raw=raw)
    if ":" in source and not path.exists():
        return _of_grabber(source)
    if source in NAMES and not path.exists():
        return _of_scene(source, scene_options)
    what = "is a file" if path.exists() else "does not exist"
    raise LightFieldError(
        f"{source} {what}; give a folder of light fields, a grabber as module:function, or a scene "
        f"({', '.join(NAMES)})."
    )


def _of_folder(path: Path, *, raw: bool) -> Frames:
    from lfgpu.io import read
    from lfgpu.io.pictures import load_pictures

    found = sorted(
        (entry for entry in path.iterdir() if not entry.name.startswith(".")),
        key=lambda entry: natural_order(entry.name),
    )
    folders = [entry for entry in found if entry.is_dir()]
    if not folders:
        raise LightFieldError(
            f"{path} holds no folders; give a folder that holds one light field folder for each frame."
        )
    first: LightField | None = None
    for folder in folders:
        lf = load_pictures(folder) if raw else read(folder)
        if first is not None and not np.array_equal(lf.positions, first.positions):
            raise LightFieldError(
                f"{folder} has other camera positions than {folders[0]}; all frames of a stream must come from the "
                "same cameras."
            )
        first = first or lf
        yield lf


def _of_scene(name: str, options: dict[str, Any]) -> Frames:
    from lfgpu.scenes import make, sequence

    if name != "moving":
        yield from itertools.repeat(make(name, **options))
    kept = []
    for lf in sequence(name, frames=_RENDERED, **options):
        kept.append(lf)
        yield lf
    yield from itertools.cycle(kept)


def _of_grabber(source: str) -> Frames:
    module_name, _, function_name = source.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        grabber = getattr(importlib.import_module(module_name), function_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise LightFieldError(f"{source} cannot be imported: {error}.") from error
    frames = grabber() if callable(grabber) else None
    if not isinstance(frames, Iterable):
        raise LightFieldError(f"{source} must be a function without arguments that yields frames.")
    return iter(frames)
