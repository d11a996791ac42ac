"""Source of a synthetic scene. The frames of a moving scene are made once, and then go round."""

from __future__ import annotations

import itertools
import time
from typing import TYPE_CHECKING

from lfgpu.pipelines.sources.base import Frames, Options
from lfgpu.threads import in_threads

if TYPE_CHECKING:
    from lfgpu.data import LightField

_SAID_AGAIN = 2.0  # seconds, at least, between two sentences about how many frames are made
_ROUND = 24  # frames of a scene that moves, after which it repeats
_GRID, _SIZE, _NOISE = (7, 7), (192, 256), 0.005
OPTIONS = frozenset({"grid", "size", "noise", "disparity_range", "seed"})


def recognise(source: str) -> bool:
    from lfgpu.scenes import NAMES

    return source in NAMES


def frames(source: str, options: Options) -> Frames:
    """Yield for ever the frames of a scene that moves, or the one frame of another scene."""
    from lfgpu.scenes import make

    given = {"size": _SIZE, "noise": _NOISE, **options.scene, "grid": options.grid or _GRID}
    if source != "moving":
        return itertools.repeat(make(source, **given))
    wanted = min(_ROUND, options.most or _ROUND)
    options.say(f"Making {wanted} frames of the scene {source}{', which then repeat' * (wanted == _ROUND)}.")
    made, said = itertools.count(1), time.monotonic()

    def cast(index: int) -> LightField:
        nonlocal said
        frame = make(source, time=index / _ROUND, **given)
        count = next(made)
        if time.monotonic() > said + _SAID_AGAIN:
            said = time.monotonic()
            options.say(f"{count} of {wanted} frames are made.")
        return frame

    return itertools.cycle(in_threads(cast, range(wanted)))
