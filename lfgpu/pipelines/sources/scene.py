"""Source of a synthetic scene. The frames of a moving scene are made once, and then go round."""

from __future__ import annotations

import itertools

from lfgpu.pipelines.sources.base import Frames, Options
from lfgpu.threads import in_threads

_ROUND = 24  # frames of a scene that moves, after which it repeats
_GRID = (7, 7)


def recognise(source: str) -> bool:
    from lfgpu.scenes import NAMES

    return source in NAMES


def frames(source: str, options: Options) -> Frames:
    """Yield for ever the frames of a scene that moves, or the one frame of another scene."""
    from lfgpu.scenes import make

    given = {**options.scene, "grid": options.grid or _GRID}
    if source != "moving":
        return itertools.repeat(make(source, **given))
    options.say(f"Making {_ROUND} frames of the scene {source}, which then repeat.")
    return itertools.cycle(in_threads(lambda index: make(source, time=index / _ROUND, **given), range(_ROUND)))
