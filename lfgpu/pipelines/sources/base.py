"""Sources of frames, and the options of users."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.pipelines.rectifier import Rectifier

Frames: TypeAlias = Iterator[Any]
"""A `LightField` first; then light fields of its kind, arrays like its views, or pairs (array, valid)."""


@dataclass(frozen=True)
class Options:
    """Options of a source."""

    grid: tuple[int, int] | None = None  # (rows, columns) of the cameras, and of the views of a synthetic scene
    like: LightField | None = None  # light field of the same cameras that gives positions, reference view and geometry
    scene: dict[str, Any] = field(default_factory=dict)  # options of `scenes.make`, such as `size` and `noise`
    reading: dict[str, Any] = field(default_factory=dict)  # options of `lfgpu.read`, but grid, for sources of its files
    most: int | None = None  # largest number of frames that are used; None: no limit
    rectifier: Rectifier | None = None  # with it frames are raw pictures of its cameras
    say: Callable[[str], None] = lambda _: None  # takes sentences for the user, such as which frame was left out


@dataclass(frozen=True)
class Source:
    """Entry of the table of sources."""

    form: str  # the form in which users write it
    description: str  # one line for lists and help, without a full stop
    recognise: Callable[[str], bool]  # tells whether a text names such a source
    open: Callable[[str, Options], Frames]
    """Yields the frames of the source that a text names; LightFieldError names what is wrong."""
    is_live: bool = False  # True if frames come by themselves, so that those that come too fast are lost
    takes: frozenset[str] = frozenset()  # of the options that say what the light field is like: "grid", "like", "size"


def check_sizes(names: Sequence[str], pictures: Sequence[NDArray[Any]]) -> None:
    """Raise LightFieldError unless all cameras have pictures [y, x, c] of one size."""
    for name, picture in zip(names, pictures, strict=True):
        if picture.shape != pictures[0].shape:
            raise LightFieldError(
                f"{name} has frames of {picture.shape[1]} x {picture.shape[0]} pixels, but {names[0]} has "
                f"{pictures[0].shape[1]} x {pictures[0].shape[0]}; all cameras must have one size."
            )


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
