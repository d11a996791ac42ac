"""Sources of frames of `lfgpu live`: one table, a file and an entry each. The first that recognises a text opens it."""

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfgpu.data import LightField, interop
from lfgpu.errors import LightFieldError
from lfgpu.pipelines.rectifier import Rectifier
from lfgpu.pipelines.sources import devices, folder, grabber, scene, shared_memory, videos
from lfgpu.pipelines.sources.base import Frames, Options, Source
from lfgpu.pipelines.sources.feeding import feed
from lfgpu.pipelines.sources.recording import recorded

_CAMERAS = frozenset({"grid", "like"})
_FILES = frozenset(
    {"format", "allow_missing", "grid", "order", "every", "pattern", "axes", "unit", "transpose", "flip"}
)
SOURCES: tuple[Source, ...] = (
    # Those with a prefix come first; the last one takes what is left with a colon.
    Source(
        form="growing:FOLDER",
        description="a folder to which light fields are added, each taken once it is whole",
        recognise=folder.recognise_growing,
        open=folder.growing_frames,
        is_live=True,
        takes=_FILES,
    ),
    Source(
        form="ring:FILE",
        description="a ring buffer in shared memory, which another program fills (docs/live.md)",
        recognise=shared_memory.recognise,
        open=shared_memory.frames,
        is_live=True,
    ),
    Source(
        form="opencv:N,N,...",
        description="cameras by their numbers, or addresses, that OpenCV opens",
        recognise=devices.recognise,
        open=devices.frames,
        is_live=True,
        takes=_CAMERAS,
    ),
    Source(
        form="VIDEO",
        description="a video whose frames are grids of views (--grid)",
        recognise=videos.recognise,
        open=videos.tiled_frames,
        takes=_CAMERAS,
    ),
    Source(
        form="FOLDER of videos",
        description="one video for each camera, in the order of their names",
        recognise=videos.recognise_folder,
        open=videos.frames_of_cameras,
        takes=_CAMERAS,
    ),
    Source(
        form="FOLDER",
        description="a folder that holds a light field folder for each frame",
        recognise=folder.recognise,
        open=folder.frames,
        takes=_FILES,
    ),
    Source(
        form="SCENE",
        description="a synthetic scene; moving goes round, the others stand still",
        recognise=scene.recognise,
        open=scene.frames,
        takes=scene.OPTIONS,
    ),
    Source(
        form="MODULE:FUNCTION",
        description="a Python function that yields a LightField, then frames",
        recognise=grabber.recognise,
        open=grabber.frames,
        is_live=True,
    ),
)


@dataclass(frozen=True)
class Opened:
    """Source that was opened."""

    first: LightField  # the first frame
    frames: Frames  # all frames, the first one included
    is_live: bool  # True if frames come by themselves


def open_source(text: str, options: Options | None = None) -> Opened:
    """Open a source of one of the forms in `SOURCES`, and wait for the first frame."""
    source = next((source for source in SOURCES if source.recognise(text)), None)
    if source is None:
        what = "is a file, but no video" if Path(text).exists() else "does not exist"
        raise LightFieldError(f"{text} {what}; give one of {', '.join(source.form for source in SOURCES)}.")
    options = options or Options()
    given = {*options.scene, *options.reading, *(name for name in _CAMERAS if getattr(options, name) is not None)}
    takes_none = options.rectifier is not None and source.takes == _FILES  # but raw pictures
    if unread := sorted(given if takes_none else given - source.takes):
        raise LightFieldError(f"{text} takes no {' and no '.join(unread)}: it is {source.description}; leave that out.")
    frames = source.open(text, options)
    try:
        first = next(frames)
    except StopIteration:
        raise LightFieldError(f"{text} yielded no frame; give a source with at least one.") from None
    coming = itertools.chain([first], frames)
    if options.rectifier is not None:
        return Opened(_raw(first, options.rectifier), coming, source.is_live)
    if not isinstance(first, LightField):
        raise LightFieldError(
            f"{text} must yield a LightField first, because it gives the camera positions; found "
            f"{type(first).__name__}."
        )
    return Opened(first, coming, source.is_live)


def _raw(frame: Any, rectifier: Rectifier) -> LightField:
    """Make the first frame of raw pictures a light field for a stream."""
    views = frame[0] if isinstance(frame, tuple) else frame
    if isinstance(views, LightField):
        return rectifier.pictures(views.views, white=views.white)
    return rectifier.pictures(interop.on_host("views", views))
