"""Sources of frames, and the options of users."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.pipelines.rectifier import Rectifier

Frames: TypeAlias = Iterator[Any]
"""A `LightField` first; then light fields of its kind, arrays like its views, or pairs (array, valid)."""


@dataclass(frozen=True)
class Options:
    """Options of a source.

    Parameters
    ----------
    grid
        (rows, columns) of the cameras, and of the views of a synthetic scene. Default None: a row; 7 x 7 for a scene.
    like
        A light field of the same cameras: it gives positions, reference view and geometry, in place of `grid`. Default
        None.
    scene
        Further options of `scenes.make`: `size`, `disparity_range`, `noise` and `seed`.
    rectifier
        Rectifier of raw pictures: then frames are raw pictures of its cameras, and a source need not begin with a
        LightField. Default None: frames are light fields.
    stop
        Asked while a source waits for a frame; when it returns True, the frames end. Default: never.
    say
        Called with sentences for the user, such as which frame was left out. Default: nobody listens.
    """

    grid: tuple[int, int] | None = None
    like: LightField | None = None
    scene: dict[str, Any] = field(default_factory=dict)
    rectifier: Rectifier | None = None
    stop: Callable[[], bool] = lambda: False
    say: Callable[[str], None] = lambda _: None


@dataclass(frozen=True)
class Source:
    """Entry of the table of sources.

    Parameters
    ----------
    form
        The form in which users write it.
    description
        One line for lists and help, without a full stop.
    recognise
        Called with a text; True if it names such a source.
    open
        The frames of the source that a text names. It raises LightFieldError with a sentence that names what is wrong.
    is_live
        True if frames come by themselves, so that those that come too fast are lost.
    """

    form: str
    description: str
    recognise: Callable[[str], bool]
    open: Callable[[str, Options], Frames]
    is_live: bool = False


def light_field(name: str, views: NDArray[Any], options: Options) -> LightField:
    """Make the first frame [n, y, x, c] of cameras whose positions only the user, or a rectifier, knows."""
    if options.rectifier is not None:
        return replace(options.rectifier.pictures(views), name=name)
    count, like = len(views), options.like
    if like is not None:
        if (len(like.views), *like.size) != views.shape[:3]:
            raise LightFieldError(
                f"{name} has {count} views of {views.shape[1]} x {views.shape[2]} pixels, but the light field that "
                f"gives the cameras has {len(like.views)} of {like.size[0]} x {like.size[1]}; give one of this array."
            )
        return replace(like, views=views, truth=None, files=(), notes=(), white=None, name=name)
    rows, columns = options.grid or (1, count)
    if rows * columns != count:
        raise LightFieldError(
            f"{name} has {count} views, but a grid of {rows} x {columns} has {rows * columns}; give another grid, or a "
            "light field of the same cameras."
        )
    return replace(LightField.from_grid(views.reshape(rows, columns, *views.shape[1:])), name=name)
